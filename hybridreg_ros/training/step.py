# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Forward pass of one sample and its weighted losses."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from hybridreg_ros.model.geometry.pyramid import voxel_transform
from hybridreg_ros.model.network.descriptors import MATCH_TEMPERATURE
from hybridreg_ros.model.network.matching import pair_weights
from hybridreg_ros.model.reference.fused import tensor_of
from hybridreg_ros.training import losses

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.model.geometry.pyramid import Pyramid
    from hybridreg_ros.model.network.output import Encoding, SuperpointOutput
    from hybridreg_ros.model.reference.network import HybridRegNet
    from hybridreg_ros.training.config import LossConfig
    from hybridreg_ros.training.labels import PairLabels
    from hybridreg_ros.training.samples import Sample

STATIC_SHARE = 0.5
NEAR = 2.0
"""Match radii around a true match in which no negatives are drawn."""


class LossTerms(NamedTuple):
    """Loss terms of a pair before weighting, and their weighted sum.

    Attributes:
        total: scalar, to be differentiated.
        coarse: superpoint matching.
        fine: point matching.
        descriptor: InfoNCE over the whole cloud.
        mask: uncertainty mask.
        false_match: fine points that are sure of a wrong partner.
    """

    total: Tensor
    coarse: Tensor
    fine: Tensor
    descriptor: Tensor
    mask: Tensor
    false_match: Tensor


def pair_losses(
    network: HybridRegNet, sample: Sample, config: LossConfig, precision: str = 'float32'
) -> LossTerms:
    """All losses of one sample; terms with weight 0 are not computed.

    Args:
        network: in training mode.
        sample: on the device of the network.
        config: which terms, and their weights.
        precision: of the matrix products of the encoder, 'float32' or 'bf16'; all that follows is
            float32.
    """
    source, target = (_encoded(network, p, precision) for p in (sample.source, sample.target))
    coarse_out = network.correlate(source, target)
    labels = sample.labels
    zero = coarse_out.source_features.sum() * 0.0
    coarse = coarse_loss(coarse_out, labels, config, network.config)
    fine = zero
    if config.fine_weight > 0.0 and len(labels.pair_source):
        pairs = torch.stack(
            [torch.as_tensor(labels.pair_source), torch.as_tensor(labels.pair_target)], dim=1
        )
        assignment = network.patch_scores(source, target, pairs)
        valid = torch.ones(len(pairs), dtype=torch.bool, device=pairs.device)
        fine = losses.point_matching_loss(assignment, torch.as_tensor(labels.fine), valid)
    descriptor = zero
    if config.descriptor_weight > 0.0:
        descriptor = fine_descriptor_loss(
            source, target, labels, NEAR * config.match_radius_voxels
        )
    false_match = zero
    if config.false_match_weight > 0.0:
        V = voxel_transform(sample.pair.T_target_source, sample.source, sample.target)
        false_match = whole_cloud_false_match_loss(
            source, target, V, NEAR * config.match_radius_voxels
        )
    mask = mask_loss(coarse_out, labels, config) if config.mask != 'none' else zero
    total = (
        coarse
        + config.fine_weight * fine
        + config.descriptor_weight * descriptor
        + config.mask_weight * mask
        + config.false_match_weight * false_match
    )
    return LossTerms(total, coarse, fine, descriptor, mask, false_match)


def _encoded(network: HybridRegNet, pyramid: Pyramid, precision: str) -> Encoding[Tensor]:
    """The encoding of a cloud, its features in float32."""
    if precision == 'float32':
        return network.encode(pyramid)
    device = next(network.parameters()).device.type
    with torch.autocast(device, torch.bfloat16):
        encoding = network.encode(pyramid)
    return dataclasses.replace(
        encoding,
        fine_features=encoding.fine_features.float(),
        superpoint_features=encoding.superpoint_features.float(),
    )


