# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numba kernels of a hashed voxel grid: thinning, insertion, search, erasure."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray  # noqa: TC002 (numba reads the annotations of VoxelTable)

from hybridreg_ros.core.jit import compiled, compiled_inline
from hybridreg_ros.odometry.map.voxel_hash import EMPTY, add_voxel, find_voxel, voxel_key

SURFACE = np.dtype(
    [
        ('nx', np.float32),
        ('ny', np.float32),
        ('nz', np.float32),
        ('offset', np.float32),
        ('variance', np.float32),
        ('born', np.float32),
        ('fitted', np.int32),
        ('support', np.int32),
    ]
)
"""Surface of a stored point: unit normal, offset along it and variance across it; age of the map,
seconds, when the point was first seen; update after which the surface was fitted, 0 = not yet (of
a free row: the next free run); points it was fitted to, 0 = it is no plane."""


VOXEL = np.dtype(
    [
        ('key', np.int64),
        ('start', np.int32),
        ('count', np.int32),
        ('room', np.int32),
        ('unused', np.int32),
    ]
)
"""A voxel: its key, row of its first point, points, and rows it has room for."""


class VoxelTable(NamedTuple):
    """One level of the map as the kernels see it.

    Attributes:
        size: edge of a voxel, metres.
        most: most points of a voxel.
        slots: (C,) int32, hash table of voxels (`voxel_hash.find_voxel`), C a power of two.
        voxels: (V,) VOXEL.
        free: (F,) int32 rows that may be given to a voxel (`take`).
        store: (P, 4) float32 the points of all voxels, map frame, metres, and their mass: sum of
            the weights of what each is the mean of, at most MOST_MASS.
        beam: (P, 3) float32 unit direction, map frame, in which each was first seen.
        surface: (P,) SURFACE, what registrations ask of each: half a cache line.
        by_mass: whether stored points count by their mass in the fit of a surface, or alike.
    """

    size: float
    most: int
    slots: NDArray[np.int32]
    voxels: NDArray[np.void]
    free: NDArray[np.int32]
    store: NDArray[np.float32]
    beam: NDArray[np.float32]
    surface: NDArray[np.void]
    by_mass: bool


MOST_MASS = 30.0
"""Cap of the mass of a stored point, in measurements of weight 1: so the map can still follow."""


@compiled
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
    for row in range(len(points)):
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        key = voxel_key(x, y, z, inverse)
        if key == EMPTY:
            continue
        voxel = find_voxel(key, grid.slots, grid.voxels)
        if voxel < 0:
            if used >= len(grid.voxels) or not _give_rows(used, grid):
                return used, row
            voxel = used
            grid.voxels[voxel].key = key
            add_voxel(voxel, grid.slots, grid.voxels)
            used += 1
        start, count = grid.voxels[voxel].start, grid.voxels[voxel].count
        best, place = np.inf, start
        for i in range(start, start + count):
            dx = grid.store[i, 0] - x
            dy = grid.store[i, 1] - y
            dz = grid.store[i, 2] - z
            d = dx * dx + dy * dy + dz * dz
            if d < best:
                best, place = d, i
        full = count >= grid.most
        if best < (4.0 if full else 1.0) * spacing_sq:
            mass = grid.store[place, 3]
            share = weights[row] / (mass + weights[row])
            grid.store[place, 0] += share * (x - grid.store[place, 0])
            grid.store[place, 1] += share * (y - grid.store[place, 1])
            grid.store[place, 2] += share * (z - grid.store[place, 2])
            grid.store[place, 3] = min(mass + weights[row], MOST_MASS)
        elif not full:
            if count >= grid.voxels[voxel].room and not _move(voxel, grid):
                return used, row
            place = grid.voxels[voxel].start + count
            grid.store[place, 0] = x
            grid.store[place, 1] = y
            grid.store[place, 2] = z
            grid.store[place, 3] = weights[row]
            bx, by, bz = x - origin[0], y - origin[1], z - origin[2]
            far = max(np.sqrt(bx * bx + by * by + bz * bz), 1e-6)
            grid.beam[place, 0] = bx / far
            grid.beam[place, 1] = by / far
            grid.beam[place, 2] = bz / far
            grid.surface[place].born = now_s
            grid.surface[place].fitted = 0
            grid.voxels[voxel].count = count + 1
    return used, len(points)


@compiled_inline
def _give_rows(voxel, grid):  # type: ignore[no-untyped-def]
    """Give a new voxel its first row; false when there is none."""
    start = take(1, grid.free, grid.surface)
    if start < 0:
        return False
    grid.voxels[voxel].start, grid.voxels[voxel].count, grid.voxels[voxel].room = start, 0, 1
    return True


@compiled_inline
def _move(voxel, grid):  # type: ignore[no-untyped-def]
    """Move a full voxel to more rows; false when there are none."""
    own = grid.voxels[voxel]
    start, count, room = own.start, own.count, own.room
    larger = longer(room, grid.most)
    to = take(larger, grid.free, grid.surface)
    if to < 0:
        return False
    for i in range(count):
        _copy(grid, start + i, grid, to + i)
    give_back(start, room, grid.free, grid.surface)
    grid.voxels[voxel].start, grid.voxels[voxel].room = to, larger
    return True


