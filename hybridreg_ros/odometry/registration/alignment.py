# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Refinement: ICP of the static points against the local map, coarse level first."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.motion.intra_scan_motion import NO_INTRA_SCAN_MOTION, IntraScanMotion
from hybridreg_ros.odometry.registration import intra_scan_update, kernels
from hybridreg_ros.odometry.registration.cluster_covariance import cluster_covariance
from hybridreg_ros.odometry.registration.kernels import NONE
from hybridreg_ros.odometry.registration.surfaces import Surfaces

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.map.local_map import LocalMap, VoxelLevel
    from hybridreg_ros.odometry.motion.prediction import Expected
    from hybridreg_ros.odometry.motion.usual_motion import UsualMotion
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan

    F64 = NDArray[np.float64]

Basin = Literal['coarse', 'middle', 'near', 'fine']

_ITERATIONS, _INTRA_SCAN_ITERATIONS = 15, 6
_STILL = 0.03
"""The iteration ends when a step is smaller than this, in voxels."""
_START, _SHRINK, _LEAST = 0.5, 0.6, 0.02
"""Robust scale on a coarser level at first, factor on it per iteration, and its floor, voxels."""
_BENT = (0.32, 0.16, 0.08, 0.04)
"""Robust scales, voxels, at which the motion within a scan is looked for first where nothing says
how it begins: a sharp kernel keeps the points of the even motion."""
_COARSE_POINTS = 1500
"""Points that are enough on a coarser level."""
_LOOSE = 0.02
"""Share of the information of surfaces that face all ways that errors of normals alone give."""
_MATURE_S, _YOUNG = 0.5, 0.1
"""Time after which a surface has full weight, and the weight of one that is new
(docs/lab/2026-11-23-old-surfaces-hold.md)."""
_POINT_SPREAD = 5.0
"""Standard deviation of a point-to-point residual, in voxels: such pairs follow the pattern of the
rings rather than the surface, so they only hold what planes leave free."""


_NEAR = 0.3
"""Step, in fine voxels, at which the pull from a pose of the network has come near enough: half of
its pairings, and the same ATE (docs/lab/2026-11-29-step-time.md). Not from other guesses: a sparse
lidar that turns back at once is lost for 35 instead of 4 scans of 44."""


class _Schedule(NamedTuple):
    """Course of an alignment: first robust scale, voxels; step that ends it; most rounds."""

    scale: float
    enough_m: float = 0.0
    rounds: int = _ITERATIONS


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
        intra_scan: motion during the scan that its deskew did not undo, when it was asked for.
        unheld: (6, 6) projection onto the directions that no surface holds (x y z, turn about the
            sensor; odom axes), zero where all are held.
    """

    T_odom_sensor: NDArray[np.float64]
    information: NDArray[np.float64]
    overlap: float
    cluster_covariance: NDArray[np.float64]
    intra_scan: IntraScanMotion | None = None
    unheld: NDArray[np.float64] = field(default_factory=lambda: np.zeros((6, 6)))


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
        basin: level to start on: the coarser, the farther off the guess may be; 'near' = the
            middle one, until it is near.
        times: (N,) seconds of each point after the instant of the pose; then the motion during
            the scan is found too.
        prior: pose that the motion so far expects, with a spread to which the information of the
            points is comparable; it holds what they leave loose. None = nothing is expected.
        usual: what earlier scans say of the motion during the scan, where nothing says how it
            begins; else None.
    """
    start = T_odom_sensor
    if basin != 'fine':
        start = pull_in(points, T_odom_sensor, local_map, weights, basin)
    points, trust = _prepared(points, weights)
    floor = 4.0 * _LEAST if basin == 'fine' else 0.4 * _START
    levels = local_map.of_surfaces
    T, converged, surfaces = _iterate(
        points, trust, start, levels, local_map, _Schedule(floor), prior
    )
    if times is None:
        if converged:  # it stands where it was paired last
            return _assessed(points, trust, T, surfaces, local_map)
        return assess(points, T, local_map, weights)
    T, found = _with_intra_scan_motion(points, times, trust, T, local_map, prior, usual)
    fit = assess(found.undo(points, times), T, local_map, weights)
    return replace(fit, intra_scan=found)


