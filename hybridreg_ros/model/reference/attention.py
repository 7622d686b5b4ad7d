# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Geometric transformer over superpoints (Qin et al. 2022), its N x N x C tensor never built.

The embedding of a pair is a function of one distance and a few angles, so it is a row of a
table; and q . (W r) = (q W) . r, so a query meets the table once and then only looks up scores.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import nn
from torch.nn import functional

from hybridreg_ros.model.network.packed import bin_sinusoids
from hybridreg_ros.model.reference.fused import lookup_scores, tensor_of

if TYPE_CHECKING:
    from hybridreg_ros.model.config import ModelConfig

    Tensor = torch.Tensor


class GeometryTable(nn.Module):
    """Rows of the pairwise embedding: distance bins, then angle bins, each linearly mapped."""

    sinusoid: Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        waves = torch.from_numpy(bin_sinusoids(config))
        self.register_buffer('sinusoid', waves, persistent=False)
        self.distance_bins = config.distance_bins
        self.distance = nn.Linear(config.dim, config.dim)
        self.angle = nn.Linear(config.dim, config.dim, bias=False)

    def forward(self) -> Tensor:
        """(B, dim) embedding of every bin."""
        d, a = self.sinusoid[: self.distance_bins], self.sinusoid[self.distance_bins :]
        return torch.cat([self.distance(d), self.angle(a)])


class FeedForward(nn.Module):
    """Two linear layers with a skip connection and post-normalisation."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.widen = nn.Linear(dim, 2 * dim)
        self.narrow = nn.Linear(2 * dim, dim)
        self.norm = nn.LayerNorm(dim)

    def forward(self, x: Tensor) -> Tensor:
        """(S, dim) to (S, dim)."""
        y: Tensor = self.norm(x + self.narrow(functional.relu(self.widen(x))))
        return y


class _Attention(nn.Module):
    """Projections, heads and output that self- and cross-attention share."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        dim = config.dim
        self.heads, self.width = config.heads, dim // config.heads
        self.query = nn.Linear(dim, dim)
        self.key = nn.Linear(dim, dim)
        self.value = nn.Linear(dim, dim)
        self.merge = nn.Linear(dim, dim)
        self.norm = nn.LayerNorm(dim)
        self.feed = FeedForward(dim)

    def projected(self, z: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Queries (scaled), keys and values of features (S, dim), each (heads, S, width)."""
        q, k, v = (
            m(z).view(len(z), self.heads, self.width).transpose(0, 1)
            for m in (self.query, self.key, self.value)
        )
        return q * self.width**-0.5, k, v

    @staticmethod
    def mixed(q: Tensor, k: Tensor, v: Tensor, bias: Tensor | None = None) -> Tensor:
        """Values (heads, T, width) mixed by the softmax of q k + bias (heads, S, T): (S, dim)."""
        scores = torch.bmm(q, k.transpose(1, 2))
        if bias is not None:
            scores = scores + bias
        return torch.bmm(torch.softmax(scores, dim=2), v).transpose(0, 1).flatten(1)

    def finish(self, z: Tensor, mixed: Tensor) -> Tensor:
        """Output of the heads, skip, norm and feed-forward, (S, dim)."""
        out: Tensor = self.feed(self.norm(z + self.merge(mixed)))
        return out


class SelfLayer(_Attention):
    """Self-attention with the pairwise geometry of the cloud."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__(config)
        self.reduction = config.angle_reduction
        self.distance_bins = config.distance_bins
        # Without bias: a bias adds the same number to all scores of a query (softmax drops it).
        self.position = nn.Linear(config.dim, config.dim, bias=False)

    def forward(self, x: Tensor, table: Tensor, bins: Any) -> Tensor:
        """One layer.

        Args:
            x: (S, dim) features.
            table: (B, dim) of `GeometryTable`.
            bins: (S, S, 1 + A) int16 rows of the table for every pair, array or tensor.

        Returns:
            (S, dim).
        """
        q, k, v = self.projected(x)
        return self.finish(x, self.mixed(q, k, v, self.geometric_scores(q, table, bins)))

    def geometric_scores(self, q: Tensor, table: Tensor, bins: Any) -> Tensor:
        """Scores q . (W r) of all pairs by way of (q W) . table: (heads, S, S).

        Args:
            q: (heads, S, width) queries.
            table: (B, dim).
            bins: (S, S, 1 + A) int16.
        """
        W = self.position.weight.view(self.heads, self.width, -1)
        if self.reduction == 'max':  # a maximum per channel needs the pairwise rows themselves
            rows = table[tensor_of(bins, q).long()]
            embedded = rows[:, :, 0] + rows[:, :, 1:].amax(dim=2)
            return torch.einsum('hnc,nmc->hnm', torch.bmm(q, W), embedded)
        return lookup_scores(torch.bmm(q, torch.matmul(W, table.t())), bins)


class CrossLayer(_Attention):
    """Attention of one cloud to the other."""

    def forward(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Features (S, dim) and (T, dim) that have looked at each other."""
        (qx, kx, vx), (qy, ky, vy) = self.projected(x), self.projected(y)
        return self.finish(x, self.mixed(qx, ky, vy)), self.finish(y, self.mixed(qy, kx, vx))
