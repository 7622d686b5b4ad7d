# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numba kernels that sort a cloud into voxels: the first point and the mean of each."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled, compiled_fast
from hybridreg_ros.odometry.map.voxel_hash import (
    EMPTY,
    HALF_SPAN,
    empty_table,
    find_slot,
    voxel_key,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

_ROOM = 4096
"""Voxels that the hash table has room for at first: a small one stays in the processor's cache."""


@compiled
def occupied(points, size, member):  # type: ignore[no-untyped-def]
    """Voxels of a grid that hold points.

    Args:
        points: (N, 3), metres.
        size: edge of a voxel, metres.
        member: (N,) bool, points that count.

    Returns:
        table (C,) int64 and slots (C,) int32 (hash table of voxel keys), keys (M,) int64, rows
        (M,) int64 of the first point and counts (M,) int32 of the points of each voxel, in the
        order of first points, and the voxel of each point (N,) int32, -1 outside the grid.
    """
    n = len(points)
    key_of = _keys_of(points, size, member)
    keys, rows, counts = np.empty(n, np.int64), np.empty(n, np.int64), np.zeros(n, np.int32)
    voxel = np.full(n, -1, np.int32)
    table, slots = empty_table(_ROOM)
    found = keys, rows, counts, voxel
    used, row = _sorted_in(key_of, 0, 0, table, slots, found)
    while row < n:
        table, slots = empty_table(2 * used)
        for k in range(used):
            slot = find_slot(table, keys[k])
            table[slot], slots[slot] = keys[k], k
        used, row = _sorted_in(key_of, row, used, table, slots, found)
    return table, slots, keys[:used].copy(), rows[:used].copy(), counts[:used].copy(), voxel


@compiled
def _sorted_in(key_of, row, used, table, slots, found):  # type: ignore[no-untyped-def]
    """Sort points from a row on into voxels, until all are or the table is half full.

    In a loop that puts a larger table in the place of the old one, each round counts references:
    five times the time.

    Returns:
        Voxels in use, and the first row that is left.
    """
    keys, rows, counts, voxel = found
    last_key, last = np.int64(EMPTY), np.int64(-1)
    for at in range(row, len(key_of)):
        key = key_of[at]
        if key == EMPTY:
            continue
        if key != last_key:  # neighbours in a scan mostly share a voxel
            slot = find_slot(table, key)
            if table[slot] == EMPTY:
                if 2 * used >= len(table):
                    return used, at
                table[slot], slots[slot] = key, used
                keys[used], rows[used] = key, at
                used += 1
            last_key, last = key, np.int64(slots[slot])
        voxel[at] = last
        counts[last] += 1
    return used, len(key_of)


@compiled_fast
def _keys_of(points, size, member):  # type: ignore[no-untyped-def]
    """`voxel_key` of each point (N, 3), (N,) int64; EMPTY of those that do not count."""
    flat, inverse = np.ascontiguousarray(points).reshape(-1), 1.0 / size
    out = np.empty(len(member), np.int64)
    for row in range(len(member)):  # without branches, so that it fills vector registers
        i = np.int32(np.floor(flat[3 * row] * inverse))
        j = np.int32(np.floor(flat[3 * row + 1] * inverse))
        k = np.int32(np.floor(flat[3 * row + 2] * inverse))
        inside = (min(i, j, k) > -HALF_SPAN) & (max(i, j, k) < HALF_SPAN - 1)
        key = (np.int64(i) + HALF_SPAN) << 42
        key |= ((np.int64(j) + HALF_SPAN) << 21) | (np.int64(k) + HALF_SPAN)
        out[row] = key if inside & member[row] else EMPTY
    return out


def first_per_voxel(points: NDArray[np.floating], size: float) -> NDArray[np.int64]:
    """Rows of the first point (N, 3) in each voxel, in the order of the points; (M,) int64."""
    rows: NDArray[np.int64] = occupied(points, size, np.ones(len(points), np.bool_))[3]
    return rows


@compiled
def voxel_of(points, size, member, table, slots):  # type: ignore[no-untyped-def]
    """Voxel of each member point (N, 3) in the hash table of `occupied`, (N,) int32, -1 = none."""
    voxel = np.full(len(points), -1, np.int32)
    inverse = 1.0 / size
    for row in range(len(points)):
        if not member[row]:
            continue
        key = voxel_key(points[row, 0], points[row, 1], points[row, 2], inverse)
        if key == EMPTY:
            continue
        slot = find_slot(table, key)
        if table[slot] != EMPTY:
            voxel[row] = slots[slot]
    return voxel


@compiled
def means_of(points, voxel, count):  # type: ignore[no-untyped-def]
    """Mean (count, 3) float32 of the points (N, 3) of each voxel (N,), -1 = none; and how many."""
    total = np.zeros((count, 3))
    number = np.zeros(count, np.int32)
    for row in range(len(points)):
        k = voxel[row]
        if k < 0:
            continue
        number[k] += 1
        for axis in range(3):
            total[k, axis] += points[row, axis]
    mean = np.empty((count, 3), np.float32)
    for k in range(count):
        for axis in range(3):
            mean[k, axis] = total[k, axis] / max(1, number[k])
    return mean, number