def _with_intra_scan_motion(
    points: NDArray[np.float64],
    times: NDArray[np.float64],
    trust: NDArray[np.float64],
    T: NDArray[np.float64],
    local_map: LocalMap,
    prior: Expected | None,
    usual: UsualMotion | None,
) -> tuple[NDArray[np.float64], IntraScanMotion]:
    """Pose and motion during the scan, from the pose of an even motion."""
    level, found, moved = local_map.fine, NO_INTRA_SCAN_MOTION, points
    surfaces, order = Surfaces(len(points)), _by_range(points)
    half_span = 0.5 * float(times.max() - times.min())
    bent = () if usual is None else _BENT
    for low in (*bent, *[_LEAST] * _INTRA_SCAN_ITERATIONS):
        surfaces.search(moved, T, local_map.of_surfaces, local_map.updates)
        lasting = by_age(trust, surfaces, local_map.age_s)
        step = 0.0
        for _ in range(2):
            surfaces.measure(moved, T)
            scale = surfaces.scales(order, low * level.size_m, level.size_m)
            R, t, spread = T[:3, :3].copy(), T[:3, 3].copy(), (_POINT_SPREAD * level.size_m) ** 2
            pairs = surfaces.kind, surfaces.anchor, surfaces.normal, surfaces.variance, scale
            sums = intra_scan_update.moments(moved, times, lasting, R, t, *pairs, spread)
            T, found, length = intra_scan_update.update(found, T, sums, half_span, prior, usual)
            moved = found.undo(points, times)
            step = max(step, length)
        if step < 0.02 and low == _LEAST:
            break
    return se3.orthonormalise(T), found


