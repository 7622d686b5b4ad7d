# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Matches of fine points over the whole clouds: the pairs most likely by both clouds' features."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.model.network.forward_attention import exponentials, unit_rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    I64 = NDArray[np.int64]

MAX_POINTS = 3000
"""Fine points of a cloud that are compared; of more, evenly spread ones are taken."""

MATCH_TEMPERATURE = 0.05
"""Of the softmaxes over cosine similarities by which pairs are ranked."""


def evenly_spread(count: int, most: int) -> I64:
    """At most `most` of the numbers 0 to count - 1, evenly spread, ascending."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)


def likely_pairs(
    x: F32, y: F32, count: int, temperature: float, most: int = MAX_POINTS
) -> tuple[I64, F32]:
    """The most likely pairs of points.

    The likelihood of a pair is the share that its similarity has among all partners of the one
    point, times that among all partners of the other (dual softmax; Rocco et al. 2018). A point
    may occur in several pairs. Of pairs that are each other's most similar ones there are fewer,
    and in scenes with little overlap two thirds of the right pairs are not among them.

    Args:
        x: (F, C) features of the source's fine points.
        y: (G, C) features of the target's.
        count: pairs wanted.
        temperature: of both softmaxes over cosine similarities.
        most: points of a cloud that are compared.

    Returns:
        (P, 2) int64 rows of x and y, and (P,) likelihoods, largest first (ties: first row, then
        first column); P is `count`, or the number of all pairs if that is smaller.
    """
    rows_x, rows_y = evenly_spread(len(x), most), evenly_spread(len(y), most)
    u, v = unit_rows(x[rows_x]) / np.float32(temperature), unit_rows(y[rows_y]).T
    e, rows, columns = _similarities(u, np.ascontiguousarray(v), 1.0 / temperature)
    i, j, w = _largest(e, rows, columns, count)
    return np.stack([rows_x[i], rows_y[j]], axis=1), w


@compiled
def _similarities(u: F32, v: F32, most: float) -> tuple[F32, F32, F32]:
    """exp(u v - most) of (F, C) and (C, G), and one over the sums of its rows and columns."""
    e = np.dot(u, v)
    rows, columns = np.empty(e.shape[0], np.float32), np.zeros(e.shape[1], np.float32)
    power = np.empty(e.shape[1], np.int32)
    scale = power.view(np.float32)
    for r in range(e.shape[0]):
        row = e[r]
        rows[r] = 1.0 / exponentials(row, most, power, scale)
        for c in range(row.shape[0]):
            columns[c] += row[c]
    for c in range(e.shape[1]):
        columns[c] = np.float32(1.0) / columns[c]
    return e, rows, columns


def _largest(e: F32, rows: F32, columns: F32, count: int) -> tuple[I64, I64, F32]:
    """Rows, columns and values of the `count` largest of e^2 rows_i columns_j, largest first."""
    top = _row_tops(e, rows, columns)
    floor = np.float32(-1.0)
    if count < len(top):  # as many rows have an entry of that size, so there are enough entries
        floor = np.partition(top, len(top) - count)[len(top) - count]
    i, j, w = _at_least(e, rows, columns, top, floor)
    kept = np.argsort(-w, kind='stable')[:count]
    return i[kept], j[kept], w[kept]


@compiled
def _row_tops(e: F32, rows: F32, columns: F32) -> F32:
    """Largest of e^2 rows_i columns_j in every row (R,), in sixteen lanes of a vector."""
    out = np.empty(e.shape[0], np.float32)
    lanes = e.shape[1] - e.shape[1] % 16
    for r in range(e.shape[0]):
        top = np.zeros(16, np.float32)
        for c in range(0, lanes, 16):
            for k in range(16):
                top[k] = max(top[k], e[r, c + k] * e[r, c + k] * columns[c + k])
        for c in range(lanes, e.shape[1]):
            top[0] = max(top[0], e[r, c] * e[r, c] * columns[c])
        out[r] = top.max() * rows[r]
    return out


@compiled
def _at_least(e: F32, rows: F32, columns: F32, top: F32, floor: float) -> tuple[I64, I64, F32]:
    """Rows, columns and values of the entries that are not below `floor`, row by row."""
    i, j, w = [], [], []
    for r in range(e.shape[0]):
        if top[r] < floor:
            continue
        for c in range(e.shape[1]):
            value = e[r, c] * e[r, c] * columns[c] * rows[r]
            if value >= floor:
                i.append(r)
                j.append(c)
                w.append(value)
    return np.array(i, np.int64), np.array(j, np.int64), np.array(w, np.float32)
