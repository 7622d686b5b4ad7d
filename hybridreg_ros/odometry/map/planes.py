# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numba kernels that fit planes to the stored points around a place."""

# ruff: noqa: D417 (kernels take plain arrays, named in `VoxelLevel`)
from __future__ import annotations

import numpy as np

from hybridreg_ros.core.eigen import smallest_axis
from hybridreg_ros.core.jit import compiled, compiled_inline
from hybridreg_ros.odometry.map.voxel_hash import EMPTY, find_voxel, voxel_key

MIN_PLANE_POINTS = 6
FLATNESS = 0.15
"""A neighbourhood is a plane when its variance across is below this share of the next one."""
BREADTH = 0.02
"""And not a line: the variance along it is at most 1 / BREADTH times the next one."""
TRIM = 2.0
"""Points farther off a plane, in standard deviations, are left out and it is fitted again."""
ROUNDS = 3
"""Most such fits."""
LEAST_LEFT = 0.5
"""Share of the points that must be left: a plane is what most of them lie on."""


@compiled
def buffer(grid):  # type: ignore[no-untyped-def]
    """Room (P, 4) for as many points as there can be around a place, and one more."""
    return np.empty((27 * grid.most + 1, 4))


@compiled_inline
def around(x, y, z, grid, found):  # type: ignore[no-untyped-def]
    """Stored points within one cube edge of a place.

    Args:
        x, y, z: the place, map frame, metres.
        grid: the level.
        found: (P, 4) float64 out, as `buffer` gives it: offsets from the place, metres, and weight
            in means (mass where the level fits by mass, else 1).

    Returns:
        How many.
    """
    size = grid.size
    centre = voxel_key(x, y, z, 1.0 / size)
    if centre == EMPTY:
        return 0
    reach_sq = size * size
    fx, fy, fz = x / size, y / size, z / size
    fx, fy, fz = fx - np.floor(fx), fy - np.floor(fy), fz - np.floor(fz)
    count = 0
    for di in range(-1, 2):
        gx = 0.0 if di == 0 else (fx if di < 0 else 1.0 - fx)
        for dj in range(-1, 2):
            gy = 0.0 if dj == 0 else (fy if dj < 0 else 1.0 - fy)
            for dk in range(-1, 2):
                gz = 0.0 if dk == 0 else (fz if dk < 0 else 1.0 - fz)
                if gx * gx + gy * gy + gz * gz > 1.0:
                    continue
                key = centre + (di << 42) + (dj << 21) + dk
                voxel = find_voxel(key, grid.slots, grid.voxels)
                if voxel < 0:
                    continue
                start = grid.voxels[voxel].start
                for i in range(start, start + grid.voxels[voxel].count):
                    dx = grid.store[i, 0] - x
                    dy = grid.store[i, 1] - y
                    dz = grid.store[i, 2] - z
                    found[count, 0], found[count, 1], found[count, 2] = dx, dy, dz
                    found[count, 3] = float(grid.store[i, 3]) if grid.by_mass else 1.0
                    count += dx * dx + dy * dy + dz * dz <= reach_sq
    return count


@compiled_inline
def plane_of(points, n):  # type: ignore[no-untyped-def]
    """Plane through the first n points (P, 4), with their weights.

    Returns:
        Variances l0 <= l1 <= l2 along its axes, unit normal, offset of the plane along it.
    """
    mass, sx, sy, sz = 0.0, 0.0, 0.0, 0.0
    sxx, sxy, sxz, syy, syz, szz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        dx, dy, dz, w = points[i, 0], points[i, 1], points[i, 2], points[i, 3]
        mass += w
        wx, wy, wz = w * dx, w * dy, w * dz
        sx, sy, sz = sx + wx, sy + wy, sz + wz
        sxx, sxy, sxz = sxx + wx * dx, sxy + wx * dy, sxz + wx * dz
        syy, syz, szz = syy + wy * dy, syz + wy * dz, szz + wz * dz
    mx, my, mz = sx / mass, sy / mass, sz / mass
    l0, l1, l2, nx, ny, nz = smallest_axis(
        sxx / mass - mx * mx,
        sxy / mass - mx * my,
        sxz / mass - mx * mz,
        syy / mass - my * my,
        syz / mass - my * mz,
        szz / mass - mz * mz,
    )
    return l0, l1, l2, nx, ny, nz, mx * nx + my * ny + mz * nz


@compiled_inline
def is_plane(l0, l1, l2):  # type: ignore[no-untyped-def]
    """Whether points with these variances along their axes, ascending, lie on a plane."""
    return l1 > 0.0 and l0 <= FLATNESS * l1 and l1 >= BREADTH * l2


@compiled_inline
def keep_within(points, n, nx, ny, nz, low, high):  # type: ignore[no-untyped-def]
    """Move those of the first n points (P, 4) to the front whose height is in (low, high).

    Returns:
        How many.
    """
    kept = 0
    for i in range(n):
        if low < points[i, 0] * nx + points[i, 1] * ny + points[i, 2] * nz < high:
            for axis in range(4):
                points[kept, axis] = points[i, axis]
            kept += 1
    return kept


@compiled_inline
def fit_around(x, y, z, grid, found):  # type: ignore[no-untyped-def]
    """Plane through the stored points within one cube edge of a place.

    Stored points keep a distance from each other, so where noise has made them lie deep, the few
    that are far off would count like those in which most measurements came together; by mass they
    do not. The map of a lidar has no such mass: what lies off the plane (feet on the ground,
    leaves before a wall) is left out, and the rest is fitted again.

    Args:
        x, y, z: the place, map frame, metres.
        grid: the level.
        found: (P, 4) room, as `buffer` gives it.

    Returns:
        Number of points on it (0 when they are not flat), unit normal, offset of the plane from
        the place along the normal, variance across it.
    """
    n = around(x, y, z, grid, found)
    if n < MIN_PLANE_POINTS:
        return 0, 0.0, 0.0, 0.0, 0.0, 0.0
    l0, l1, l2, nx, ny, nz, offset = plane_of(found, n)
    if not is_plane(l0, l1, l2):
        return 0, 0.0, 0.0, 0.0, 0.0, 0.0
    if not grid.by_mass:
        least = max(MIN_PLANE_POINTS, int(LEAST_LEFT * n))
        for _ in range(ROUNDS):
            slack = TRIM * np.sqrt(max(l0, 0.0))
            kept = keep_within(found, n, nx, ny, nz, offset - slack, offset + slack)
            if kept == n or kept < least:
                break
            v0, v1, v2, ax, ay, az, middle = plane_of(found, kept)
            if not is_plane(v0, v1, v2):
                break
            n, nx, ny, nz, offset, l0 = kept, ax, ay, az, middle, v0
    return n, nx, ny, nz, offset, max(l0, 0.0)
