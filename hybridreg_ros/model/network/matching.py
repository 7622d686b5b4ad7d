# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""From superpoint pairs to point matches and the pose that they agree on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

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
from hybridreg_ros.model.network.superpoints import SuperpointPairs, select_pairs

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.model.network.output import Encoding, SuperpointOutput

    F32 = NDArray[np.float32]

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
        inliers: (C,) bool, matches within the acceptance radius of the transform.
        source_sigma2: (S,) float32 uncertainty per superpoint.
        target_sigma2: (T,) float32.
        source_static: (S,) float32 P(static) per superpoint; of a mask with one output P(static
            and seen), the nearest thing.
        target_static: (T,) float32.
        pairs: superpoint pairs that were opened, with their scores.
        matches: the point matches in voxels.
        estimate: pose of LGR (or RANSAC) with its statistics, in voxels.
    """

    T_target_source: NDArray[np.float64]
    source_points: F32
    target_points: F32
    weights: F32
    inliers: NDArray[np.bool_]
    source_sigma2: F32
    target_sigma2: F32
    source_static: F32
    target_static: F32
    pairs: SuperpointPairs
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
    pairs = select_pairs(coarse, config)
    matches = point_matches(source, target, pairs, dustbin, config)
    estimate = estimate_pose(matches, config)
    return MatchOutput(
        metric_transform(estimate.V_target_source, a, b),
        a.metric(matches.source).astype(np.float32),
        b.metric(matches.target).astype(np.float32),
        matches.weights.astype(np.float32),
        estimate.inliers,
        coarse.source_sigma2,
        coarse.target_sigma2,
        sigmoid(coarse.source_logits[:, 0]),
        sigmoid(coarse.target_logits[:, 0]),
        pairs,
        matches,
        estimate,
    )


def point_matches(
    source: Encoding[F32],
    target: Encoding[F32],
    pairs: SuperpointPairs,
    dustbin: float,
    config: ModelConfig,
) -> PointMatches:
    """Mutual matches of the fine points of all patches, by optimal transport within each pair."""
    a, b = source.pyramid, target.pyramid
    rows, columns = pairs.index.T
    i, j = a.patch_index[rows], b.patch_index[columns]
    real = a.patch_mask[rows], b.patch_mask[columns]
    x, y = _rows(source.fine_features, i), _rows(target.fine_features, j)
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


def _rows(features: F32, index: NDArray[np.int64]) -> F32:
    """Rows of features (N, C) at index (P, K); index N gives zeros."""
    return np.concatenate([features, np.zeros((1, features.shape[1]), np.float32)])[index]
