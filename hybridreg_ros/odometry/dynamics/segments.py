# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numba kernels that divide the cells of one scan into smooth surfaces and convex things."""

# ruff: noqa: D417, PLR0913, PLR0917 (kernels take plain arrays)
from __future__ import annotations

import numpy as np

from hybridreg_ros.core.eigen import smallest_axis
from hybridreg_ros.core.jit import compiled
from hybridreg_ros.odometry.map.voxel_hash import EMPTY, find_slot

_FLAT = 0.12
"""A cell has a normal when its surroundings vary less than this share of the next axis across."""


@compiled
def normals(points, cell, keys, table, slots):  # type: ignore[no-untyped-def]
    """Mean and normal of each cell from the points in it and in the 26 around it.

    Args:
        points: (N, 3), sensor at the origin, any axes, metres.
        cell: (N,) int32 cell of each point, -1 = none.
        keys: (M,) int64 of the cells.
        table, slots: their hash table.

    Returns:
        centre (M, 3) mean of the cell's own points, normal (M, 3) unit, towards the sensor, and
        flat (M,) bool, whether the surroundings are flat enough for the normal to mean anything.
    """
    m = len(keys)
    number = np.zeros(m)
    first = np.zeros((m, 3))
    second = np.zeros((m, 6))
    for row in range(len(points)):
        c = cell[row]
        if c < 0:
            continue
        x, y, z = float(points[row, 0]), float(points[row, 1]), float(points[row, 2])
        number[c] += 1.0
        first[c, 0] += x
        first[c, 1] += y
        first[c, 2] += z
        second[c, 0] += x * x
        second[c, 1] += x * y
        second[c, 2] += x * z
        second[c, 3] += y * y
        second[c, 4] += y * z
        second[c, 5] += z * z
    centre = np.zeros((m, 3))
    normal = np.zeros((m, 3))
    flat = np.zeros(m, np.bool_)
    s = np.zeros(3)
    q = np.zeros(6)
    for c in range(m):
        n = 0.0
        s[:] = 0.0
        q[:] = 0.0
        around = 0
        for di in range(-1, 2):
            for dj in range(-1, 2):
                for dk in range(-1, 2):
                    slot = find_slot(table, keys[c] + (di << 42) + (dj << 21) + dk)
                    if table[slot] == EMPTY:
                        continue
                    o = slots[slot]
                    around += 1
                    n += number[o]
                    s += first[o]
                    q += second[o]
        for axis in range(3):
            centre[c, axis] = first[c, axis] / max(1.0, number[c])
        if n < 6.0 or around < 4:
            continue
        mx, my, mz = s[0] / n, s[1] / n, s[2] / n
        l0, l1, _, nx, ny, nz = smallest_axis(
            q[0] / n - mx * mx, q[1] / n - mx * my, q[2] / n - mx * mz,
            q[3] / n - my * my, q[4] / n - my * mz, q[5] / n - mz * mz,
        )  # fmt: skip
        sign = -1.0 if nx * mx + ny * my + nz * mz > 0.0 else 1.0
        normal[c, 0], normal[c, 1], normal[c, 2] = sign * nx, sign * ny, sign * nz
        flat[c] = l1 > 0.0 and l0 < _FLAT * l1
    return centre, normal, flat


@compiled
def smooth(a, b, centre, normal, flat, bend, step):  # type: ignore[no-untyped-def]
    """Whether two neighbouring cells continue one smooth surface."""
    if not (flat[a] and flat[b]):
        return False
    dot = 0.0
    off_a, off_b = 0.0, 0.0
    for axis in range(3):
        d = centre[b, axis] - centre[a, axis]
        dot += normal[a, axis] * normal[b, axis]
        off_a += normal[a, axis] * d
        off_b += normal[b, axis] * d
    return dot > bend and abs(off_a) < step and abs(off_b) < step


@compiled
def concave(a, b, centre, normal, flat, limit):  # type: ignore[no-untyped-def]
    """Whether the surface folds inwards between two cells: things touch there."""
    if not (flat[a] and flat[b]):
        return False
    fold, length = 0.0, 0.0
    for axis in range(3):
        d = centre[a, axis] - centre[b, axis]
        length += d * d
        fold += d * (normal[a, axis] - normal[b, axis])
    return fold < -limit * np.sqrt(length)


@compiled
def divide(keys, table, slots, member, centre, normal, flat, bend, step, fold):  # type: ignore[no-untyped-def]
    """Connected parts of the member cells.

    Args:
        keys: (M,) int64 of the cells.
        table, slots: their hash table.
        member: (M,) bool.
        centre, normal, flat: as `normals` gives them.
        bend: smallest cosine between normals of one smooth surface; below -1, cells hang together
            unless they fold inwards.
        step: largest offset between neighbours along the normal, metres.
        fold: how far inwards is too far, as a difference of sines.

    Returns:
        (M,) int32 part of each cell, -1 for the others, and the number of parts.
    """
    part = np.full(len(keys), -1, np.int32)
    stack = np.empty(len(keys), np.int32)
    number = 0
    by_surface = bend >= -1.0
    for start in range(len(keys)):
        if not member[start] or part[start] >= 0:
            continue
        part[start] = number
        stack[0] = start
        height = 1
        while height > 0:
            height -= 1
            cell = stack[height]
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    for dk in range(-1, 2):
                        slot = find_slot(table, keys[cell] + (di << 42) + (dj << 21) + dk)
                        if table[slot] == EMPTY:
                            continue
                        other = slots[slot]
                        if not member[other] or part[other] >= 0:
                            continue
                        if by_surface:
                            joined = smooth(cell, other, centre, normal, flat, bend, step)
                        else:
                            joined = not concave(cell, other, centre, normal, flat, fold)
                        if joined:
                            part[other] = number
                            stack[height] = other
                            height += 1
        number += 1
    return part, number


@compiled
def groups(keys, table, slots, member):  # type: ignore[no-untyped-def]
    """Connected groups of member cells (M,) bool; group number per cell, -1 for the others."""
    nowhere = np.zeros((len(keys), 3))
    never = np.zeros(len(keys), np.bool_)
    return divide(keys, table, slots, member, nowhere, nowhere, never, -2.0, 0.0, 0.0)[0]
