# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Superpoint pairs, the point matches within them, and the pose that these agree on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.model.geometry.pyramid import metric_transform
from hybridreg_ros.model.network.estimators import (
    PointMatches,
    PoseEstimate,
    estimate_pose,
    mutual_matches,
)
from hybridreg_ros.model.network.output import sigmoid
from hybridreg_ros.model.network.sinkhorn import log_assignments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.model.network.output import Encoding, SuperpointOutput

    F32 = NDArray[np.float32]
    I64 = NDArray[np.int64]

MASKED = -1.0e4
"""Logarithm of the share of an entry that is not real."""


@dataclass(frozen=True, eq=False)
class MatchOutput:
    """Result of matching two encodings.

    Attributes:
        T_target_source: (4, 4) float64, metres.
        source_points: (C, 3) float32 matched points, source sensor frame, metres.
        target_points: (C, 3) float32, target sensor frame, metres.
        weights: (C,) float32 score of each match, [0, 1].
        source_sigma2: (S,) float32 uncertainty per superpoint.
        target_sigma2: (T,) float32.
        source_static: (S,) float32 P(static) per superpoint; of a mask with one output P(static
            and seen), the nearest thing.
        target_static: (T,) float32.
        matches: the point matches in voxels.
        estimate: pose of LGR (or RANSAC) with its statistics, in voxels.
    """

    T_target_source: NDArray[np.float64]
    source_points: F32
    target_points: F32
    weights: F32
    source_sigma2: F32
    target_sigma2: F32
    source_static: F32
    target_static: F32
    matches: PointMatches
    estimate: PoseEstimate


def match(
    source: Encoding[F32],
    target: Encoding[F32],
    coarse: SuperpointOutput[F32],
    dustbin: float,
    config: ModelConfig,
) -> MatchOutput:
    """Transform and correspondences between two encodings.

    Args:
        source: encoded cloud.
        target: encoded cloud, same voxel size.
        coarse: what the network says of the two.
        dustbin: score of a fine point without a partner.
        config: numbers of pairs and of matches, and how the pose is found.
    """
    a, b = source.pyramid, target.pyramid
    matches = point_matches(source, target, select_pairs(coarse, config), dustbin, config)
    estimate = estimate_pose(matches, config)
    return MatchOutput(
        metric_transform(estimate.V_target_source, a, b),
        a.metric(matches.source).astype(np.float32),
        b.metric(matches.target).astype(np.float32),
        matches.weights.astype(np.float32),
        coarse.source_sigma2,
        coarse.target_sigma2,
        sigmoid(coarse.source_logits[:, 0]),
        sigmoid(coarse.target_logits[:, 0]),
        matches,
        estimate,
    )


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


def select_pairs(coarse: SuperpointOutput[F32], config: ModelConfig) -> I64:
    """Rows (P, 2) of the superpoints of the best pairs under the mask, best first.

    Args:
        coarse: of S source and T target superpoints.
        config: normalisation, kind of mask if it is used, and number of pairs.
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
    return np.stack(np.divmod(best, scores.shape[1]), axis=1)


def point_matches(
    source: Encoding[F32],
    target: Encoding[F32],
    pairs: I64,
    dustbin: float,
    config: ModelConfig,
) -> PointMatches:
    """Mutual matches of the fine points of pairs (P, 2), by optimal transport within each."""
    a, b = source.pyramid, target.pyramid
    rows, columns = pairs.T
    i, j = a.patch_index[rows], b.patch_index[columns]
    real = a.patch_mask[rows], b.patch_mask[columns]
    x, y = (  # the features of no point are zeros
        np.pad(side.fine_features, ((0, 1), (0, 0)))[index]
        for side, index in ((source, i), (target, j))
    )
    scores = x @ y.transpose(0, 2, 1) / np.float32(config.fine_dim**0.5)
    log = log_assignments(scores, *real, dustbin, config.sinkhorn_iterations, MASKED)
    probability = np.exp(log[:, :-1, :-1])
    patch, row, column = mutual_matches(probability, *real, config.mutual_top, config.min_score)
    return PointMatches(
        a.fine_points[i[patch, row]].astype(np.float64),
        b.fine_points[j[patch, column]].astype(np.float64),
        probability[patch, row, column].astype(np.float64),
        patch,
    )
