# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Superpoint matching: Gaussian correlation, dual normalisation, uncertainty mask, top pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.model.network.output import SuperpointOutput

    F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class SuperpointPairs:
    """The best superpoint pairs, best first.

    Attributes:
        index: (P, 2) int64 rows (source superpoint, target superpoint).
        scores: (P,) float32 masked correlation.
    """

    index: NDArray[np.int64]
    scores: F32


def gaussian_correlation(x: F32, y: F32, dual: bool = True, temperature: float = 0.5) -> F32:
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
    s: F32 = np.exp((x @ y.T - 1.0) / temperature)
    if dual:
        s = (s / s.sum(axis=1, keepdims=True)) * (s / s.sum(axis=0, keepdims=True))
    return s


def pair_weights(
    source_sigma2: Any, target_sigma2: Any, combination: str, exponent: float = 1.0
) -> Any:
    """Weight (S, T) of every superpoint pair under the mask; of arrays, or of tensors.

    `confidence_product` trusts a pair only when both sides are trusted; `variance_product` is
    the paper's 1 - sigma2_i * sigma2_j, high already when one side is. Either is raised to
    `exponent`.
    """
    if combination == 'confidence_product':
        weight = (1.0 - source_sigma2)[:, None] * (1.0 - target_sigma2)[None, :]
    else:
        weight = 1.0 - source_sigma2[:, None] * target_sigma2[None, :]
    return weight if exponent == 1.0 else weight**exponent


def select_pairs(coarse: SuperpointOutput[F32], config: ModelConfig) -> SuperpointPairs:
    """The best pairs under the mask, if the config uses it.

    Args:
        coarse: of S source and T target superpoints.
        config: normalisation, kind of mask, and number of pairs.
    """
    scores = gaussian_correlation(
        coarse.source_features,
        coarse.target_features,
        config.dual_normalisation,
        config.pair_temperature,
    )
    if config.use_mask:
        sigma2 = coarse.source_sigma2, coarse.target_sigma2
        scores = scores * pair_weights(*sigma2, config.mask_combination, config.mask_exponent)
    flat = scores.ravel()
    best = np.argpartition(-flat, min(config.top_pairs, len(flat)) - 1)[: config.top_pairs]
    best = best[np.lexsort((best, -flat[best]))]
    return SuperpointPairs(np.stack(np.divmod(best, scores.shape[1]), axis=1), flat[best])
