# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Optimal transport of point scores with a learned dustbin (Sinkhorn, exponential domain)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import nn

from hybridreg_ros.model.network.matching import MASKED

if TYPE_CHECKING:
    Tensor = torch.Tensor

_TINY = 1e-30


class Transport(nn.Module):
    """Sinkhorn normalisation of a batch of padded score matrices."""

    def __init__(self, iterations: int) -> None:
        super().__init__()
        self.iterations = iterations
        self.dustbin = nn.Parameter(torch.tensor(1.0))

    def forward(self, scores: Tensor, row_mask: Tensor, column_mask: Tensor) -> Tensor:
        """Log-assignment of every batch entry.

        Real rows and columns sum to 1 after `exp` (dustbins included); the dustbin row and
        column take what is left.

        Args:
            scores: (P, K, L).
            row_mask: (P, K) bool, True for real rows.
            column_mask: (P, L) bool.

        Returns:
            (P, K + 1, L + 1); masked entries are `MASKED`.
        """
        padded, rows, columns = self._padded(scores, row_mask, column_mask)
        start = _first_round(padded, rows, columns)
        kernel = torch.exp(start)
        u, v = torch.ones_like(rows), torch.ones_like(columns)
        for _ in range(self.iterations - 1):
            u = rows / (torch.bmm(kernel, v[:, :, None])[:, :, 0] + _TINY)
            v = columns / (torch.bmm(u[:, None, :], kernel)[:, 0, :] + _TINY)
        out = start + torch.log(u + _TINY)[:, :, None] + torch.log(v + _TINY)[:, None, :]
        real = (rows > 0)[:, :, None] & (columns > 0)[:, None, :]
        return out.masked_fill(~real, MASKED)

    def _padded(
        self, scores: Tensor, row_mask: Tensor, column_mask: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Scores with dustbins, and the mass that every row and column must carry."""
        p, k, n = scores.shape
        padded = self.dustbin.expand(p, k + 1, n + 1).clone()
        padded[:, :k, :n] = scores
        rows = torch.cat([row_mask, row_mask.new_ones(p, 1)], dim=1)
        columns = torch.cat([column_mask, column_mask.new_ones(p, 1)], dim=1)
        padded = padded.masked_fill(~(rows[:, :, None] & columns[:, None, :]), MASKED)
        row_mass, column_mass = rows.to(scores.dtype), columns.to(scores.dtype)
        row_mass[:, -1] = column_mask.sum(dim=1)
        column_mass[:, -1] = row_mask.sum(dim=1)
        return padded, row_mass, column_mass


def _first_round(padded: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """One iteration in the logarithmic domain, so that `exp` is safe afterwards."""
    f = torch.log(rows + _TINY) - torch.logsumexp(padded, dim=2)
    g = torch.log(columns + _TINY) - torch.logsumexp(padded + f[:, :, None], dim=1)
    return padded + f[:, :, None] + g[:, None, :]