def pull_in(
    points: NDArray[np.floating],
    T_odom_sensor: NDArray[np.float64],
    local_map: LocalMap,
    weights: NDArray[np.floating] | None,
    basin: Basin,
    rounds: int = 0,
) -> NDArray[np.float64]:
    """Improve a guess on a coarser level with some of the points; arguments as `align`.

    Given a number of rounds, it makes so few, with half as many points.
    """
    most = _COARSE_POINTS // 2 if rounds else _COARSE_POINTS
    some = slice(None, None, max(1, len(points) // most))
    points, trust = _prepared(points[some], None if weights is None else weights[some])
    level = local_map.coarse if basin == 'coarse' else local_map.middle
    levels = (level, local_map.coarse, local_map.coarse)
    enough_m = _NEAR * local_map.fine.size_m if basin == 'near' else 0.0
    course = _Schedule(_START, enough_m, rounds or _ITERATIONS)
    return _iterate(points, trust, T_odom_sensor, levels, local_map, course)[0]


def _prepared(
    points: NDArray[np.floating], weights: NDArray[np.floating] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Contiguous float64 points and weights for the kernels."""
    trust = np.ones(len(points)) if weights is None else weights
    return np.ascontiguousarray(points, np.float64), np.ascontiguousarray(trust, np.float64)


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
    points, trust = _prepared(points, weights)
    surfaces = Surfaces(len(points))
    surfaces.search(points, T_odom_sensor, local_map.of_surfaces, local_map.updates)
    return _assessed(points, trust, T_odom_sensor, surfaces, local_map)


def _assessed(
    points: NDArray[np.float64],
    trust: NDArray[np.float64],
    T_odom_sensor: NDArray[np.float64],
    surfaces: Surfaces,
    local_map: LocalMap,
) -> Fit:
    """How well points sit in the map, with their surfaces; arguments as `assess`."""
    level = local_map.fine
    surfaces.measure(points, T_odom_sensor)
    # Point-to-point pairs follow the sampling, not the world: they say nothing about the error.
    planes = np.where(surfaces.kind == kernels.PLANE, trust, 0.0)
    scales = surfaces.scales(_by_range(points), _LEAST * level.size_m, level.size_m)
    H, b, any_way = _system(points, planes, T_odom_sensor, surfaces, scales, level)
    by_clusters = cluster_covariance(
        points, planes, T_odom_sensor, surfaces, scales, H, level.size_m
    )
    loose = unheld(H, any_way)
    H, _ = believed(H, b, any_way)
    usable = trust > 0.5
    paired = usable & (surfaces.kind != kernels.NONE)
    return Fit(
        T_odom_sensor=T_odom_sensor,
        information=H,
        overlap=float(paired.sum() / max(1, usable.sum())),
        cluster_covariance=by_clusters,
        unheld=loose,
    )


def _by_range(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rows of the points (N, 3) by their range, nearest first."""
    return np.argsort((points**2).sum(axis=1))


def _system(
    points: NDArray[np.float64],
    trust: NDArray[np.float64],
    T: NDArray[np.float64],
    surfaces: Surfaces,
    scale: NDArray[np.float64],
    level: VoxelLevel,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Gauss-Newton system of the robust cost at T; as `kernels.normal_equations` gives it."""
    R, t, spread = T[:3, :3].copy(), T[:3, 3].copy(), (_POINT_SPREAD * level.size_m) ** 2
    pairs = surfaces.kind, surfaces.anchor, surfaces.normal, surfaces.variance, scale
    system: tuple[F64, F64, F64] = kernels.normal_equations(points, trust, R, t, *pairs, spread)
    return system


_HELD = 0.007
"""Least share of the information of surfaces that face all ways that holds a direction: the median
of six ordinary sequences is 0.017 or more, of tunnels, rails, corridors, walls and fields 0.0033
or less (docs/lab/2026-11-29-what-holds-nothing.md)."""


def unheld(H: NDArray[np.float64], any_way: NDArray[np.float64]) -> NDArray[np.float64]:
    """Projection (6, 6) onto the directions that no surface holds; zero where all are held.

    Args:
        H: (6, 6) information of the planes.
        any_way: (6, 6) information if every surface held all directions.
    """
    unit = np.sqrt(np.maximum(np.diag(any_way), 1e-12))
    root = np.linalg.cholesky(any_way / np.outer(unit, unit) + 1e-6 * np.eye(6))
    inverse = np.linalg.inv(root)
    shares, vectors = np.linalg.eigh(inverse @ (H / np.outer(unit, unit)) @ inverse.T)
    loose = (inverse.T @ vectors[:, shares < _HELD]) / unit[:, None]
    loose /= np.maximum(np.linalg.norm(loose, axis=0), 1e-12)
    q, _ = np.linalg.qr(loose)
    projection: NDArray[np.float64] = q @ q.T
    return projection


def believed(
    H: NDArray[np.float64], b: NDArray[np.float64], any_way: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The part of a Gauss-Newton system that surfaces really hold.

    Normals are off a little everywhere, and alike over many points (bent depth images, planes
    fitted to noise): so one bare wall seems to hold the motion along it, by the weight of
    thousands of points. The gradient of that is taken as an error with covariance
    _LOOSE * (any_way - H), common to all points; where H is much larger, nothing changes.

    Args:
        H: (6, 6) information; b (6,) gradient.
        b: (6,).
        any_way: (6, 6) information if every surface held all directions.

    Returns:
        Information (6, 6) and gradient (6,); the solution of the system alone stays the same.
    """
    # Pairs of points are in H alone: where there are hardly any planes they set the units.
    unit = np.sqrt(np.maximum(np.maximum(np.diag(any_way), np.diag(H)), 1e-12))
    scaled = H / np.outer(unit, unit)
    noise = scaled + _LOOSE * (any_way / np.outer(unit, unit) - scaled) + 1e-9 * np.eye(6)
    part = np.linalg.solve(noise, np.column_stack([scaled, b / unit]))
    return (scaled @ part[:, :6]) * np.outer(unit, unit), (scaled @ part[:, 6]) * unit


def _iterate(
    points: NDArray[np.float64],
    trust: NDArray[np.float64],
    T: NDArray[np.float64],
    levels: tuple[VoxelLevel, VoxelLevel, VoxelLevel],
    local_map: LocalMap,
    schedule: _Schedule,
    prior: Expected | None = None,
) -> tuple[NDArray[np.float64], bool, Surfaces]:
    """Pair and step until the pose stands still; the pose, whether it does, and the last pairs.

    The robust scale starts no smaller than that of the schedule and shrinks (graduated
    non-convexity): a sharp kernel at a bad guess would keep only the pairs that happen to agree
    with the guess.
    """
    level, floor = levels[0], schedule.scale
    every = 1 if prior is None else max(1, len(points) // _FIRST)
    reach = float(np.median(np.linalg.norm(points, axis=1))) if len(points) else 1.0
    some, weight, surfaces, order = _every(every, points, trust)
    for _ in range(schedule.rounds):
        surfaces.search(some, T, levels, local_map.updates)
        lasting = by_age(weight, surfaces, local_map.age_s)
        moved = 0.0
        for _ in range(2):
            surfaces.measure(some, T)
            low = max(floor, _LEAST) * level.size_m
            scale = surfaces.scales(order, low, level.size_m)
            H, b, any_way = _system(some, lasting, T, surfaces, scale, level)
            if prior is not None:
                H, b = believed(H, b, any_way)
                held, pull = prior.pull(T)
                H[np.arange(6), np.arange(6)] += held / every
                b += pull / every
            step = intra_scan_update.solve(H, b)
            T = T.copy()
            T[:3, :3] = se3.so3_exp(step[3:]) @ T[:3, :3]
            T[:3, 3] += step[:3]
            moved = max(moved, float(np.linalg.norm(step[:3]) + reach * np.linalg.norm(step[3:])))
        last = floor < 2.0 * _LEAST
        if every == 1 and last and moved < _STILL * level.size_m:
            return se3.orthonormalise(T), True, surfaces
        if moved < schedule.enough_m:
            break
        close = every > 1 and moved < _CLOSE * level.size_m
        floor = _LEAST if close else _SHRINK * floor
        if close:
            every = 1
            some, weight, surfaces, order = _every(1, points, trust)
    return se3.orthonormalise(T), False, surfaces


_FIRST = 900
"""Points, about, by which an alignment near the expected pose comes close; all of them end it."""
_CLOSE = 0.1
"""Step, in voxels of the level, at which it has come close."""


def _every(k: int, points: F64, trust: F64) -> tuple[F64, F64, Surfaces, NDArray[np.int64]]:
    """Every k-th point with its weight, room for their surfaces, and their order by range."""
    some = np.ascontiguousarray(points[::k])
    return some, np.ascontiguousarray(trust[::k]), Surfaces(len(some)), _by_range(some)


_FULL = 0.8
"""Quantile of the weights of the trusted points that is raised to 1: only the difference between
old and young counts, so a scan that sees nothing old is held as firmly as one that does."""


_FEW = 50
"""Of fewer points with surfaces, no quantile is taken."""


def by_age(trust: F64, surfaces: Surfaces, age_s: float) -> F64:
    """Weights (N,) of points, lowered where the surfaces that they meet are young.

    A thing that moves without being known for it leaves new surfaces behind wherever it comes,
    and the next scan, in which it has moved on a little, is drawn along by them. What stands still
    keeps its surfaces, however the sensor moves. New surfaces also share the error of the last
    pose, which would be handed on.

    Args:
        trust: (N,) weights in [0, 1].
        surfaces: of N points, as searched last.
        age_s: age of the map; while that is less than _MATURE_S, its first surfaces count fully.
    """
    span_s = min(_MATURE_S, age_s)
    used = (surfaces.kind != NONE) & (trust > 0.5)
    if span_s <= 0.0 or used.sum() < _FEW:
        return trust
    share = np.clip((age_s - surfaces.born) / span_s, 0.0, 1.0)
    weight = _YOUNG + (1.0 - _YOUNG) * share
    known = weight[used]
    rank = int(_FULL * (len(known) - 1))
    full = max(float(np.partition(known, rank)[rank]), 1e-6)
    lowered: F64 = trust * np.minimum(1.0, weight / full)
    return lowered


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
