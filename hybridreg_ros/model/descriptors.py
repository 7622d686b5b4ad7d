# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Matches of fine points over the whole clouds: mutual nearest neighbours of their features."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch.nn import functional

if TYPE_CHECKING:
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
    best, value = _most_similar(u, v)
    back, _ = _most_similar(v, u)
    mutual = torch.nonzero(back[best] == torch.arange(len(best), device=best.device))[:, 0]
    return torch.stack([rows_x[mutual], rows_y[best[mutual]]], dim=1), value[mutual]


def _most_similar(u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """Row of v with the largest product for each row of u, and that product."""
    similarity = u @ v.T
    if similarity.device.type == 'cpu':  # numpy's argmax along rows is several times faster
        best = torch.from_numpy(similarity.detach().numpy().argmax(axis=1))
    else:
        best = similarity.argmax(dim=1)
    return best, similarity.gather(1, best[:, None])[:, 0]
