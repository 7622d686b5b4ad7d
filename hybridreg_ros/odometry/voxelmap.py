# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numba kernels of a hashed voxel grid: thinning, insertion, search, erasure."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray  # noqa: TC002 (numba reads the annotations of Grid)


class Grid(NamedTuple):
    """One level of the map as the kernels see it.

    Attributes:
        size: edge of a voxel, metres.
        table: (C,) int64, open-addressing hash table of voxel keys, C a power of two.
        slots: (C,) int32, voxel number of each table entry.
        keys: (V,) int64 key of each voxel.
        counts: (V,) int32 points in each voxel.
        store: (V, K, 3) float32 those points, map frame, metres.
        mass: (V, K) float32, sum of the weights of what each is the mean of, at most MOST_MASS.
        beam: (V, K, 3) float32 unit direction, map frame, in which each was first seen.
        born: (V, K) float32 age of the map, seconds, when each was first seen.
        surface: (V, K, 5) float32 unit normal, offset of the surface along it, variance across it.
        kind: (V, K) int8, POINT or PLANE once fitted.
        fitted: (V, K) int32, update after which the surface was fitted, 0 = not yet.
        support: (V, K) int16, points it was fitted to.
        by_mass: whether stored points count by their mass in the fit of a surface, or alike.
    """

    size: float
    table: NDArray[np.int64]
    slots: NDArray[np.int32]
    keys: NDArray[np.int64]
    counts: NDArray[np.int32]
    store: NDArray[np.float32]
    mass: NDArray[np.float32]
    beam: NDArray[np.float32]
    born: NDArray[np.float32]
    surface: NDArray[np.float32]
    kind: NDArray[np.int8]
    fitted: NDArray[np.int32]
    support: NDArray[np.int16]
    by_mass: bool


HALF_SPAN = 1 << 20
"""Voxel indices must lie in (-HALF_SPAN, HALF_SPAN): 21 bits per axis in one int64 key."""
EMPTY = -1
MOST_MASS = 30.0
"""Cap of the mass of a stored point, in measurements of weight 1: so the map can still follow."""

_jit = numba.njit(cache=True, nogil=True)


@_jit
def voxel_key(x, y, z, inverse_size):  # type: ignore[no-untyped-def]
    """Key of the voxel that holds a point (int64), or EMPTY when it lies outside the grid."""
    i = int(np.floor(x * inverse_size)) + HALF_SPAN
    j = int(np.floor(y * inverse_size)) + HALF_SPAN
    k = int(np.floor(z * inverse_size)) + HALF_SPAN
    limit = 2 * HALF_SPAN
    if i <= 0 or j <= 0 or k <= 0 or i >= limit - 1 or j >= limit - 1 or k >= limit - 1:
        return EMPTY
    return (i << 42) | (j << 21) | k


@_jit
def empty_table(count):  # type: ignore[no-untyped-def]
    """Keys (C,) int64, all `EMPTY`, and values (C,) int32 of a hash table for `count` entries."""
    capacity = 16
    while capacity < 2 * count:
        capacity *= 2
    return np.full(capacity, EMPTY, np.int64), np.zeros(capacity, np.int32)


@_jit
def find_slot(table, key):  # type: ignore[no-untyped-def]
    """Slot of a key in the open-addressing table (C,), or the free slot where it belongs."""
    mask = len(table) - 1
    slot = ((key * -7046029254386353131) >> 40) & mask
    while table[slot] != EMPTY and table[slot] != key:
        slot = (slot + 1) & mask
    return slot


