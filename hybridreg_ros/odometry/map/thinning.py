# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numba kernels that sort a cloud into voxels: the first point and the mean of each."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.odometry.map.voxel_hash import EMPTY, empty_table, find_slot, voxel_key

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
    table, slots = empty_table(_ROOM)
    keys = np.empty(n, np.int64)
    rows = np.empty(n, np.int64)
    counts = np.zeros(n, np.int32)
    voxel = np.full(n, -1, np.int32)
    used, inverse = 0, 1.0 / size
    last_key, last = np.int64(EMPTY), 0
    for row in range(n):
        if not member[row]:
            continue
        key = voxel_key(points[row, 0], points[row, 1], points[row, 2], inverse)
        if key == EMPTY:
            continue
        if key != last_key:  # neighbours in a scan mostly share a voxel
            slot = find_slot(table, key)
            if table[slot] == EMPTY:
                if 2 * used >= len(table):
                    table, slots = empty_table(2 * used)
                    for k in range(used):
                        place = find_slot(table, keys[k])
                        table[place] = keys[k]
                        slots[place] = k
                    slot = find_slot(table, key)
                table[slot] = key
                slots[slot] = used
                keys[used] = key
                rows[used] = row
                used += 1
            last_key, last = key, slots[slot]
        voxel[row] = last
        counts[last] += 1
    return table, slots, keys[:used].copy(), rows[:used].copy(), counts[:used].copy(), voxel


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
