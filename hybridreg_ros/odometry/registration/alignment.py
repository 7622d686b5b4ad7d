# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Alignment: ICP of the static points against the local map, coarse level first."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.motion.intra_scan_motion import NO_INTRA_SCAN_MOTION, IntraScanMotion
from hybridreg_ros.odometry.registration import intra_scan_update
from hybridreg_ros.odometry.registration.gauss_newton import (
    LEAST,
    POINT_SPREAD,
    assessed,
    settle,
)
from hybridreg_ros.odometry.registration.kernels import associate, measure
from hybridreg_ros.odometry.registration.surfaces import MATURE_S, by_age, scales, unpaired

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.map.local_map import LocalMap
    from hybridreg_ros.odometry.motion.prediction import Expected
    from hybridreg_ros.odometry.motion.usual_motion import UsualMotion
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan

    F64 = NDArray[np.float64]
    I64 = NDArray[np.int64]

Basin = Literal['coarse', 'middle', 'near', 'fine']

_ITERATIONS, _INTRA_SCAN_ITERATIONS = 15, 6
_START = 0.5
"""Robust scale on a coarser level at first, voxels."""
_BENT = (0.32, 0.16, 0.08, 0.04)
"""Robust scales, voxels, at which the motion within a scan is looked for first where nothing says
how it begins: a sharp kernel keeps the points of the even motion."""
_COARSE_POINTS = 1500
"""Points that are enough on a coarser level."""
_NOTHING_EXPECTED = np.eye(4), np.zeros(6)


@dataclass(frozen=True, eq=False)
class Fit:
    """How well a scan sits in the map.

    Attributes:
        T_odom_sensor: (4, 4) float64.
        information: (6, 6) of the pose error (x y z, turn about the sensor; odom axes), 1/m^2 and
            1/rad^2; zero where nothing was found.
        overlap: share of the points with a surface of the map nearby, [0, 1].
        cluster_covariance: (6, 6) covariance of the pose error by how much the parts of the scan
            disagree, m^2 and rad^2, same axes (`cluster_covariance`).
        unheld: (6, 6) projection onto the directions that no surface holds (x y z, turn about the
            sensor; odom axes), zero where all are held.
        intra_scan: motion during the scan that its deskew did not undo, when it was asked for.
    """

    T_odom_sensor: NDArray[np.float64]
    information: NDArray[np.float64]
    overlap: float
    cluster_covariance: NDArray[np.float64]
    unheld: NDArray[np.float64] = field(default_factory=lambda: np.zeros((6, 6)))
    intra_scan: IntraScanMotion | None = None


def align(
    points: NDArray[np.floating],
    T_odom_sensor: NDArray[np.float64],
    local_map: LocalMap,
    weights: NDArray[np.floating] | None = None,
    basin: Basin = 'coarse',
    times: NDArray[np.float64] | None = None,
    prior: Expected | None = None,
    usual: UsualMotion | None = None,
) -> Fit:
    """Align points with the map, from a first guess.

    Args:
        points: (N, 3), sensor frame, metres, thinned.
        T_odom_sensor: (4, 4) first guess.
        local_map: the map.
        weights: (N,) trust per point in [0, 1] (1 - P(dynamic)), or None for all equal.
        basin: how far off the guess may be: the level to start on, or 'near' = the fine one, but
            within a voxel only.
        times: (N,) seconds of each point after the instant of the pose; then the motion during
            the scan is found too.
        prior: pose that the motion so far expects, with a spread to which the information of the
            points is comparable; it holds what they leave loose. None = nothing is expected.
        usual: what earlier scans say of the motion during the scan, where nothing says how it
            begins; else None.
    """
    start = T_odom_sensor
    if basin in {'coarse', 'middle'}:
        start = pull_in(points, T_odom_sensor, local_map, weights, basin)
    rows, trust, order = _prepared(points, weights)
    course = 4.0 * LEAST if basin == 'fine' else 0.4 * _START, _ITERATIONS
    held = _NOTHING_EXPECTED if prior is None else (prior.pose, prior.information)
    T, converged, surfaces = settle(
        rows, trust, order, start, local_map.grids, _clock(local_map), course, held
    )
    T = se3.orthonormalise(T)
    if times is None:
        if converged:  # it stands where it was paired last
            return Fit(T, *assessed(rows, trust, order, T, surfaces, local_map.fine.size_m))
        return assess(points, T, local_map, weights)
    T, found = _with_intra_scan_motion(rows, times, trust, order, T, local_map, prior, usual)
    fit = assess(found.undo(rows, times), T, local_map, weights)
    return replace(fit, intra_scan=found)


