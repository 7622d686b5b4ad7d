# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Backdrop: the large still surface behind things, found in spite of what stands before it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

from hybridreg_ros.core.eigen import smallest_axis
from hybridreg_ros.odometry.align import BREADTH, FLATNESS, MIN_PLANE_POINTS, PLANE, associate
from hybridreg_ros.odometry.voxelmap import EMPTY, find_slot, voxel_key

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.localmap import VoxelLevel

_jit = numba.njit(cache=True, nogil=True)

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
    n, placed = len(points), np.ascontiguousarray(points, np.float64)
    kind, variance = np.zeros(n, np.int8), np.zeros(n)
    anchor, normal = np.zeros((n, 3)), np.zeros((n, 3))
    associate(
        placed, np.eye(3), np.zeros(3), level.grid, level.grid, level.grid, update,
        kind, anchor, normal, variance, np.zeros(n),
    )  # fmt: skip
    off = np.abs(np.einsum('ij,ij->i', placed - anchor, normal))
    on: NDArray[np.bool_] = (kind == PLANE) & (variance < slack_m**2) & (off < slack_m)
    return on


def lies_on_backdrop(
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


@_jit
def _around(x, y, z, grid, found):  # type: ignore[no-untyped-def]
    """Offsets of the stored points within one cube edge of a place into `found`; how many."""
    centre = voxel_key(x, y, z, 1.0 / grid.size)
    count = 0
    if centre == EMPTY:
        return 0
    for di in range(-1, 2):
        for dj in range(-1, 2):
            for dk in range(-1, 2):
                slot = find_slot(grid.table, centre + (di << 42) + (dj << 21) + dk)
                if grid.table[slot] == EMPTY:
                    continue
                voxel = grid.slots[slot]
                for i in range(grid.counts[voxel]):
                    dx = grid.store[voxel, i, 0] - x
                    dy = grid.store[voxel, i, 1] - y
                    dz = grid.store[voxel, i, 2] - z
                    if dx * dx + dy * dy + dz * dz <= grid.size * grid.size:
                        found[count, 0], found[count, 1], found[count, 2] = dx, dy, dz
                        count += 1
    return count


@_jit
def _lie_on(places, sensor, slack, grid, up, least, out):  # type: ignore[no-untyped-def]
    """The kernel of `lies_on_backdrop`."""
    around = np.empty((27 * grid.store.shape[1], 3))
    for row in range(len(places)):
        x, y, z = places[row, 0], places[row, 1], places[row, 2]
        n = _around(x, y, z, grid, around)
        for _ in range(_ROUNDS):
            if n < MIN_PLANE_POINTS:
                break
            mx, my, mz = 0.0, 0.0, 0.0
            for i in range(n):
                mx, my, mz = mx + around[i, 0], my + around[i, 1], mz + around[i, 2]
            mx, my, mz = mx / n, my / n, mz / n
            xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(n):
                dx, dy, dz = around[i, 0] - mx, around[i, 1] - my, around[i, 2] - mz
                xx, xy, xz = xx + dx * dx, xy + dx * dy, xz + dx * dz
                yy, yz, zz = yy + dy * dy, yz + dy * dz, zz + dz * dz
            l0, l1, l2, nx, ny, nz = smallest_axis(xx / n, xy / n, xz / n, yy / n, yz / n, zz / n)
            if nx * (sensor[0] - x) + ny * (sensor[1] - y) + nz * (sensor[2] - z) < 0.0:
                nx, ny, nz = -nx, -ny, -nz
            offset = mx * nx + my * ny + mz * nz
            kept = 0
            for i in range(n):
                if around[i, 0] * nx + around[i, 1] * ny + around[i, 2] * nz - offset < slack:
                    around[kept, 0], around[kept, 1], around[kept, 2] = (
                        around[i, 0], around[i, 1], around[i, 2],
                    )  # fmt: skip
                    kept += 1
            if kept == n:
                flat = l1 > 0.0 and l0 < FLATNESS * l1 and l1 > BREADTH * l2
                upright = abs(nx * up[0] + ny * up[1] + nz * up[2]) >= least
                out[row] = flat and upright and l0 < slack * slack and abs(offset) < slack
                break
            n = kept
