# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Matches of fine points over the whole clouds: mutual nearest neighbours of their features."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch.nn import functional

from hybridreg_ros.model.ops import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Tensor = torch.Tensor

MAX_POINTS = 3000
"""Fine points of a cloud that are compared; of more, evenly spread ones are taken."""


def evenly_spread(count: int, most: int) -> Tensor:
    """At most `most` of the numbers 0 to count - 1, evenly spread, ascending (int64)."""
    if count <= most:
        return torch.arange(count)
    return torch.linspace(0, count - 1, most).round().long()


def mutual_neighbours(x: Tensor, y: Tensor, most: int = MAX_POINTS) -> tuple[Tensor, Tensor]:
    """Pairs of points that are each other's most similar one.

    Args:
        x: (F, C) features of the source's fine points.
        y: (G, C) features of the target's.
        most: points of a cloud that are compared.

    Returns:
        (P, 2) int64 rows of x and y, and (P,) cosine similarities.
    """
    rows_x = evenly_spread(len(x), most).to(x.device)
    rows_y = evenly_spread(len(y), most).to(y.device)
    u, v = functional.normalize(x[rows_x], dim=1), functional.normalize(y[rows_y], dim=1)
    similarity = u @ v.T
    best, back = _best_of_rows_and_columns(similarity)
    mutual = torch.nonzero(back[best] == torch.arange(len(best), device=best.device))[:, 0]
    value = similarity[mutual, best[mutual]]
    return torch.stack([rows_x[mutual], rows_y[best[mutual]]], dim=1), value


def _best_of_rows_and_columns(similarity: Tensor) -> tuple[Tensor, Tensor]:
    """Column of the largest entry of every row, row of the largest of every column, int64."""
    if similarity.device.type != 'cpu':
        return similarity.argmax(dim=1), similarity.argmax(dim=0)
    s = similarity.detach().numpy()  # several times faster than torch's argmax
    return torch.from_numpy(s.argmax(axis=1)), torch.from_numpy(_column_argmax(s))


@compiled
def _column_argmax(s: NDArray[np.float32]) -> NDArray[np.int64]:
    """Row of the largest entry of every column, read row by row (ties: the first)."""
    if s.shape[0] == 0:
        return np.zeros(0, np.int64)
    row, top = np.zeros(s.shape[1], np.int32), s[0].copy()
    for i in range(1, s.shape[0]):
        for j in range(s.shape[1]):
            larger = s[i, j] > top[j]
            top[j] = s[i, j] if larger else top[j]
            row[j] = np.int32(i) if larger else row[j]
    return row.astype(np.int64)
