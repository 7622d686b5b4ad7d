# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""HybridRegNet: encode a cloud once, then correlate and match encodings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.model.geometry.pyramid import Pyramid, metric_transform
from hybridreg_ros.model.network.attention import CrossLayer, GeometryTable, SelfLayer
from hybridreg_ros.model.network.backbone import Backbone, Norm
from hybridreg_ros.model.network.estimators import (
    PointMatches,
    PoseEstimate,
    estimate_pose,
    mutual_matches,
)
from hybridreg_ros.model.network.superpoints import SuperpointPairs, select_pairs
from hybridreg_ros.model.network.transport import Transport
from hybridreg_ros.model.network.uncertainty import MaskHead, sigma2_of, static_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.config import ModelConfig

    Tensor = torch.Tensor


@dataclass(frozen=True, eq=False)
class Encoding:
    """One cloud after everything that does not need the other cloud (keep it with a keyframe).

    Attributes:
        pyramid: geometry of the cloud.
        fine_features: (F, fine_dim) features of `pyramid.fine_points`, not normalised.
        superpoint_features: (S, dim) after the first self-attention layer.
    """

    pyramid: Pyramid
    fine_features: Tensor
    superpoint_features: Tensor


@dataclass(frozen=True, eq=False)
class SuperpointOutput:
    """What the coarse losses need; rows belong to `pyramid.superpoints` of each cloud.

    Attributes:
        source_features: (S, dim) unit length, after the transformer.
        target_features: (T, dim) unit length.
        source_logits: (S, n) mask logits; n = 2: P(static), P(seen by the other cloud); n = 1:
            P(both). The confidence is the product of their sigmoids, sigma2 = 1 - confidence.
        target_logits: (T, n).
        source_sigma2: (S,) uncertainty in (0, 1), 1 = do not trust; differentiable.
        target_sigma2: (T,).
    """

    source_features: Tensor
    target_features: Tensor
    source_logits: Tensor
    target_logits: Tensor
    source_sigma2: Tensor
    target_sigma2: Tensor


@dataclass(frozen=True, eq=False)
class PatchScores:
    """Assignment of fine points within P pairs of patches.

    Attributes:
        log_assignment: (P, K + 1, K + 1) log-probabilities, rows source, columns target; the
            last row and column are the dustbins; padded entries are about -1e4.
        source_index: (P, K) int64 fine points of the source, padded with F_source.
        target_index: (P, K) int64 fine points of the target, padded with F_target.
        source_mask: (P, K) bool, True where the point is real.
        target_mask: (P, K) bool.
    """

    log_assignment: Tensor
    source_index: Tensor
    target_index: Tensor
    source_mask: Tensor
    target_mask: Tensor


@dataclass(frozen=True, eq=False)
class MatchOutput:
    """Result of matching two encodings; plain arrays, no gradient.

    Attributes:
        T_target_source: (4, 4) float64, metres.
        source_points: (C, 3) float32 matched points, source sensor frame, metres.
        target_points: (C, 3) float32, target sensor frame, metres.
        weights: (C,) float32 score of each match, [0, 1].
        inliers: (C,) bool, matches within the acceptance radius of the transform.
        source_sigma2: (S,) float32 uncertainty per superpoint.
        target_sigma2: (T,) float32.
        source_static: (S,) float32 P(static) per superpoint.
        target_static: (T,) float32.
        pairs: superpoint pairs that were opened, with their scores.
        matches: the point matches in voxels.
        estimate: pose of LGR (or RANSAC) with its statistics, in voxels.
    """

    T_target_source: NDArray[np.float64]
    source_points: NDArray[np.float32]
    target_points: NDArray[np.float32]
    weights: NDArray[np.float32]
    inliers: NDArray[np.bool_]
    source_sigma2: NDArray[np.float32]
    target_sigma2: NDArray[np.float32]
    source_static: NDArray[np.float32]
    target_static: NDArray[np.float32]
    pairs: SuperpointPairs
    matches: PointMatches
    estimate: PoseEstimate


