# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Superpoint matching: Gaussian correlation, dual normalisation, uncertainty mask, top pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from hybridreg_ros.model.config import ModelConfig

    Tensor = torch.Tensor


@dataclass(frozen=True, eq=False)
class SuperpointPairs:
    """The best superpoint pairs, best first.

    Attributes:
        index: (P, 2) int64 rows (source superpoint, target superpoint).
        scores: (P,) float32 masked correlation.
    """

    index: Tensor
    scores: Tensor


def gaussian_correlation(
    x: Tensor, y: Tensor, dual: bool = True, temperature: float = 0.5
) -> Tensor:
    """exp(-||x_i - y_j||^2 / 2t) of unit features, times its shares of row and column if `dual`.

    Args:
        x: (S, C) unit rows.
        y: (T, C) unit rows.
        dual: multiply the share that each entry has of its row by that of its column.
        temperature: t; 0.5 is the paper's. The smaller, the more a superpoint keeps to its best
            partner, and the wider the best pairs are spread over the clouds.

    Returns:
        (S, T).
    """
    s = torch.exp((x @ y.t() - 1.0) / temperature)
    if dual:
        s = (s / s.sum(dim=1, keepdim=True)) * (s / s.sum(dim=0, keepdim=True))
    return s


def pair_weights(
    source_sigma2: Tensor, target_sigma2: Tensor, combination: str, exponent: float = 1.0
) -> Tensor:
    """Weight (S, T) of every superpoint pair under the mask.

    `confidence_product` trusts a pair only when both sides are trusted; `variance_product` is
    the paper's 1 - sigma2_i * sigma2_j, high already when one side is. Either is raised to
    `exponent`.
    """
    if combination == 'confidence_product':
        weight = (1.0 - source_sigma2)[:, None] * (1.0 - target_sigma2)[None, :]
    else:
        weight = 1.0 - source_sigma2[:, None] * target_sigma2[None, :]
    return weight if exponent == 1.0 else weight**exponent


def select_pairs(
    x: Tensor,
    y: Tensor,
    source_sigma2: Tensor,
    target_sigma2: Tensor,
    config: ModelConfig,
) -> SuperpointPairs:
    """The best pairs.

    Args:
        x: (S, C) unit features of the source superpoints.
        y: (T, C) of the target.
        source_sigma2: (S,) uncertainty.
        target_sigma2: (T,).
        config: normalisation, kind of mask, and number of pairs.
    """
    scores = gaussian_correlation(x, y, config.dual_normalisation, config.pair_temperature)
    if config.use_mask:
        scores = scores * pair_weights(
            source_sigma2, target_sigma2, config.mask_combination, config.mask_exponent
        )
    count = min(config.top_pairs, scores.numel())
    best, flat = torch.topk(scores.flatten(), count)
    index = torch.stack([flat // scores.shape[1], flat % scores.shape[1]], dim=1)
    return SuperpointPairs(index, best)
