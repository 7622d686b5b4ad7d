# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A budget of points per cloud: the voxel of a pair follows it, and caps only trim the rest."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.model.geometry.voxel_size import budget_voxel_size_m

if TYPE_CHECKING:
    from hybridreg_ros.data.pair import PointPair
    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.training.config import BudgetConfig


@dataclass(frozen=True)
class Budget:
    """How large a cloud may be.

    Attributes:
        max_points: of the finest level.
        max_superpoints: of the coarsest level.
    """

    max_points: int
    max_superpoints: int

    @classmethod
    def drawn(cls, config: BudgetConfig, rng: np.random.Generator) -> Budget | None:
        """A random one, log-uniform; None when the config asks for none."""
        if not config.fewest_points:
            return None
        low, high = np.log([config.fewest_points, config.most_points])
        return cls(round(float(np.exp(rng.uniform(low, high)))), config.max_superpoints)

    @classmethod
    def validating(cls, config: BudgetConfig) -> Budget | None:
        """That of the validation pairs; None when the config asks for none."""
        if not config.fewest_points:
            return None
        return cls(config.validation_points, config.max_superpoints)

    def voxel_m(self, pair: PointPair, model: ModelConfig) -> float:
        """The voxel for both clouds of a pair, metres; at least that of the network."""
        return budget_voxel_size_m(
            pair.source,
            pair.target,
            smallest_m=model.voxel_factor * pair.voxel_size_m,
            max_points=self.max_points,
            max_superpoints=self.max_superpoints,
        )

    def caps(self, model: ModelConfig) -> ModelConfig:
        """The network's sizes with the caps of this budget."""
        return dataclasses.replace(
            model, max_points=self.max_points, max_superpoints=self.max_superpoints
        )