@_jit
def insert(points, weights, origin, now_s, spacing_sq, grid, used):  # type: ignore[no-untyped-def]
    """Add points (N, 3) to the grid; where one is stored already, that one becomes a mean.

    A point joins the nearest stored one of its voxel when it is nearer than the spacing, or than
    twice the spacing when the voxel is full. A stored point so becomes the weighted mean of what
    was measured around it, and the noise of single scans goes out of the map.

    Args:
        points: (N, 3) float, map frame.
        weights: (N,) of each point in a mean.
        origin: (3,) place of the sensor, map frame.
        now_s: age of the map, seconds.
        spacing_sq: smallest squared distance between two points of one voxel.
        grid: the level.
        used: voxels in use.

    Returns:
        Voxels in use afterwards, and the row it stopped at (N unless the arrays are full).
    """
    inverse = 1.0 / grid.size
    room = min(len(grid.counts), len(grid.table) // 2)
    for row in range(len(points)):
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        key = voxel_key(x, y, z, inverse)
        if key == EMPTY:
            continue
        slot = find_slot(grid.table, key)
        if grid.table[slot] == EMPTY:
            if used >= room:
                return used, row
            grid.table[slot] = key
            grid.slots[slot] = used
            grid.keys[used] = key
            grid.counts[used] = 0
            used += 1
        voxel = grid.slots[slot]
        count = grid.counts[voxel]
        best, place = np.inf, 0
        for i in range(count):
            dx = grid.store[voxel, i, 0] - x
            dy = grid.store[voxel, i, 1] - y
            dz = grid.store[voxel, i, 2] - z
            d = dx * dx + dy * dy + dz * dz
            if d < best:
                best, place = d, i
        full = count >= grid.store.shape[1]
        if best < (4.0 if full else 1.0) * spacing_sq:
            mass = grid.mass[voxel, place]
            share = weights[row] / (mass + weights[row])
            grid.store[voxel, place, 0] += share * (x - grid.store[voxel, place, 0])
            grid.store[voxel, place, 1] += share * (y - grid.store[voxel, place, 1])
            grid.store[voxel, place, 2] += share * (z - grid.store[voxel, place, 2])
            grid.mass[voxel, place] = min(mass + weights[row], MOST_MASS)
        elif not full:
            grid.store[voxel, count, 0] = x
            grid.store[voxel, count, 1] = y
            grid.store[voxel, count, 2] = z
            grid.mass[voxel, count] = weights[row]
            bx, by, bz = x - origin[0], y - origin[1], z - origin[2]
            far = max(np.sqrt(bx * bx + by * by + bz * bz), 1e-6)
            grid.beam[voxel, count, 0] = bx / far
            grid.beam[voxel, count, 1] = by / far
            grid.beam[voxel, count, 2] = bz / far
            grid.born[voxel, count] = now_s
            grid.fitted[voxel, count] = 0
            grid.counts[voxel] = count + 1
    return used, len(points)


@_jit
def keep_near(centre, reach_sq, grid, used):  # type: ignore[no-untyped-def]
    """Drop empty voxels and voxels whose first point is farther than the reach; voxels in use."""
    grid.table[:] = EMPTY
    kept = 0
    for voxel in range(used):
        if grid.counts[voxel] == 0:
            continue
        dx = grid.store[voxel, 0, 0] - centre[0]
        dy = grid.store[voxel, 0, 1] - centre[1]
        dz = grid.store[voxel, 0, 2] - centre[2]
        if dx * dx + dy * dy + dz * dz > reach_sq:
            continue
        if kept != voxel:
            grid.keys[kept] = grid.keys[voxel]
            grid.counts[kept] = grid.counts[voxel]
            grid.store[kept] = grid.store[voxel]
            grid.mass[kept] = grid.mass[voxel]
            grid.beam[kept] = grid.beam[voxel]
            grid.born[kept] = grid.born[voxel]
            grid.surface[kept] = grid.surface[voxel]
            grid.kind[kept] = grid.kind[voxel]
            grid.fitted[kept] = grid.fitted[voxel]
            grid.support[kept] = grid.support[voxel]
        slot = find_slot(grid.table, grid.keys[kept])
        grid.table[slot] = grid.keys[kept]
        grid.slots[slot] = kept
        kept += 1
    return kept


@_jit
def erase_near(points, reach_sq, grid):  # type: ignore[no-untyped-def]
    """Remove stored points within the reach of any of the points (N, 3); returns how many."""
    inverse = 1.0 / grid.size
    removed = 0
    for row in range(len(points)):
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        key = voxel_key(x, y, z, inverse)
        if key == EMPTY:
            continue
        slot = find_slot(grid.table, key)
        if grid.table[slot] == EMPTY:
            continue
        voxel = grid.slots[slot]
        i = 0
        while i < grid.counts[voxel]:
            dx = grid.store[voxel, i, 0] - x
            dy = grid.store[voxel, i, 1] - y
            dz = grid.store[voxel, i, 2] - z
            if dx * dx + dy * dy + dz * dz <= reach_sq:
                grid.counts[voxel] -= 1
                grid.store[voxel, i] = grid.store[voxel, grid.counts[voxel]]
                grid.mass[voxel, i] = grid.mass[voxel, grid.counts[voxel]]
                grid.beam[voxel, i] = grid.beam[voxel, grid.counts[voxel]]
                grid.born[voxel, i] = grid.born[voxel, grid.counts[voxel]]
                grid.fitted[voxel, i] = 0
                removed += 1
            else:
                i += 1
    return removed


@_jit
def mean_distance(points, R, t, grid):  # type: ignore[no-untyped-def]
    """Mean distance of moved points (N, 3) to the nearest stored point, cut off at a voxel."""
    total = 0.0
    for row in range(len(points)):
        px, py, pz = points[row, 0], points[row, 1], points[row, 2]
        x = R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz + t[0]
        y = R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz + t[1]
        z = R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz + t[2]
        total += np.sqrt(nearest(x, y, z, grid)[2])
    return total / max(1, len(points))


@_jit
def nearest(x, y, z, grid):  # type: ignore[no-untyped-def]
    """Stored point nearest to a place, within one voxel edge.

    Returns:
        Voxel (-1 = none), number in it, squared distance (the squared edge when there is none).
    """
    size = grid.size
    best = size * size
    voxel_found, place = -1, 0
    centre = voxel_key(x, y, z, 1.0 / size)
    if centre == EMPTY:
        return voxel_found, place, best
    # Distance to the lower and upper face of the own voxel: a neighbour cannot be nearer.
    fx = x / size - np.floor(x / size)
    fy = y / size - np.floor(y / size)
    fz = z / size - np.floor(z / size)
    for turn in range(2):
        for di in range(-1, 2):
            gx = 0.0 if di == 0 else (fx if di < 0 else 1.0 - fx)
            for dj in range(-1, 2):
                gy = 0.0 if dj == 0 else (fy if dj < 0 else 1.0 - fy)
                for dk in range(-1, 2):
                    own = di == 0 and dj == 0 and dk == 0
                    if own != (turn == 0):
                        continue
                    gz = 0.0 if dk == 0 else (fz if dk < 0 else 1.0 - fz)
                    if (gx * gx + gy * gy + gz * gz) * size * size >= best:
                        continue
                    slot = find_slot(grid.table, centre + (di << 42) + (dj << 21) + dk)
                    if grid.table[slot] == EMPTY:
                        continue
                    voxel = grid.slots[slot]
                    for i in range(grid.counts[voxel]):
                        dx = grid.store[voxel, i, 0] - x
                        dy = grid.store[voxel, i, 1] - y
                        dz = grid.store[voxel, i, 2] - z
                        d = dx * dx + dy * dy + dz * dz
                        if d < best:
                            best, voxel_found, place = d, voxel, i
    return voxel_found, place, best


@_jit
def gather(counts, store, used):  # type: ignore[no-untyped-def]
    """All stored points as (N, 3) float32."""
    total = 0
    for voxel in range(used):
        total += counts[voxel]
    points = np.empty((total, 3), np.float32)
    row = 0
    for voxel in range(used):
        for i in range(counts[voxel]):
            points[row] = store[voxel, i]
            row += 1
    return points
