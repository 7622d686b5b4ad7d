# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numba kernels that thin a cloud: the first point of each voxel, or the mean of them all."""

from __future__ import annotations

import numba
import numpy as np

from hybridreg_ros.odometry.voxelmap import EMPTY, empty_table, find_slot, voxel_key

_jit = numba.njit(cache=True, nogil=True)


@_jit
def first_per_voxel(points, size):  # type: ignore[no-untyped-def]
    """Rows of the first point (N, 3) in each voxel, in the order of the points; (M,) int64."""
    n = len(points)
    table, _ = empty_table(n)
    rows = np.empty(n, np.int64)
    found = 0
    inverse = 1.0 / size
    for row in range(n):
        key = voxel_key(points[row, 0], points[row, 1], points[row, 2], inverse)
        if key == EMPTY:
            continue
        slot = find_slot(table, key)
        if table[slot] == EMPTY:
            table[slot] = key
            rows[found] = row
            found += 1
    return rows[:found].copy()


@_jit
def mean_per_voxel(points, size, rows):  # type: ignore[no-untyped-def]
    """Mean of the points (N, 3) in each voxel, in the order of `first_per_voxel`.

    Args:
        points: (N, 3) float32.
        size: edge of a voxel.
        rows: (M,) int64 that `first_per_voxel` gave for (some of) the same points and this size.

    Returns:
        (M, 3) float32 means, (M,) int32 numbers of points, and the voxel of each point (N,)
        int32, -1 = none of them.
    """
    m = len(rows)
    table, slots = empty_table(m)
    inverse = 1.0 / size
    for k in range(m):
        row = rows[k]
        key = voxel_key(points[row, 0], points[row, 1], points[row, 2], inverse)
        slot = find_slot(table, key)
        table[slot] = key
        slots[slot] = k
    total = np.zeros((m, 3))
    count = np.zeros(m, np.int32)
    voxel = np.full(len(points), -1, np.int32)
    for row in range(len(points)):
        key = voxel_key(points[row, 0], points[row, 1], points[row, 2], inverse)
        slot = find_slot(table, key)
        if key == EMPTY or table[slot] == EMPTY:
            continue
        k = slots[slot]
        voxel[row] = k
        for axis in range(3):
            total[k, axis] += points[row, axis]
        count[k] += 1
    mean = np.empty((m, 3), np.float32)
    for k in range(m):
        for axis in range(3):
            mean[k, axis] = total[k, axis] / count[k]
    return mean, count, voxel
