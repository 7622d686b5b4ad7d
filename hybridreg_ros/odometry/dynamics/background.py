# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Background: the large still surface behind things, found in spite of what stands before it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.odometry.map.planes import (
    MIN_PLANE_POINTS,
    around,
    buffer,
    is_plane,
    keep_within,
    plane_of,
)
from hybridreg_ros.odometry.registration.kernels import PLANE
from hybridreg_ros.odometry.registration.surfaces import Surfaces

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.map.local_map import VoxelLevel

_ROUNDS = 5
"""Most fits per place; each leaves out what the one before showed to stand before the surface."""
_LEVEL = np.cos(np.deg2rad(25.0))
"""A surface whose normal is nearer than this to the upward direction is ground."""


def lies_on_plane(
    points: NDArray[np.floating], level: VoxelLevel, update: int, slack_m: float
) -> NDArray[np.bool_]:
    """Which points lie on the surface of the stored point nearest to them.

    Args:
        points: (N, 3), odom frame, metres.
        level: level of the map whose cubes say how large the surface must be.
        update: number of updates of the map so far.
        slack_m: how far off the surface a point, and the points of the surface themselves (one
            standard deviation), may be, metres.
    """
    placed, found = np.ascontiguousarray(points, np.float64), Surfaces(len(points))
    found.search(placed, np.eye(4), (level, level, level), update)
    found.measure(placed, np.eye(4))
    thin = (found.kind == PLANE) & (found.variance < slack_m**2)
    on: NDArray[np.bool_] = thin & (found.residual < slack_m)
    return on


def lies_on_background(
    points: NDArray[np.floating],
    sensor: NDArray[np.float64],
    level: VoxelLevel,
    slack_m: float,
    up: NDArray[np.float64] | None = None,
) -> NDArray[np.bool_]:
    """Which points lie on the surface that closes the view around them.

    Floors and walls are behind whatever stands before them, seen from the sensor. So a plane is
    fitted to the stored points around, those that stand before it are left out, and it is fitted
    again: what is left is the floor, though feet and legs are in the map as well.

    Args:
        points: (N, 3), odom frame, metres.
        sensor: (3,) position of the sensor, odom frame, metres.
        level: level of the map whose cubes say how large the surface must be.
        slack_m: how far off the surface a point, and the points of the surface themselves (one
            standard deviation), may be, metres.
        up: (3,) unit vector, odom frame; then only ground counts. None = any surface.
    """
    out = np.zeros(len(points), np.bool_)
    places = np.ascontiguousarray(points, np.float64)
    axis, least = (np.zeros(3), 0.0) if up is None else (np.ascontiguousarray(up), _LEVEL)
    _lie_on(places, np.asarray(sensor, np.float64), slack_m, level.grid, axis, least, out)
    return out


@compiled
def _lie_on(places, sensor, slack, grid, up, least, out):  # type: ignore[no-untyped-def]
    """The kernel of `lies_on_background`."""
    found = buffer(grid)
    for row in range(len(places)):
        x, y, z = places[row, 0], places[row, 1], places[row, 2]
        n = around(x, y, z, grid, found)
        found[:n, 3] = 1.0  # feet that stand there for long have the mass of a floor
        for _ in range(_ROUNDS):
            if n < MIN_PLANE_POINTS:
                break
            l0, l1, l2, nx, ny, nz, offset = plane_of(found, n)
            if nx * (sensor[0] - x) + ny * (sensor[1] - y) + nz * (sensor[2] - z) < 0.0:
                nx, ny, nz, offset = -nx, -ny, -nz, -offset
            kept = keep_within(found, n, nx, ny, nz, -np.inf, offset + slack)
            if kept == n:
                upright = abs(nx * up[0] + ny * up[1] + nz * up[2]) >= least
                thin = l0 < slack * slack and abs(offset) < slack
                out[row] = upright and thin and is_plane(l0, l1, l2)
                break
            n = kept
