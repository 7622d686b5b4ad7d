# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The compiled forward pass against the network it stands for, to the rounding of float32."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from hybridreg_ros.core import se3
from hybridreg_ros.model.checkpoint import load_checkpoint, packaged_weights
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.geometry.pyramid import build_pyramid
from hybridreg_ros.model.network.forward_attention import exponentials
from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.model.register import HybridReg

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from hybridreg_ros.model.network.forward import Network

    F32 = NDArray[np.float32]
    ByTorch = Callable[[HybridRegNet], Network]

FEATURES = 1e-5
"""Largest difference of features, relative to the largest of them."""
LOGITS = 1e-4


def apart(a: F32, b: F32) -> float:
    """Largest difference, relative to the largest number of the second."""
    return float(np.abs(a - b).max() / np.abs(b).max())


@pytest.mark.parametrize(
    'change',
    [
        {},
        {'extra_blocks': 0},
        {'mask_outputs': 1, 'fine_level': 0},
        {'angle_reduction': 'max', 'max_superpoints': 100},
        {'bottleneck': 8, 'groups': 16},
    ],
)
def test_features_and_scores_agree(
    room: np.ndarray, change: dict[str, Any], by_torch: ByTorch
) -> None:
    torch.manual_seed(5)
    net = HybridRegNet(dataclasses.replace(ModelConfig(), **change)).eval()
    turn = se3.exp(np.array([0.3, -0.2, 0.1, 0.1, 0.2, 1.2]))
    clouds = room, (room[::2] @ turn[:3, :3].T + turn[:3, 3]).astype(np.float32)
    pyramids = [build_pyramid(cloud, 0.08, net.config) for cloud in clouds]
    (a, fa), (b, fb) = ((by_torch(net).encode(p), net.for_use().encode(p)) for p in pyramids)
    assert apart(fa.fine_features, a.fine_features) < FEATURES
    assert apart(fa.superpoint_features, a.superpoint_features) < FEATURES
    one, two = by_torch(net).correlate(a, b), net.for_use().correlate(fa, fb)
    for name in vars(one):
        assert apart(getattr(two, name), getattr(one, name)) < LOGITS, name


def test_pose_confidence_and_uncertainty_agree(room: np.ndarray, by_torch: ByTorch) -> None:
    found = load_checkpoint(packaged_weights())
    moved = (room + np.array([0.3, -0.2, 0.1], np.float32))[: len(room) * 3 // 4]
    fast, slow = (
        model.match(*(model.encode(cloud, 0.065) for cloud in (room, moved)))
        for model in (
            HybridReg.from_pretrained(),
            HybridReg(found.config, by_torch(found.network), found.calibration),
        )
    )
    np.testing.assert_allclose(fast.T_target_source, slow.T_target_source, atol=1e-4)
    np.testing.assert_allclose(fast.confidence, slow.confidence, atol=1e-3)
    np.testing.assert_allclose(fast.source_uncertainty, slow.source_uncertainty, atol=1e-3)


def test_neither_import_step_nor_registration_needs_torch(tmp_path: Path) -> None:
    code = """
import sys
import numpy as np
from hybridreg_ros import HybridOdometry, HybridReg, Scan
rng = np.random.default_rng(0)
room = rng.uniform(-2.0, 2.0, (3000, 3))
room[np.arange(3000), rng.integers(0, 3, 3000)] = 2.0
points = room.astype(np.float32)
odometry = HybridOdometry()
sources = [odometry.step(Scan(points, stamp=k * 100_000_000)).source.value for k in (1, 2, 3)]
assert 'hybridreg' in sources, sources
assert HybridReg.from_pretrained().register(points, points).confidence > 0.1
import hybridreg_ros.cli.cmd_register, hybridreg_ros.cli.cmd_replay, hybridreg_ros.replay.runner
assert 'torch' not in sys.modules, 'torch was imported'
"""
    subprocess.run([sys.executable, '-c', code], check=True, cwd=tmp_path)


@pytest.mark.parametrize('spread', [1.0, 60.0])
def test_exponentials(rng: np.random.Generator, spread: float) -> None:
    x = rng.uniform(-spread, 0.0, 999).astype(np.float32)
    power = np.empty(len(x), np.int32)
    wanted = np.exp(x.astype(np.float64))
    total = exponentials(x, 0.0, power, power.view(np.float32))
    np.testing.assert_allclose(x, wanted, rtol=1e-5)
    assert total == pytest.approx(wanted.sum(), rel=1e-5)
