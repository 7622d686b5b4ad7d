# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sinkhorn iterations without gradients, compiled (twin: `reference/transport.py`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    Mask = NDArray[np.bool_]

_TINY = np.float32(1e-30)


@compiled
def _first_round(s: F32, rows: F32, columns: F32) -> None:
    """One iteration in the logarithmic domain on one padded score matrix (m, n), in place."""
    m, n = s.shape
    for i in range(m):
        top = s[i].max()
        total = np.float32(0.0)
        for j in range(n):
            total += np.exp(s[i, j] - top)
        shift = np.log(rows[i] + _TINY) - top - np.log(total)
        for j in range(n):
            s[i, j] += shift
    most, sums = s[0].copy(), np.zeros(n, np.float32)
    for i in range(1, m):
        for j in range(n):
            most[j] = max(most[j], s[i, j])
    for i in range(m):
        for j in range(n):
            sums[j] += np.exp(s[i, j] - most[j])
    for j in range(n):
        most[j] = np.log(columns[j] + _TINY) - most[j] - np.log(sums[j])
    for i in range(m):
        for j in range(n):
            s[i, j] += most[j]


@compiled
def _scalings(kernel: F32, rows: F32, columns: F32, rounds: int) -> tuple[F32, F32]:
    """Row and column factors that give a positive matrix (m, n) the wanted sums."""
    m, n = kernel.shape
    turned = np.ascontiguousarray(kernel.T)
    u, v = np.ones(m, np.float32), np.ones(n, np.float32)
    for _ in range(rounds):
        across = np.zeros(m, np.float32)
        for j in range(n):
            for i in range(m):
                across[i] += turned[j, i] * v[j]
        for i in range(m):
            u[i] = rows[i] / (across[i] + _TINY)
        down = np.zeros(n, np.float32)
        for i in range(m):
            for j in range(n):
                down[j] += kernel[i, j] * u[i]
        for j in range(n):
            v[j] = columns[j] / (down[j] + _TINY)
    return u, v


@compiled
def log_assignments(
    scores: F32, row_mask: Mask, column_mask: Mask, dustbin: float, rounds: int, masked: float
) -> F32:
    """Log-assignment of every pair of patches.

    Args:
        scores: (P, K, L).
        row_mask: (P, K) True for real rows.
        column_mask: (P, L).
        dustbin: score of the dustbin row and column.
        rounds: Sinkhorn iterations.
        masked: value of the entries that are not real, or of a dustbin that has nothing to take.

    Returns:
        (P, K + 1, L + 1), the last row and column are the dustbins.
    """
    p, k, n = scores.shape
    out = np.full((p, k + 1, n + 1), masked, np.float32)
    for a in range(p):
        i = np.append(np.nonzero(row_mask[a])[0], k)
        j = np.append(np.nonzero(column_mask[a])[0], n)
        s = np.full((len(i), len(j)), dustbin, np.float32)
        for r in range(len(i) - 1):
            for c in range(len(j) - 1):
                s[r, c] = scores[a, i[r], j[c]]
        rows, columns = np.ones(len(i), np.float32), np.ones(len(j), np.float32)
        rows[-1], columns[-1] = len(j) - 1, len(i) - 1
        _first_round(s, rows, columns)
        u, v = _scalings(np.exp(s), rows, columns, rounds - 1)
        u, v = np.log(u + _TINY), np.log(v + _TINY)
        for r in range(len(i)):
            for c in range(len(j)):
                if rows[r] > 0.0 and columns[c] > 0.0:
                    out[a, i[r], j[c]] = s[r, c] + u[r] + v[c]
    return out