def _with_intra_scan_motion(
    points: F64,
    times: F64,
    trust: F64,
    order: I64,
    T: F64,
    local_map: LocalMap,
    prior: Expected | None,
    usual: UsualMotion | None,
) -> tuple[F64, IntraScanMotion]:
    """Pose and motion during the scan, from the pose of an even motion."""
    size_m, found, moved = local_map.fine.size_m, NO_INTRA_SCAN_MOTION, points
    surfaces, (updates, *ages) = unpaired(len(points)), _clock(local_map)
    half_span = 0.5 * float(times.max() - times.min())
    bent = () if usual is None else _BENT
    for low in (*bent, *[LEAST] * _INTRA_SCAN_ITERATIONS):
        associate(moved, T, local_map.grids, updates, surfaces)
        lasting = by_age(trust, surfaces, *ages)
        step = 0.0
        for _ in range(2):
            measure(moved, T, surfaces)
            scale = scales(surfaces, order, low * size_m, size_m)
            spread = (POINT_SPREAD * size_m) ** 2
            sums = intra_scan_update.moments(moved, times, lasting, T, surfaces, scale, spread)
            T, found, length = intra_scan_update.update(found, T, sums, half_span, prior, usual)
            moved = found.undo(points, times)
            step = max(step, length)
        if step < 0.02 and low == LEAST:
            break
    return se3.orthonormalise(T), found


def pull_in(
    points: NDArray[np.floating],
    T_odom_sensor: F64,
    local_map: LocalMap,
    weights: NDArray[np.floating] | None,
    basin: Basin,
    rounds: int = 0,
) -> F64:
    """Improve a guess on a coarser level with some of the points; arguments as `align`.

    Given a number of rounds, it makes so few, with half as many points.
    """
    most = _COARSE_POINTS // 2 if rounds else _COARSE_POINTS
    some = slice(None, None, max(1, len(points) // most))
    rows, trust, order = _prepared(points[some], None if weights is None else weights[some])
    _, middle, coarse = local_map.grids
    levels = (coarse if basin == 'coarse' else middle), coarse, coarse
    course = _START, rounds or _ITERATIONS
    clock = _clock(local_map)
    T: F64
    T, _, _ = settle(rows, trust, order, T_odom_sensor, levels, clock, course, _NOTHING_EXPECTED)
    return se3.orthonormalise(T)


def _clock(local_map: LocalMap) -> tuple[int, float, float]:
    """Updates of the map, its age, and the age at which its surfaces count fully, seconds.

    While it is younger than that, its first ones do.
    """
    return local_map.updates, local_map.age_s, min(MATURE_S, local_map.age_s)


def _prepared(
    points: NDArray[np.floating], weights: NDArray[np.floating] | None
) -> tuple[F64, F64, I64]:
    """Contiguous float64 points and weights for the kernels, and rows by range, nearest first."""
    rows = np.ascontiguousarray(points, np.float64)
    trust = np.ones(len(rows)) if weights is None else weights.astype(np.float64)
    return rows, trust, np.argsort(np.einsum('ij,ij->i', rows, rows))


def assess(
    points: NDArray[np.floating],
    T_odom_sensor: NDArray[np.float64],
    local_map: LocalMap,
    weights: NDArray[np.floating] | None = None,
) -> Fit:
    """Measure how well points sit in the map at a pose, without moving them.

    Args:
        points: (N, 3), sensor frame, metres.
        T_odom_sensor: (4, 4) the pose.
        local_map: the map.
        weights: (N,) trust per point in [0, 1], or None.
    """
    rows, trust, order = _prepared(points, weights)
    surfaces = unpaired(len(rows))
    associate(rows, T_odom_sensor, local_map.grids, local_map.updates, surfaces)
    size_m = local_map.fine.size_m
    return Fit(T_odom_sensor, *assessed(rows, trust, order, T_odom_sensor, surfaces, size_m))


def align_scan(
    cloud: PreprocessedScan,
    T_odom_sensor: NDArray[np.float64],
    local_map: LocalMap,
    weights: NDArray[np.floating] | None = None,
    basin: Basin = 'fine',
    prior: Expected | None = None,
) -> Fit:
    """Align a cloud with the map, from a first guess, as `align` does its registered points.

    The information is that of the points that count as independent, and so is their weight
    against what the motion so far expects.

    Args:
        cloud: the preprocessed scan, K registered points.
        T_odom_sensor: (4, 4) first guess.
        local_map: the map.
        weights: (K,) trust per registered point in [0, 1], or None for all equal.
        basin: level to start on.
        prior: pose that the motion so far expects, or None.
    """
    share = cloud.icp_share
    held = None if prior is None else prior.widened(share**0.5, share**0.5)
    points, times = cloud.icp_points, cloud.icp_times
    fit = align(points, T_odom_sensor, local_map, weights, basin, times, held, cloud.usual)
    return replace(fit, information=share * fit.information)
