# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""How much of a cloud takes part in a registration, and a sequence of clouds of one voxel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hybridreg_ros.core.config import option, validate
from hybridreg_ros.model.geometry.voxel_size import budget_voxel_size_m, choose_voxel_size_m

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Budget:
    """Maximum number of occupied voxels; the voxel grows until every level keeps to it.

    The defaults register as many real room pairs as 30,000 points and 768 superpoints do.
    """

    max_points: int = option(
        5_000, 'maximum number of occupied voxels on the finest level', low=100
    )
    max_superpoints: int = option(
        256, 'maximum number of occupied voxels on the coarsest level', low=8
    )

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            ConfigError: names the field, what was expected and what was found.
        """
        validate(self)


def voxel_size_m(
    *clouds: NDArray[np.float32], factor: float = 1.0, budget: Budget | None = None
) -> float:
    """Finest voxel for clouds that are to be matched with each other, metres.

    Args:
        clouds: (N, 3) float32 each, metres; rows with NaN or inf are ignored.
        factor: `ModelConfig.voxel_factor`.
        budget: None: the voxel of the sensor times the factor, however many points that leaves.

    Raises:
        RegistrationError: no extent, or coordinates that cannot be metres.
    """
    smallest_m = factor * choose_voxel_size_m(*clouds)
    if budget is None:
        return smallest_m
    return budget_voxel_size_m(
        *clouds,
        smallest_m=smallest_m,
        max_points=budget.max_points,
        max_superpoints=budget.max_superpoints,
    )
