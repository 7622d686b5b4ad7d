# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The network without gradients on a CPU, by compiled calls in place of tensor operations.

`HybridRegNet` is the reference; both agree up to the rounding of float32 (a test compares them).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from hybridreg_ros.model.network.forward_attention import correlate as _correlate
from hybridreg_ros.model.network.forward_attention import self_attention
from hybridreg_ros.model.network.forward_backbone import backbone
from hybridreg_ros.model.network.network import Encoding, SuperpointOutput
from hybridreg_ros.model.network.packed import weights_of
from hybridreg_ros.model.network.uncertainty import sigma2_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.model.geometry.kernel import KernelOperator
    from hybridreg_ros.model.geometry.pyramid import Pyramid
    from hybridreg_ros.model.network.network import HybridRegNet

    Operator = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]


def has_compiled_form(net: HybridRegNet) -> bool:
    """Whether the compiled functions do what this network does: on a CPU, mean over angles."""
    return (
        net.norm_groups == {net.config.groups}
        and net.config.angle_reduction == 'mean'
        and net.project.weight.device.type == 'cpu'
    )


@torch.no_grad()
def encode(net: HybridRegNet, pyramid: Pyramid) -> Encoding:
    """`HybridRegNet.encode`, compiled where that can be; what it keeps needs no operators."""
    if not has_compiled_form(net):
        return net.encode(pyramid)
    config, weights, levels = net.config, weights_of(net), pyramid.levels
    fine, coarse = backbone(
        weights.backbone,
        tuple(_operator(v.conv) for v in levels),
        tuple(_operator(v.pool) for v in levels[:-1]),
        tuple(_numbers(v.pool_index) for v in levels[:-1]),
        tuple(_numbers(v.up_index) for v in levels[:-1]),
        1 + config.extra_blocks,
        config.fine_level,
        config.groups,
    )
    bins = pyramid.geometry.numpy()
    features = self_attention(coarse, bins, weights.transformer, 0, config.heads)
    return Encoding(pyramid, torch.from_numpy(fine), torch.from_numpy(features))


@torch.no_grad()
def correlate(net: HybridRegNet, source: Encoding, target: Encoding) -> SuperpointOutput:
    """`HybridRegNet.correlate`, compiled where that can be.

    Raises:
        RegistrationError: the encodings were made with different voxel sizes.
    """
    if not has_compiled_form(net):
        return net.correlate(source, target)
    net.check_voxels(source, target)
    x, y, x_logits, y_logits = (
        torch.from_numpy(found)
        for found in _correlate(
            source.superpoint_features.numpy(),
            target.superpoint_features.numpy(),
            source.pyramid.geometry.numpy(),
            target.pyramid.geometry.numpy(),
            weights_of(net).transformer,
            net.config.blocks,
            net.config.heads,
        )
    )
    return SuperpointOutput(x, y, x_logits, y_logits, sigma2_of(x_logits), sigma2_of(y_logits))


def _operator(operator: KernelOperator | None) -> Operator:
    assert operator is not None, 'this pyramid was stripped once it was encoded'
    return operator.rows.numpy(), operator.columns.numpy(), operator.weights.numpy()


def _numbers(index: torch.Tensor | None) -> NDArray[np.int32]:
    assert index is not None, 'this pyramid was stripped once it was encoded'
    found: NDArray[np.int32] = index.numpy()
    return found
