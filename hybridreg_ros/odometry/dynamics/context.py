# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""From cells to things: the evidence about each cell beside that of its part and surroundings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.dynamics.cells import Cells

    F32 = NDArray[np.float32]

_OWN = np.array([0, 1, 4, 6, 8, 11, 12, 14, 15, 17, 19, 21, 22, 23, 25, 26, 27])
"""Columns of the evidence about the cell itself that are passed on."""
_PART = 16
_SUMS = 10
COLUMNS = 6 + len(_OWN) + _PART


def context_of(cells: Cells, evidence: F32, odds: F32, before: F32, kind: str) -> F32:
    """Each cell with the part that it belongs to.

    Args:
        cells: the cells of a scan.
        evidence: (M, E) by `evidence_of`.
        odds: (M,) log odds that follow from it.
        before: (M, 3 or more) log odds and number of scans that earlier scans tell; the last
            column is whether they tell any.
        kind: depth or lidar.

    Returns:
        (M, COLUMNS) float32. 0 to 2: log odds of the cell, mean and largest around it; then what
        is passed on of its evidence; log odds before, logarithm of the number of scans, whether
        there are any; of its part: the sums of `_pool`, largest log odds, logarithms of the
        number of cells and of its size along two level axes, shorter first, and upwards (depth:
        all three by length), and, of a lidar, of the number of points.
    """
    part, count = cells.parts
    mean, peak = _around(cells.pairs, odds, cells.counts)
    sums, number, points, top, low, high = _pool(
        part, count, cells.counts, odds, evidence, cells.centre
    )
    size = high - low
    axes = 3 if kind == 'depth' else 2
    size[:, :axes] = np.sort(size[:, :axes], axis=1)
    of_part = np.empty((count, _PART), np.float32)
    of_part[:, :_SUMS], of_part[:, _SUMS] = sums, top
    of_part[:, -5] = np.log(number)
    of_part[:, -4:-1] = np.log(size + 0.05)
    of_part[:, -1] = np.log(points) if kind == 'lidar' else 0.0
    joined: F32 = _joined(odds, mean, peak, evidence, before, of_part, part)
    return joined


@compiled
def _joined(odds, mean, peak, evidence, before, of_part, part):  # type: ignore[no-untyped-def]
    """The columns of `context_of`."""
    out = np.empty((COLUMNS, len(odds)), np.float32).T
    for cell in range(len(out)):
        out[cell, 0], out[cell, 1], out[cell, 2] = odds[cell], mean[cell], peak[cell]
        for k in range(len(_OWN)):
            out[cell, 3 + k] = evidence[cell, _OWN[k]]
        k = 3 + len(_OWN)
        out[cell, k], out[cell, k + 1] = before[cell, 0], np.log1p(before[cell, 1])
        out[cell, k + 2] = before[cell, -1]
        out[cell, k + 3 :] = of_part[part[cell]]
    return out


@compiled
def _around(pairs, value, weight):  # type: ignore[no-untyped-def]
    """Weighted mean and largest value (M,) of each cell and those that touch it."""
    heavy, total, peak = weight.copy(), weight * value, value.copy()
    for k in range(pairs.shape[1]):
        a, b = pairs[0, k], pairs[1, k]
        total[a] += weight[b] * value[b]
        total[b] += weight[a] * value[a]
        heavy[a] += weight[b]
        heavy[b] += weight[a]
        peak[a], peak[b] = max(peak[a], value[b]), max(peak[b], value[a])
    return (total / heavy).astype(np.float32), peak


@compiled
def _pool(part, count, weight, odds, evidence, centre):  # type: ignore[no-untyped-def]
    """What the cells of each part say together, each weighted by its points.

    Returns:
        (P, _SUMS) means of: log odds; their probability; whether an earlier scan looked at the
        place; probability where one did; looks that saw a surface; that saw it free; share of
        looks whose hiding thing has gone; its speed; share of looks to which nothing came back;
        log odds by the network. Then (P,) number of cells, of points, and largest log odds, and
        (P, 3) lower and upper ends, metres.
    """
    sums = np.zeros((count, _SUMS))
    number, points = np.zeros(count), np.zeros(count)
    known, gone = np.full(count, 1e-6), np.full(count, 1e-9)
    top = np.full(count, -np.inf)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for cell in range(len(part)):
        p, w = part[cell], weight[cell]
        probability = 1.0 / (1.0 + np.exp(-odds[cell]))
        looked = 1.0 if evidence[cell, 3] + evidence[cell, 4] > 0.0 else 0.0
        sums[p, 0] += w * odds[cell]
        sums[p, 1] += w * probability
        sums[p, 2] += w * looked
        sums[p, 3] += w * looked * probability
        sums[p, 4] += w * evidence[cell, 4]
        sums[p, 5] += w * evidence[cell, 3]
        sums[p, 6] += w * evidence[cell, 11] * evidence[cell, 5]
        sums[p, 7] += w * evidence[cell, 11] * evidence[cell, 12]
        sums[p, 8] += w * evidence[cell, 25]
        sums[p, 9] += w * evidence[cell, 26]
        known[p] += w * looked
        gone[p] += w * evidence[cell, 11]
        number[p] += 1.0
        points[p] += w
        top[p] = max(top[p], odds[cell])
        for axis in range(3):
            low[p, axis] = min(low[p, axis], centre[cell, axis])
            high[p, axis] = max(high[p, axis], centre[cell, axis])
    for p in range(count):
        for k in range(_SUMS):
            sums[p, k] /= known[p] if k == 3 else gone[p] if k == 7 else points[p]
    return sums, number, points, top, low, high
