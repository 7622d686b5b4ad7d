# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Cluster-robust covariance: how much the parts of a scan disagree about its pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.odometry.map.thinning import occupied

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.registration.surfaces import Surfaces

    F64 = NDArray[np.float64]

_PART = 8.0
"""Edge of a part, in voxels: points in it (of one thing, of one stretch of wall) err alike."""
_FEWEST = 3
"""Fewer parts cannot disagree."""
_CAP = 10.0
"""Largest standard deviation, metres and rad."""
_TINY = 1e-6


def cluster_covariance(
    points: F64,
    weights: F64,
    T_odom_sensor: F64,
    surfaces: Surfaces,
    scales: F64,
    H: F64,
    size_m: float,
) -> F64:
    """Covariance of a pose, from the pull of each part of the scan.

    The inverse of the information H says how well a pose is held if every point errs on its own.
    Here the points of a part err alike: the covariance is that of the sum of the parts'
    gradients, carried through H (the cluster-robust sandwich of Liang and Zeger, Biometrika 73,
    1986). Where a crowd pulls one way and the walls the other it is large, however stiff H is.

    Args:
        points: (N, 3) sensor frame, metres.
        weights: (N,) trust in [0, 1]; 0 where the surface is no plane.
        T_odom_sensor: (4, 4) the pose.
        surfaces: of the points, as searched at the pose.
        scales: (N,) standard deviation of a good residual, metres.
        H: (6, 6) information at the pose (position, turn about the sensor; odom axes).
        size_m: voxel edge.

    Returns:
        (6, 6) covariance, odom axes; the cap on its diagonal where there are too few parts.
    """
    used = weights > 0.0
    part, count = _parts(points, used, _PART * size_m)
    if count < _FEWEST:
        return np.eye(6) * _CAP**2
    rows = np.flatnonzero(used)
    arm = points[rows] @ T_odom_sensor[:3, :3].T
    normal = surfaces.normal[rows]
    off = arm + T_odom_sensor[:3, 3] - surfaces.anchor[rows]
    residual = np.einsum('ij,ij->i', off, normal)
    variance = scales[rows] ** 2 + surfaces.variance[rows]
    kernel = 9.0 * variance / (9.0 * variance + residual**2)
    pull = weights[rows] * kernel**2 / variance * residual
    gradient = pull[:, None] * np.hstack([normal, np.cross(arm, normal)])
    sums = np.stack([np.bincount(part[rows], g, count) for g in gradient.T], axis=1)
    sums -= sums.mean(axis=0)
    unit = np.sqrt(np.maximum(np.diag(H), 1e-9))
    step = np.linalg.solve(H / np.outer(unit, unit) + _TINY * np.eye(6), (sums / unit).T)
    step = np.clip(step / unit[:, None], -_CAP, _CAP)
    covariance: F64 = step @ step.T * (count / (count - 1.0))
    return covariance


def _parts(points: F64, used: NDArray[np.bool_], size_m: float) -> tuple[NDArray[np.int32], int]:
    """Cube of each used point (N,), and how many cubes there are."""
    _, _, keys, _, _, part = occupied(points, size_m, used)
    return part, len(keys)