def coarse_loss(
    output: SuperpointOutput[Tensor], labels: PairLabels, config: LossConfig, model: ModelConfig
) -> Tensor:
    """Weighted superpoint losses: cross-entropy, circle loss, or both.

    With `config.masked_correlation` the cross-entropy is that of the correlation as the mask
    weighs it; only the features learn from it, the mask has its own loss.
    """
    similarity = output.source_features @ output.target_features.T
    overlap = torch.as_tensor(labels.overlap)
    total = similarity.sum() * 0.0
    weight = None
    if config.masked_correlation:
        sigma2 = output.source_sigma2.detach(), output.target_sigma2.detach()
        weight = pair_weights(*sigma2, model.mask_combination, model.mask_exponent)
    if config.coarse != 'circle':
        total = total + config.coarse_weight * losses.overlap_cross_entropy(
            similarity, overlap, config.temperature, config.positive_overlap, weight
        )
    if config.coarse != 'cross_entropy':
        total = total + config.circle_weight * losses.overlap_circle_loss(
            similarity, overlap, positive=config.positive_overlap
        )
    return total


def fine_descriptor_loss(
    source: Encoding[Tensor], target: Encoding[Tensor], labels: PairLabels, near_voxels: float
) -> Tensor:
    """InfoNCE of the anchors against all fine points of the other cloud, mean of both ways.

    Points within `near_voxels` of an anchor's match are no negatives.
    """
    anchors = torch.as_tensor(labels.anchors)
    sides = (source, anchors[:, 0]), (target, anchors[:, 1])
    unit = [F.normalize(side.fine_features, dim=1) for side, _ in sides]
    terms = []
    for i, j in ((0, 1), (1, 0)):
        match = sides[j][1]
        points = tensor_of(sides[j][0].pyramid.fine_points, unit[j])
        near = torch.cdist(points[match], points) < near_voxels
        terms.append(losses.descriptor_loss(unit[i][sides[i][1]], unit[j], match, near))
    return torch.stack(terms).mean()


def whole_cloud_false_match_loss(
    source: Encoding[Tensor],
    target: Encoding[Tensor],
    V_target_source: NDArray[np.float64],
    near_voxels: float,
) -> Tensor:
    """`losses.false_match_loss` of all fine points of two clouds.

    Args:
        source: encoding of the source.
        target: encoding of the target.
        V_target_source: (4, 4) the true transform of their voxels.
        near_voxels: pairs within this distance are right; things that moved are wrong.
    """
    unit = [F.normalize(side.fine_features, dim=1) for side in (source, target)]
    x, y = (tensor_of(side.pyramid.fine_points, unit[0]) for side in (source, target))
    V = torch.from_numpy(V_target_source).to(x)
    right = torch.cdist(x @ V[:3, :3].T + V[:3, 3], y) < near_voxels
    return losses.false_match_loss(unit[0], unit[1], right, MATCH_TEMPERATURE)


def mask_loss(output: SuperpointOutput[Tensor], labels: PairLabels, config: LossConfig) -> Tensor:
    """The mask loss that the config names, mean of both clouds."""
    if config.mask in ('nll', 'log_sum_exp'):
        # exp(-||x - y||^2) of unit features: the paper's correlation before its normalisation
        correlation = torch.exp(2.0 * (output.source_features @ output.target_features.T - 1.0))
        overlaps = torch.as_tensor(labels.overlap) > config.positive_overlap
        log_variance = losses.pair_log_variance(output.source_sigma2, output.target_sigma2)
        form = losses.laplace_nll if config.mask == 'nll' else losses.laplace_log_sum_exp
        return form(correlation, overlaps, log_variance, stop_gradient=config.mask_stop_gradient)
    sides = (
        (output.source_logits, output.source_sigma2, labels.source_trusted, labels.source_static),
        (output.target_logits, output.target_sigma2, labels.target_trusted, labels.target_static),
    )
    terms = []
    for logits, sigma2, trusted, static in sides:
        if config.mask == 'l1':
            terms.append(losses.mask_l1(sigma2, torch.as_tensor(trusted)))
        else:
            terms.append(_side_bce(logits, torch.as_tensor(trusted), torch.as_tensor(static)))
    return torch.stack(terms).mean()


def _side_bce(logits: Tensor, trusted: Tensor, static: Tensor) -> Tensor:
    """BCE of one cloud's logits (S, 1) of P(trusted), or (S, 2) of P(static), P(seen | static)."""
    if logits.shape[1] == 1:
        return losses.mask_bce(-logits[:, 0], trusted)
    loss = losses.mask_bce(-logits[:, 0], static)
    on = static >= STATIC_SHARE
    if bool(on.any()):
        seen = (trusted[on] / static[on]).clamp(0.0, 1.0)
        loss = loss + losses.mask_bce(-logits[on, 1], seen)
    return loss
