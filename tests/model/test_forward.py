# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The compiled forward pass against the network it stands for, to the rounding of float32."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from hybridreg_ros.core import se3
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.geometry.pyramid import build_pyramid
from hybridreg_ros.model.network import forward
from hybridreg_ros.model.network.forward_attention import exponentials
from hybridreg_ros.model.network.network import HybridRegNet
from hybridreg_ros.model.network.packed import weights_of
from hybridreg_ros.model.register import HybridReg

if TYPE_CHECKING:
    from hybridreg_ros.model.network.network import Encoding

FEATURES = 1e-5
"""Largest difference of features, relative to the largest of them."""
LOGITS = 1e-4


def apart(a: torch.Tensor, b: torch.Tensor) -> float:
    """Largest difference, relative to the largest number of the second."""
    return float((a - b).abs().max() / b.abs().max())


def both(room: np.ndarray, net: HybridRegNet) -> list[tuple[Encoding, Encoding]]:
    """Two clouds, each encoded by torch and by the compiled functions."""
    turn = se3.exp(np.array([0.3, -0.2, 0.1, 0.1, 0.2, 1.2]))
    clouds = room, (room[::2] @ turn[:3, :3].T + turn[:3, 3]).astype(np.float32)
    with torch.no_grad():
        pyramids = [build_pyramid(cloud, 0.08, net.config) for cloud in clouds]
        return [(net.encode(p), forward.encode(net, p)) for p in pyramids]


@pytest.mark.parametrize('change', [{}, {'extra_blocks': 0}, {'mask_outputs': 1, 'fine_level': 0}])
def test_features_and_scores_agree(room: np.ndarray, change: dict[str, Any]) -> None:
    torch.manual_seed(5)
    net = HybridRegNet(dataclasses.replace(ModelConfig(), **change)).eval()
    (a, fa), (b, fb) = both(room, net)
    assert apart(fa.fine_features, a.fine_features) < FEATURES
    assert apart(fa.superpoint_features, a.superpoint_features) < FEATURES
    with torch.no_grad():
        one, two = net.correlate(a, b), forward.correlate(net, fa, fb)
    for name in vars(one):
        assert apart(getattr(two, name), getattr(one, name)) < LOGITS, name


def test_pose_confidence_and_uncertainty_agree(
    room: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = HybridReg.from_pretrained()
    moved = (room + np.array([0.3, -0.2, 0.1], np.float32))[: len(room) * 3 // 4]
    a, b = (model.encode(cloud, 0.065) for cloud in (room, moved))
    fast = model.match(a, b)
    monkeypatch.setattr(forward, 'has_compiled_form', lambda net: False)
    a, b = (model.encode(cloud, 0.065) for cloud in (room, moved))
    slow = model.match(a, b)
    np.testing.assert_allclose(fast.T_target_source, slow.T_target_source, atol=1e-4)
    np.testing.assert_allclose(fast.confidence, slow.confidence, atol=1e-3)
    np.testing.assert_allclose(fast.source_uncertainty, slow.source_uncertainty, atol=1e-3)


def test_weights_are_packed_again_once_they_change(room: np.ndarray) -> None:
    net = HybridRegNet(ModelConfig()).eval()
    first = weights_of(net)
    assert weights_of(net) is first
    with torch.no_grad():
        net.project.bias.add_(1.0)
    assert weights_of(net) is not first
    (a, fa), _ = both(room, net)
    assert apart(fa.superpoint_features, a.superpoint_features) < FEATURES


def test_a_network_of_another_kind_takes_the_way_of_torch(room: np.ndarray) -> None:
    config = dataclasses.replace(ModelConfig(), angle_reduction='max', max_superpoints=40)
    net = HybridRegNet(config).eval()
    assert not forward.has_compiled_form(net)
    (a, fa), _ = both(room, net)
    torch.testing.assert_close(fa.superpoint_features, a.superpoint_features, rtol=0, atol=0)


@pytest.mark.parametrize('spread', [1.0, 60.0])
def test_exponentials(rng: np.random.Generator, spread: float) -> None:
    x = rng.uniform(-spread, 0.0, 999).astype(np.float32)
    power = np.empty(len(x), np.int32)
    wanted = np.exp(x.astype(np.float64))
    total = exponentials(x, 0.0, power, power.view(np.float32))
    np.testing.assert_allclose(x, wanted, rtol=1e-5)
    assert total == pytest.approx(wanted.sum(), rel=1e-5)
