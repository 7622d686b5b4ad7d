# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The static head without gradients, compiled (twin: `reference/static_head.py`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.model.network.forward_attention import linear, rectify
from hybridreg_ros.model.network.packed import matrix

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    I64 = NDArray[np.int64]
    Pack = tuple[F32, I64]

_BLOCK = 4096
"""Points that are taken at a time: fresh pages would take longer than the arithmetic."""


@compiled
def _gathered(x: F32, count: F32, owner: I64, size: int) -> tuple[F32, F32]:
    """Sums (size, C) of the rows of x (N, C) by their owner, and of how many points they are."""
    total, counted = np.zeros((size, x.shape[1]), np.float32), np.zeros(size, np.float32)
    for i in range(x.shape[0]):
        to, of = total[owner[i]], x[i]
        for c in range(x.shape[1]):
            to[c] += of[c]
        counted[owner[i]] += count[i]
    return total, counted


@compiled
def static_logits(
    pack: Pack, looks: F32, fine: F32, owners: tuple[I64, ...], fine_level: int
) -> F32:
    """Logits (N, 2) of P(static) and P(seen).

    Args:
        pack: `Weights.static`.
        looks: (N, COUNT + 2) of every point, as `StaticHead.forward`.
        fine: (F, fine_dim) unit features of the fine points.
        owners: the voxel of every point on the finest level, then of every voxel the one above.
        fine_level: level of the fine points.
    """
    n, levels = looks.shape[0], len(owners)
    points = np.empty((n, matrix(pack[0], pack[1], 0).shape[1]), np.float32)
    for first in range(0, n, _BLOCK):
        part = linear(looks[first : first + _BLOCK], pack, 0)
        rectify(part)
        points[first : first + _BLOCK] = part
    total, count, means = points, np.ones(n, np.float32), []
    for level in range(levels):
        above = owners[level + 1].shape[0] if level + 1 < levels else 1 + owners[level].max()
        total, count = _gathered(total, count, owners[level], above)
        means.append(total / np.maximum(count, np.float32(1e-6)).reshape(-1, 1))
    after = 2 + 3 * levels
    y = means[0]
    for level in range(levels - 1, -1, -1):
        z = linear(means[level], pack, 2 + 2 * level)
        if level == fine_level:
            z += np.dot(fine, matrix(pack[0], pack[1], after - 1))
        if level + 1 < levels:
            higher = np.dot(y, matrix(pack[0], pack[1], 2 + 2 * levels + level))
            z += higher[owners[level + 1]]
        rectify(z)
        y = z
    around = np.dot(y, matrix(pack[0], pack[1], after + 2))
    out = np.empty((n, 2), np.float32)
    for first in range(0, n, _BLOCK):
        part = linear(points[first : first + _BLOCK], pack, after)
        part += around[owners[0][first : first + _BLOCK]]
        rectify(part)
        out[first : first + _BLOCK] = linear(part, pack, after + 3)
    return out
