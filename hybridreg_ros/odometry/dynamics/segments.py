# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numba kernels that divide the cells of one scan into smooth surfaces and convex things."""

# ruff: noqa: D417 (kernels take plain arrays)
from __future__ import annotations

import numpy as np

from hybridreg_ros.core.eigen import smallest_axis
from hybridreg_ros.core.jit import compiled
from hybridreg_ros.odometry.map.voxel_hash import EMPTY, find_slot

LARGE = 60
"""A smooth surface of so many cells is a part of its own: a floor, a wall, the side of a lorry."""
_STEP = 0.35
"""Largest offset between neighbouring cells of one smooth surface, in cells."""
_BEND = float(np.cos(np.deg2rad(15.0)))
"""Smallest cosine between the normals of neighbouring cells of one smooth surface."""
_FOLD = 0.25
"""How far a surface folds inwards within one thing at most, as a difference of sines."""
_FLAT = 0.12
"""A cell has a normal when its surroundings vary less than this share of the next axis across."""


@compiled
def neighbours(keys, table, slots):  # type: ignore[no-untyped-def]
    """The occupied cells around each cell (M,) and itself.

    Returns:
        start (M + 1,) int32 and other (K,) int32: other[start[c]:start[c + 1]] of cell c.
    """
    start = np.zeros(len(keys) + 1, np.int32)
    other = np.empty(27 * len(keys), np.int32)
    count = 0
    for cell in range(len(keys)):
        for di in range(-1, 2):
            for dj in range(-1, 2):
                for dk in range(-1, 2):
                    slot = find_slot(table, keys[cell] + (di << 42) + (dj << 21) + dk)
                    if table[slot] != EMPTY:
                        other[count] = slots[slot]
                        count += 1
        start[cell + 1] = count
    return start, other[:count].copy()


@compiled
def normals(points, counts, cell, start, other):  # type: ignore[no-untyped-def]
    """Mean and normal of each cell from the points in it and in the 26 around it.

    Args:
        points: (N, 3), sensor at the origin, any axes, metres.
        counts: (N,) how many measured points each is the mean of.
        cell: (N,) int32 cell of each point, -1 = none.
        start, other: `neighbours` of the cells.

    Returns:
        total (M,) measured points, centre (M, 3) their mean, normal (M, 3) unit, towards the
        sensor, and flat (M,) bool, whether the surroundings are flat enough for the normal to mean
        anything.
    """
    m = len(start) - 1
    number = np.zeros(m)
    total = np.zeros(m)
    centre = np.zeros((m, 3))
    first = np.zeros((m, 3))
    second = np.zeros((m, 6))
    for row in range(len(points)):
        c = cell[row]
        if c < 0:
            continue
        x, y, z = float(points[row, 0]), float(points[row, 1]), float(points[row, 2])
        number[c] += 1.0
        total[c] += counts[row]
        centre[c, 0] += counts[row] * x
        centre[c, 1] += counts[row] * y
        centre[c, 2] += counts[row] * z
        first[c, 0] += x
        first[c, 1] += y
        first[c, 2] += z
        second[c, 0] += x * x
        second[c, 1] += x * y
        second[c, 2] += x * z
        second[c, 3] += y * y
        second[c, 4] += y * z
        second[c, 5] += z * z
    normal = np.zeros((m, 3))
    flat = np.zeros(m, np.bool_)
    s = np.zeros(3)
    q = np.zeros(6)
    for c in range(m):
        n = 0.0
        s[:] = 0.0
        q[:] = 0.0
        for k in range(start[c], start[c + 1]):
            o = other[k]
            n += number[o]
            s += first[o]
            q += second[o]
        for axis in range(3):
            centre[c, axis] /= max(1.0, total[c])
        if n < 6.0 or start[c + 1] - start[c] < 4:
            continue
        mx, my, mz = s[0] / n, s[1] / n, s[2] / n
        l0, l1, _, nx, ny, nz = smallest_axis(
            q[0] / n - mx * mx, q[1] / n - mx * my, q[2] / n - mx * mz,
            q[3] / n - my * my, q[4] / n - my * mz, q[5] / n - mz * mz,
        )  # fmt: skip
        sign = -1.0 if nx * mx + ny * my + nz * mz > 0.0 else 1.0
        normal[c, 0], normal[c, 1], normal[c, 2] = sign * nx, sign * ny, sign * nz
        flat[c] = l1 > 0.0 and l0 < _FLAT * l1
    return total, centre, normal, flat


@compiled
def smooth(a, b, centre, normal, flat, step):  # type: ignore[no-untyped-def]
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
    return dot > _BEND and abs(off_a) < step and abs(off_b) < step


@compiled
def concave(a, b, centre, normal, flat):  # type: ignore[no-untyped-def]
    """Whether the surface folds inwards between two cells: things touch there."""
    if not (flat[a] and flat[b]):
        return False
    fold, length = 0.0, 0.0
    for axis in range(3):
        d = centre[a, axis] - centre[b, axis]
        length += d * d
        fold += d * (normal[a, axis] - normal[b, axis])
    return fold < -_FOLD * np.sqrt(length)


@compiled
def divide(start, other, member, centre, normal, flat, size, by_surface):  # type: ignore[no-untyped-def]
    """Connected parts of the member cells.

    Args:
        start, other: `neighbours` of the cells.
        member: (M,) bool.
        centre, normal, flat: as `normals` gives them.
        size: (M,) edge of each cell, metres.
        by_surface: whether cells hang together where they continue one smooth surface, or unless
            they fold inwards.

    Returns:
        (M,) int32 part of each cell, -1 for the others, and the number of parts.
    """
    part = np.full(len(member), -1, np.int32)
    stack = np.empty(len(member), np.int32)
    number = 0
    for first in range(len(member)):
        if not member[first] or part[first] >= 0:
            continue
        part[first] = number
        stack[0] = first
        height = 1
        while height > 0:
            height -= 1
            a = stack[height]
            for k in range(start[a], start[a + 1]):
                b = other[k]
                if not member[b] or part[b] >= 0:
                    continue
                if by_surface:
                    joined = smooth(a, b, centre, normal, flat, _STEP * size[a])
                else:
                    joined = not concave(a, b, centre, normal, flat)
                if joined:
                    part[b] = number
                    stack[height] = b
                    height += 1
        number += 1
    return part, number
