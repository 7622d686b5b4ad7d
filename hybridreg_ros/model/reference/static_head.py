# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Static head: P(static) and P(seen) of every input point once the pose is known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import nn

from hybridreg_ros.model.geometry.sight import COUNT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hybridreg_ros.model.config import ModelConfig

    Tensor = torch.Tensor


class StaticHead(nn.Module):
    """What the other cloud says of a point, what it says around it, and what the network knows.

    Every point is embedded by itself; the means over the voxels of all levels go up the pyramid
    and come down again, joined by the features of the fine points: a thing moves as a whole,
    though but a part of it stands in free space.
    """

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        width, levels = config.static_width, config.levels
        self.point = nn.Linear(COUNT + 2, width)
        self.mean = nn.ModuleList(nn.Linear(width, width) for _ in range(levels))
        self.above = nn.ModuleList(nn.Linear(width, width, bias=False) for _ in range(levels - 1))
        self.fine = nn.Linear(config.fine_dim, width, bias=False)
        self.own = nn.Linear(width, width)
        self.around = nn.Linear(width, width, bias=False)
        self.output = nn.Linear(width, 2)
        self.fine_level = config.fine_level

    def forward(
        self,
        looks: Tensor,
        fine: Tensor,
        owners: Sequence[Tensor],
        weight: Tensor | None = None,
    ) -> Tensor:
        """Logits (N, 2) of P(static) and P(seen).

        Args:
            looks: (N, COUNT + 2) of `sight.looks`, log of the voxel, and the likeness of the
                features that meet.
            fine: (F, fine_dim) unit features of the fine points.
            owners: the voxel of every point on the finest level (N,), then, level by level, the
                one above of every voxel.
            weight: (N,) of the points in the means; None: all alike.
        """
        points = self.point(looks).relu()
        count = looks.new_ones(len(looks)) if weight is None else weight
        total, means = count[:, None] * points, []
        sizes = [*map(len, owners[1:]), 1 + int(owners[-1].max())]
        for owner, size in zip(owners, sizes, strict=True):
            total = total.new_zeros(size, total.shape[1]).index_add(0, owner, total)
            count = count.new_zeros(size).index_add(0, owner, count)
            means.append(total / count.clamp_min(1e-6)[:, None])
        y: Tensor | None = None
        for level in range(len(means) - 1, -1, -1):
            z = self.mean[level](means[level])
            if level == self.fine_level:
                z = z + self.fine(fine)
            if y is not None:
                z = z + self.above[level](y).index_select(0, owners[level + 1])
            y = z.relu()
        around = self.around(y).index_select(0, owners[0])
        logits: Tensor = self.output((self.own(points) + around).relu())
        return logits
