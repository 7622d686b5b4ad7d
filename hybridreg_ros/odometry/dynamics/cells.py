# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numba kernels on the occupied cells of one scan: growing, and spreading to points."""

# ruff: noqa: D417, PLR0913, PLR0917 (kernels take plain arrays)
from __future__ import annotations

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.odometry.map.voxel_hash import EMPTY, find_slot, voxel_key


@compiled
def grow(keys, table, slots, value, group, budget, passable, steps, fade):  # type: ignore[no-untyped-def]
    """Spread values of grouped cells to their neighbours, nearest first, within a budget.

    Args:
        keys: (M,) int64 of the cells.
        table, slots: their hash table.
        value: (M,) float32 of each cell.
        group: (M,) int32 group of each cell, -1 = none.
        budget: (G,) int64, how many cells each group may take.
        passable: (M,) bool, cells that may be taken.
        steps: how many steps far.
        fade: factor on the value per step.

    Returns:
        value (M,) and group (M,) with those of the cells reached; the arguments stay as they are.
    """
    value, group, budget = value.copy(), group.copy(), budget.copy()
    front = np.empty(len(keys), np.int32)
    count = 0
    for cell in range(len(keys)):
        if group[cell] >= 0:
            front[count] = cell
            count += 1
    for _ in range(steps):
        fresh = np.empty(len(keys), np.int32)
        added = 0
        for k in range(count):
            cell = front[k]
            owner = group[cell]
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    for dk in range(-1, 2):
                        slot = find_slot(table, keys[cell] + (di << 42) + (dj << 21) + dk)
                        if table[slot] == EMPTY or budget[owner] <= 0:
                            continue
                        other = slots[slot]
                        if passable[other] and group[other] < 0:
                            group[other] = owner
                            budget[owner] -= 1
                            value[other] = value[cell] * fade
                            fresh[added] = other
                            added += 1
        front, count = fresh, added
    return value, group


@compiled
def look_up(points, size, table, slots, value, spread, out):  # type: ignore[no-untyped-def]
    """Largest value of the cells at and, with `spread`, around each point; 0 where there is none.

    Args:
        points: (N, 3), odom frame, metres.
        size: edge of a cell, metres.
        table, slots: hash table of the cells.
        value: (M,) float32 per cell.
        spread: whether the 26 neighbours count too.
        out: (N,) float32.
    """
    reach = 1 if spread else 0
    inverse = 1.0 / size
    for row in range(len(points)):
        out[row] = 0.0
        key = voxel_key(points[row, 0], points[row, 1], points[row, 2], inverse)
        if key == EMPTY:
            continue
        for di in range(-reach, reach + 1):
            for dj in range(-reach, reach + 1):
                for dk in range(-reach, reach + 1):
                    slot = find_slot(table, key + (di << 42) + (dj << 21) + dk)
                    if table[slot] != EMPTY:
                        out[row] = max(out[row], value[slots[slot]])
