# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numba kernels that divide the cells of one scan into smooth surfaces and convex things."""

# ruff: noqa: D417 (kernels take plain arrays)
from __future__ import annotations

import numpy as np

from hybridreg_ros.core.eigen import smallest_axis
from hybridreg_ros.core.jit import compiled

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
def neighbours(keys):  # type: ignore[no-untyped-def]
    """The occupied cells around each cell and itself.

    Args:
        keys: (M,) int64 of the cells, ascending.

    Returns:
        start (M + 1,) int32 and other (K,) int32: other[start[c]:start[c + 1]] of cell c.
    """
    start = np.zeros(len(keys) + 1, np.int32)
    other = np.empty(27 * len(keys), np.int32)
    count = 0
    first = np.zeros(9, np.int32)  # of each row of three cells around one, which follow it
    for cell in range(len(keys)):
        for row in range(9):
            low = keys[cell] + ((row // 3 - 1) << 42) + ((row % 3 - 1) << 21) - 1
            k = first[row]
            while k < len(keys) and keys[k] < low:
                k += 1
            first[row] = k
            while k < len(keys) and keys[k] <= low + 2:
                other[count] = k
                count += 1
                k += 1
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
    total = np.zeros(m)
    centre = np.zeros((m, 3))
    moments = np.zeros((m, 10))  # number; sums; sums of products
    for row in range(len(points)):
        c = cell[row]
        if c < 0:
            continue
        total[c] += counts[row]
        moments[c, 0] += 1.0
        k = 4
        for a in range(3):
            centre[c, a] += counts[row] * points[row, a]
            moments[c, 1 + a] += points[row, a]
            for b in range(a, 3):
                moments[c, k] += np.float64(points[row, a]) * points[row, b]
                k += 1
    normal = np.zeros((m, 3))
    flat = np.zeros(m, np.bool_)
    s = np.empty(10)
    for c in range(m):
        for axis in range(3):
            centre[c, axis] /= max(1.0, total[c])
        s[:] = 0.0
        for k in range(start[c], start[c + 1]):
            for j in range(10):
                s[j] += moments[other[k], j]
        n = s[0]
        if n < 6.0 or start[c + 1] - start[c] < 4:
            continue
        mx, my, mz = s[1] / n, s[2] / n, s[3] / n
        l0, l1, _, nx, ny, nz = smallest_axis(
            s[4] / n - mx * mx, s[5] / n - mx * my, s[6] / n - mx * mz,
            s[7] / n - my * my, s[8] / n - my * mz, s[9] / n - mz * mz,
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
