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
def neighbours(first, low, width, column, height):  # type: ignore[no-untyped-def]
    """Occupied cells that touch, at a face, an edge or a corner.

    Args:
        first, low, width, column, height: as in `cells.Columns`.

    Returns:
        (2, K) int32, the lower one of each pair first, ascending by it.
    """
    pairs = np.empty((2, 13 * len(column) + 1), np.int32)
    count = 0
    for cell in range(len(column)):
        own = column[cell]
        for line in range(own, own + width + 1, width):
            start = cell + 1 if line == own else first[line - 1]
            for other in range(start, first[line + 2]):
                pairs[0, count], pairs[1, count] = cell, other
                count += abs(height[other] - height[cell]) <= 1
    return pairs[:, :count].copy()


@compiled
def normals(points, counts, cell, pairs):  # type: ignore[no-untyped-def]
    """Mean and normal of each cell from the points in it and in the 26 around it.

    Args:
        points: (N, 3), sensor at the origin, any axes, metres.
        counts: (N,) how many measured points each is the mean of.
        cell: (N,) int32 cell of each point, -1 = none; none of M cells is empty.
        pairs: `neighbours` of the cells.

    Returns:
        total (M,) measured points, centre (M, 3) their mean, its range (M,), normal (M, 3) unit,
        towards the sensor, and flat (M,) bool, whether the surroundings are flat enough for the
        normal to mean anything.
    """
    m = cell.max() + 1 if len(cell) else 0
    total, centre, ranges = np.zeros(m), np.zeros((m, 3)), np.empty(m)
    own = np.zeros((m, 10))  # number; sums; sums of products
    for row in range(len(points)):
        c = cell[row]
        if c < 0:
            continue
        x, y, z = 1.0 * points[row, 0], 1.0 * points[row, 1], 1.0 * points[row, 2]  # float64
        w, s, at = counts[row], own[c], centre[c]
        total[c] += w
        at[0], at[1], at[2] = at[0] + w * x, at[1] + w * y, at[2] + w * z
        s[0], s[1], s[2], s[3] = s[0] + 1.0, s[1] + x, s[2] + y, s[3] + z
        s[4], s[5], s[6] = s[4] + x * x, s[5] + x * y, s[6] + x * z
        s[7], s[8], s[9] = s[7] + y * y, s[8] + y * z, s[9] + z * z
    around, touching = own.copy(), np.ones(m, np.int32)
    for k in range(pairs.shape[1]):
        a, b = pairs[0, k], pairs[1, k]
        touching[a] += 1
        touching[b] += 1
        for j in range(10):
            around[a, j] += own[b, j]
            around[b, j] += own[a, j]
    spread, axes = np.empty(6 * m), np.empty(5 * m)
    for c in range(m):
        s, share, each = around[c], 1.0 / around[c, 0], 1.0 / max(1.0, total[c])
        x, y, z = share * s[1], share * s[2], share * s[3]
        spread[c], spread[m + c] = share * s[4] - x * x, share * s[5] - x * y
        spread[2 * m + c], spread[3 * m + c] = share * s[6] - x * z, share * s[7] - y * y
        spread[4 * m + c], spread[5 * m + c] = share * s[8] - y * z, share * s[9] - z * z
        x, y, z = each * centre[c, 0], each * centre[c, 1], each * centre[c, 2]
        centre[c, 0], centre[c, 1], centre[c, 2] = x, y, z
        ranges[c] = np.sqrt(x * x + y * y + z * z)
    _axes(spread, axes)
    normal, flat = np.zeros((m, 3)), np.zeros(m, np.bool_)
    for c in range(m):
        if around[c, 0] < 6.0 or touching[c] < 4:
            continue
        x, y, z = axes[2 * m + c], axes[3 * m + c], axes[4 * m + c]
        away = x * around[c, 1] + y * around[c, 2] + z * around[c, 3] > 0.0
        sign = -1.0 if away else 1.0
        normal[c, 0], normal[c, 1], normal[c, 2] = sign * x, sign * y, sign * z
        flat[c] = axes[m + c] > 0.0 and axes[c] < _FLAT * axes[m + c]
    return total, centre, ranges, normal, flat


@compiled
def _axes(spread, axes):  # type: ignore[no-untyped-def]
    """Of each of M matrices (6 * M) two eigenvalues and the smallest axis (5 * M)."""
    m = len(spread) // 6
    for c in range(m):
        l0, l1, _, x, y, z = smallest_axis(
            spread[c], spread[m + c], spread[2 * m + c],
            spread[3 * m + c], spread[4 * m + c], spread[5 * m + c],
        )  # fmt: skip
        axes[c], axes[m + c] = l0, l1
        axes[2 * m + c], axes[3 * m + c], axes[4 * m + c] = x, y, z


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
def _root(joined, cell):  # type: ignore[no-untyped-def]
    """The first cell of a part; makes the way to it shorter."""
    while joined[cell] != cell:
        joined[cell] = joined[joined[cell]]
        cell = joined[cell]
    return cell


@compiled
def divide(pairs, member, centre, normal, flat, size, by_surface):  # type: ignore[no-untyped-def]
    """Connected parts of the member cells.

    Args:
        pairs: `neighbours` of the cells.
        member: (M,) bool.
        centre, normal, flat: as `normals` gives them.
        size: (M,) edge of each cell, metres.
        by_surface: whether cells hang together where they continue one smooth surface, or unless
            they fold inwards.

    Returns:
        (M,) int32 part of each cell, -1 for the others, and the number of parts.
    """
    joined = np.arange(len(member))
    for k in range(pairs.shape[1]):
        a, b = pairs[0, k], pairs[1, k]
        if not (member[a] and member[b]):
            continue
        first, other = _root(joined, a), _root(joined, b)
        if first == other:
            continue
        if by_surface:
            hangs = smooth(a, b, centre, normal, flat, _STEP * size[a])
        else:
            hangs = not concave(a, b, centre, normal, flat)
        if hangs:
            joined[max(first, other)] = min(first, other)
    part, number = np.full(len(member), -1, np.int32), 0
    for cell in range(len(member)):
        if member[cell]:
            first = _root(joined, cell)
            if first == cell:
                part[cell] = number
                number += 1
            part[cell] = part[first]
    return part, number
