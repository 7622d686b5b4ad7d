# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Mask head: how far each superpoint is to be trusted (moving, deforming or unseen = not)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import nn
from torch.nn import functional

from hybridreg_ros.model.reference.attention import CrossLayer

if TYPE_CHECKING:
    from hybridreg_ros.model.config import ModelConfig

    Tensor = torch.Tensor


class MaskHead(nn.Module):
    """One cross-attention on the last self-attention features, then a two-layer MLP."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.cross = CrossLayer(config)
        self.hidden = nn.Linear(2 * config.dim, config.dim)
        self.output = nn.Linear(config.dim, config.mask_outputs)

    def forward(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Logits of both clouds.

        Args:
            x: (S, dim) source features after the last self-attention.
            y: (T, dim) target features.

        Returns:
            (S, n) and (T, n) logits, n = config.mask_outputs.
        """
        crossed = torch.cat(self.cross.both(x, y))
        hidden = functional.relu(self.hidden(torch.cat([torch.cat([x, y]), crossed], dim=1)))
        logits = self.output(hidden)
        return logits[: len(x)], logits[len(x) :]


def sigma2_of(logits: Tensor) -> Tensor:
    """Uncertainty (S,) in (0, 1) of logits (S, n): one minus the product of their sigmoids."""
    confidence = functional.logsigmoid(logits).sum(dim=1).exp()
    return (1.0 - confidence).clamp(1e-6, 1.0 - 1e-6)