class HybridRegNet(nn.Module):
    """The network of HybridReg (KPConv-FPN, geometric transformer, mask, optimal transport).

    Every normalisation is per cloud, so that `match(encode(a), encode(b))` is the whole forward
    pass whatever else a or b is matched with.
    """

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        dim = config.dim
        self.backbone = Backbone(config)
        self.project = nn.Linear(config.widths[-1], dim)
        self.table = GeometryTable(config)
        self.self_layers = nn.ModuleList(SelfLayer(config) for _ in range(config.blocks))
        self.cross_layers = nn.ModuleList(CrossLayer(config) for _ in range(config.blocks))
        self.output = nn.Linear(dim, dim)
        self.mask = MaskHead(config)
        self.transport = Transport(config.sinkhorn_iterations)
        self.norm_groups = {m.groups for m in self.modules() if isinstance(m, Norm)}

    def encode(self, pyramid: Pyramid) -> Encoding:
        """Backbone, projection and first self-attention of one cloud."""
        fine, coarse = self.backbone(pyramid)
        features = self.project(coarse)
        features = self.self_layers[0](features, self.table(), pyramid.geometry)
        return Encoding(pyramid, fine, features)

    def correlate(self, source: Encoding, target: Encoding) -> SuperpointOutput:
        """Transformer and mask head over the superpoints of two clouds (differentiable).

        Raises:
            RegistrationError: the encodings were made with different voxel sizes.
        """
        self.check_voxels(source, target)
        x, y = source.superpoint_features, target.superpoint_features
        gx, gy = source.pyramid.geometry, target.pyramid.geometry
        table = self.table()
        for i in range(self.config.blocks):
            own, cross = self.self_layers[i], self.cross_layers[i]
            assert isinstance(own, SelfLayer)
            assert isinstance(cross, CrossLayer)
            if i:
                x, y = own.both(x, y, table, gx, gy)
            before = x, y
            x, y = cross.both(x, y)
        x_logits, y_logits = self.mask(*before)
        return SuperpointOutput(
            functional.normalize(self.output(x), dim=1),
            functional.normalize(self.output(y), dim=1),
            x_logits,
            y_logits,
            sigma2_of(x_logits),
            sigma2_of(y_logits),
        )

    @staticmethod
    def check_voxels(source: Encoding, target: Encoding) -> None:
        """Check that two encodings can be compared.

        Raises:
            RegistrationError: they were made with different voxel sizes.
        """
        a, b = source.pyramid.voxel_size_m, target.pyramid.voxel_size_m
        if abs(a - b) > 1e-6 * max(a, b):
            raise RegistrationError(
                f'expected encodings of one voxel size, found {a:g} m and {b:g} m: '
                'encode both with the same voxel_size_m'
            )

    def patch_scores(self, source: Encoding, target: Encoding, pairs: Tensor) -> PatchScores:
        """Optimal transport between the fine points of superpoint pairs (differentiable).

        Args:
            source: encoding of the source.
            target: encoding of the target.
            pairs: (P, 2) int64 rows (source superpoint, target superpoint).
        """
        i, j = source.pyramid.patch_index[pairs[:, 0]], target.pyramid.patch_index[pairs[:, 1]]
        mi, mj = source.pyramid.patch_mask[pairs[:, 0]], target.pyramid.patch_mask[pairs[:, 1]]
        scores = torch.bmm(
            _rows(source.fine_features, i), _rows(target.fine_features, j).transpose(1, 2)
        )
        scores = scores / self.config.fine_dim**0.5
        return PatchScores(self.transport(scores, mi, mj), i, j, mi, mj)

    @torch.no_grad()
    def match(
        self, source: Encoding, target: Encoding, coarse: SuperpointOutput | None = None
    ) -> MatchOutput:
        """Transform, correspondences and uncertainty between two encodings (no gradient).

        `coarse`: what `correlate` makes of them, where it is known already.
        """
        coarse = self.correlate(source, target) if coarse is None else coarse
        pairs = select_pairs(
            coarse.source_features,
            coarse.target_features,
            coarse.source_sigma2,
            coarse.target_sigma2,
            self.config,
        )
        patches = self.patch_scores(source, target, pairs.index)
        matches, estimate = self._pose(source.pyramid, target.pyramid, patches)
        return MatchOutput(
            metric_transform(estimate.V_target_source, source.pyramid, target.pyramid),
            source.pyramid.metric(matches.source).astype(np.float32),
            target.pyramid.metric(matches.target).astype(np.float32),
            matches.weights.astype(np.float32),
            estimate.inliers,
            coarse.source_sigma2.cpu().numpy(),
            coarse.target_sigma2.cpu().numpy(),
            static_of(coarse.source_logits).cpu().numpy(),
            static_of(coarse.target_logits).cpu().numpy(),
            pairs,
            matches,
            estimate,
        )

    def _pose(
        self, source: Pyramid, target: Pyramid, patches: PatchScores
    ) -> tuple[PointMatches, PoseEstimate]:
        """Mutual point matches of all patches and the pose they agree on, voxels."""
        probability = patches.log_assignment[:, :-1, :-1].exp().cpu().numpy()
        patch, row, column = mutual_matches(
            probability,
            patches.source_mask.cpu().numpy(),
            patches.target_mask.cpu().numpy(),
            self.config.mutual_top,
            self.config.min_score,
        )
        i = patches.source_index.cpu().numpy()[patch, row]
        j = patches.target_index.cpu().numpy()[patch, column]
        matches = PointMatches(
            source.fine_points.cpu().numpy()[i].astype(np.float64),
            target.fine_points.cpu().numpy()[j].astype(np.float64),
            probability[patch, row, column].astype(np.float64),
            patch,
        )
        return matches, estimate_pose(matches, self.config)


def _rows(features: Tensor, index: Tensor) -> Tensor:
    """Rows of features (N, C) at index (P, K); index N gives zeros."""
    padded = torch.cat([features, features.new_zeros(1, features.shape[1])])
    return padded[index]