@compiled_inline
def _copy(source, i, grid, k):  # type: ignore[no-untyped-def]
    """Copy point i of one grid to row k of another, or of the same one, and its surface if any."""
    for axis in range(4):
        grid.store[k, axis] = source.store[i, axis]
    for axis in range(3):
        grid.beam[k, axis] = source.beam[i, axis]
    grid.surface[k] = source.surface[i]


@compiled
def pack(source, grid, used):  # type: ignore[no-untyped-def]
    """Copy the points of all voxels side by side into a grid that shares the voxels of its source.

    Args:
        source: the level as it is.
        grid: the same with other arrays of points and no row taken.
        used: voxels in use.
    """
    for voxel in range(used):
        start, count = source.voxels[voxel].start, source.voxels[voxel].count
        room = max(1, count)
        to = take(room, grid.free, grid.surface)
        for i in range(count):
            _copy(source, start + i, grid, to + i)
        grid.voxels[voxel].start, grid.voxels[voxel].room = to, room


@compiled
def keep_near(centre, reach_sq, grid, used):  # type: ignore[no-untyped-def]
    """Drop empty voxels and voxels whose first point is farther than the reach; voxels in use."""
    grid.slots[:] = -1
    kept = 0
    for voxel in range(used):
        own = grid.voxels[voxel]
        start, count, room = own.start, own.count, own.room
        dx = grid.store[start, 0] - centre[0]
        dy = grid.store[start, 1] - centre[1]
        dz = grid.store[start, 2] - centre[2]
        if count == 0 or dx * dx + dy * dy + dz * dz > reach_sq:
            give_back(start, room, grid.free, grid.surface)
            continue
        grid.voxels[kept] = grid.voxels[voxel]
        add_voxel(kept, grid.slots, grid.voxels)
        kept += 1
    return kept


@compiled
def erase_near(points, reach_sq, grid):  # type: ignore[no-untyped-def]
    """Remove stored points within the reach of any of the points (N, 3); returns how many."""
    inverse = 1.0 / grid.size
    removed = 0
    for row in range(len(points)):
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        key = voxel_key(x, y, z, inverse)
        if key == EMPTY:
            continue
        voxel = find_voxel(key, grid.slots, grid.voxels)
        if voxel < 0:
            continue
        i = grid.voxels[voxel].start
        end = i + grid.voxels[voxel].count
        while i < end:
            dx = grid.store[i, 0] - x
            dy = grid.store[i, 1] - y
            dz = grid.store[i, 2] - z
            if dx * dx + dy * dy + dz * dz <= reach_sq:
                end -= 1
                _copy(grid, end, grid, i)
                grid.surface[i].fitted = 0
                grid.voxels[voxel].count -= 1
                removed += 1
            else:
                i += 1
    return removed


@compiled
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


@compiled_inline
def nearest(x, y, z, grid):  # type: ignore[no-untyped-def]
    """Stored point nearest to a place, within one voxel edge.

    Returns:
        Its row and its voxel (-1 = none), squared distance (the squared edge when there is none).
    """
    size = grid.size
    best = size * size
    place, home = -1, -1
    centre = voxel_key(x, y, z, 1.0 / size)
    if centre == EMPTY:
        return place, home, best
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
                    key = centre + (di << 42) + (dj << 21) + dk
                    voxel = find_voxel(key, grid.slots, grid.voxels)
                    if voxel < 0:
                        continue
                    start = grid.voxels[voxel].start
                    for i in range(start, start + grid.voxels[voxel].count):
                        dx = grid.store[i, 0] - x
                        dy = grid.store[i, 1] - y
                        dz = grid.store[i, 2] - z
                        d = dx * dx + dy * dy + dz * dz
                        if d < best:
                            best, place, home = d, i, voxel
    return place, home, best


@compiled
def gather(voxels, store, used):  # type: ignore[no-untyped-def]
    """All stored points as (N, 3) float32."""
    points = np.empty((voxels['count'][:used].sum(), 3), np.float32)
    row = 0
    for voxel in range(used):
        start, count = voxels[voxel].start, voxels[voxel].count
        points[row : row + count] = store[start : start + count, :3]
        row += count
    return points


@compiled
def none_taken(longest):  # type: ignore[no-untyped-def]
    """Free rows (F,) int32 while none is in use: heads of chains, and the first row never taken.

    Args:
        longest: rows of the longest run. Entry n is the first row of a run of n that was given
            back, -1 = there is none; the last entry is the first row that was never taken.
    """
    free = np.full(longest + 2, -1, np.int32)
    free[-1] = 0
    return free


@compiled_inline
def longer(room, longest):  # type: ignore[no-untyped-def]
    """Rows of the next longer run: half as many again."""
    return min(room + max(1, room // 2), longest)


@compiled_inline
def take(room, free, surface):  # type: ignore[no-untyped-def]
    """First row of a run of so many rows, or -1 when the arrays are full.

    Args:
        room: rows wanted.
        free: (F,) as `none_taken` gives it, changed in place.
        surface: (P,) SURFACE; `fitted` of the first row of a free run is that of the next run.
    """
    row = free[room]
    if row >= 0:
        free[room] = surface[row].fitted
        return row
    row = free[-1]
    if row + room > len(surface):
        return -1
    free[-1] = row + room
    return row


@compiled_inline
def give_back(row, room, free, surface):  # type: ignore[no-untyped-def]
    """Let a run of `room` rows from `row` on be taken again; other arguments as in `take`."""
    surface[row].fitted = free[room]
    free[room] = row
