# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Cluster-robust covariance: how much the parts of a scan disagree about its pose."""

from __future__ import annotations

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.odometry.map.thinning import occupied
from hybridreg_ros.odometry.registration.kernels import moved, scaled, units_of

_PART = 8.0
"""Edge of a part, in voxels: points in it (of one thing, of one stretch of wall) err alike."""
_FEWEST = 3
"""Fewer parts cannot disagree."""
_CAP = 10.0
"""Largest standard deviation, metres and rad."""
_TINY = 1e-6


@compiled
def cluster_covariance(points, weights, T, surfaces, scales, H, size_m):  # type: ignore[no-untyped-def]
    """Covariance of a pose, from the pull of each part of the scan.

    The inverse of the information H says how well a pose is held if every point errs on its own.
    Here the points of a part err alike: the covariance is that of the sum of the parts'
    gradients, carried through H (the cluster-robust sandwich of Liang and Zeger, Biometrika 73,
    1986). Where a crowd pulls one way and the walls the other it is large, however stiff H is.

    Args:
        points: (N, 3) sensor frame, metres.
        weights: (N,) trust in [0, 1]; 0 where the surface is no plane.
        T: (4, 4) the pose.
        surfaces: of the points, as searched at the pose.
        scales: (N,) standard deviation of a good residual, metres.
        H: (6, 6) information at the pose (position, turn about the sensor; odom axes).
        size_m: voxel edge.

    Returns:
        (6, 6) covariance, odom axes; the cap on its diagonal where there are too few parts.
    """
    _, _, keys, _, _, part = occupied(points, _PART * size_m, weights > 0.0)
    count = len(keys)
    if count < _FEWEST:
        return np.eye(6) * _CAP**2
    sums = np.zeros((6, count))
    for row in range(len(points)):
        k = part[row]
        if k < 0:
            continue
        x, y, z = moved(points, row, T)
        ax, ay, az = x - T[0, 3], y - T[1, 3], z - T[2, 3]
        nx, ny, nz = surfaces.normal[row]
        r = nx * (x - surfaces.anchor[row, 0])
        r += ny * (y - surfaces.anchor[row, 1]) + nz * (z - surfaces.anchor[row, 2])
        variance = scales[row] ** 2 + surfaces.variance[row]
        kernel = 9.0 * variance / (9.0 * variance + r * r)
        pull = weights[row] * kernel * kernel / variance * r
        sums[0, k] += pull * nx
        sums[1, k] += pull * ny
        sums[2, k] += pull * nz
        sums[3, k] += pull * (ay * nz - az * ny)
        sums[4, k] += pull * (az * nx - ax * nz)
        sums[5, k] += pull * (ax * ny - ay * nx)
    unit = units_of(H, 1e-9)
    for i in range(6):
        mean = sums[i].mean()
        for k in range(count):
            sums[i, k] = (sums[i, k] - mean) / unit[i]
    step = np.linalg.inv(scaled(H, unit, _TINY)) @ sums
    for i in range(6):
        for k in range(count):
            step[i, k] = min(max(step[i, k] / unit[i], -_CAP), _CAP)
    return step @ step.T * (count / (count - 1.0))
