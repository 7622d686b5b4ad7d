# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Geometric transformer over superpoints (Qin et al. 2022), its N x N x C tensor never built.

The embedding of a pair is a function of one distance and a few angles, so it is a row of a
table; and q . (W r) = (q W) . r, so a query meets the table once and then only looks up scores.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
from torch import nn
from torch.nn import functional

from hybridreg_ros.model.fused import lookup_scores

if TYPE_CHECKING:
    from hybridreg_ros.model.config import ModelConfig

    Tensor = torch.Tensor


def sinusoids(values: Tensor, dim: int) -> Tensor:
    """Sine and cosine of values (N,) at dim / 2 frequencies from 1 down to 1e-4: (N, dim)."""
    half = torch.arange(0, dim, 2, dtype=torch.float32, device=values.device)
    phase = values[:, None] * torch.exp(half * (-math.log(10_000.0) / dim))
    return torch.stack([torch.sin(phase), torch.cos(phase)], dim=2).flatten(1)


class GeometryTable(nn.Module):
    """Rows of the pairwise embedding: distance bins, then angle bins, each linearly mapped."""

    sinusoid: Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        distance = torch.arange(config.distance_bins) * config.distance_step
        angle = torch.arange(config.angle_bins) * (180.0 / (config.angle_bins - 1))
        phases = torch.cat([distance / config.sigma_distance, angle / config.sigma_angle_deg])
        self.register_buffer('sinusoid', sinusoids(phases, config.dim), persistent=False)
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

    def split(self, x: Tensor) -> Tensor:
        """(S, dim) to (heads, S, width)."""
        return x.view(len(x), self.heads, self.width).transpose(0, 1)

    def finish(self, x: Tensor, scores: Tensor, values: Tensor) -> Tensor:
        """Softmax of scores (heads, S, T) over values (heads, T, width), skip, norm, feed."""
        mixed = torch.bmm(torch.softmax(scores * self.width**-0.5, dim=2), values)
        y = self.norm(x + self.merge(mixed.transpose(0, 1).reshape(x.shape)))
        out: Tensor = self.feed(y)
        return out


class SelfLayer(_Attention):
    """Self-attention with the pairwise geometry of the cloud."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__(config)
        self.reduction = config.angle_reduction
        self.distance_bins = config.distance_bins
        # Without bias: a bias adds the same number to all scores of a query (softmax drops it).
        self.position = nn.Linear(config.dim, config.dim, bias=False)

    def forward(self, x: Tensor, table: Tensor, bins: Tensor) -> Tensor:
        """One layer.

        Args:
            x: (S, dim) features.
            table: (B, dim) of `GeometryTable`.
            bins: (S, S, 1 + A) int16 rows of the table for every pair.

        Returns:
            (S, dim).
        """
        q, k, v = (self.split(m(x)) for m in (self.query, self.key, self.value))
        scores = torch.bmm(q, k.transpose(1, 2)) + self.geometric_scores(q, table, bins)
        return self.finish(x, scores, v)

    def geometric_scores(self, q: Tensor, table: Tensor, bins: Tensor) -> Tensor:
        """Scores q . (W r) of all pairs by way of (q W) . table: (heads, S, S).

        Args:
            q: (heads, S, width) queries.
            table: (B, dim).
            bins: (S, S, 1 + A) int16.
        """
        W = self.position.weight.view(self.heads, self.width, -1)
        if self.reduction == 'max':  # a maximum per channel needs the pairwise rows themselves
            rows = table[bins.long()]
            embedded = rows[:, :, 0] + rows[:, :, 1:].amax(dim=2)
            return torch.einsum('hnc,nmc->hnm', torch.bmm(q, W), embedded)
        per_row = torch.matmul(W, table.t())  # (heads, width, B)
        per_query = torch.bmm(q, per_row).transpose(0, 1)  # (S, heads, B)
        return lookup_scores(per_query, bins)

    def plain_scores(self, q: Tensor, table: Tensor, bins: Tensor) -> Tensor:
        """The same scores by the paper's formula, with the S x S x dim tensor (reference)."""
        rows = table[bins.long()]
        angles = rows[:, :, 1:]
        reduced = angles.amax(dim=2) if self.reduction == 'max' else angles.mean(dim=2)
        r = self.position(rows[:, :, 0] + reduced)
        r = r.view(*r.shape[:2], self.heads, self.width)
        return torch.einsum('hnc,nmhc->hnm', q, r)


class CrossLayer(_Attention):
    """Attention of one cloud to the other."""

    def forward(self, x: Tensor, y: Tensor) -> Tensor:
        """Features (S, dim) that have looked at the features y (T, dim) of the other cloud."""
        q, k, v = self.split(self.query(x)), self.split(self.key(y)), self.split(self.value(y))
        return self.finish(x, torch.bmm(q, k.transpose(1, 2)), v)
