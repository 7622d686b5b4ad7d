# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The static head: what moved under a known pose, and that no pose depends on it."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import WeightsError
from hybridreg_ros.metrics.registration import roc_auc
from hybridreg_ros.model.budget import Budget
from hybridreg_ros.model.checkpoint import load_checkpoint, packaged_weights
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.model.register import HybridReg
from hybridreg_ros.model.static_points import head_input

if TYPE_CHECKING:
    from collections.abc import Callable

    from hybridreg_ros.model.network.forward import Network

VOXEL_M = 0.08


@pytest.fixture(scope='module')
def packaged() -> HybridReg:
    return HybridReg.from_pretrained()


@pytest.fixture(scope='module')
def headless(packaged: HybridReg) -> HybridReg:
    """The packaged weights without their static head."""
    config = dataclasses.replace(packaged.config, static_width=0)
    kept = load_checkpoint(packaged_weights()).parameters
    trunk = {k: v for k, v in kept.items() if not k.startswith('static.')}
    return HybridReg(config, HybridRegNet.of(config, trunk), packaged.calibration)


@pytest.fixture
def scene(room: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Source, target, T_target_source, and which source points moved: a box walked 0.7 m on."""
    rng = np.random.default_rng(7)
    room = room - np.array([2.2, 2.2, 1.0], np.float32)  # the sensor is in the middle of it
    face = rng.uniform(-0.5, 0.5, (1200, 3))
    rows = np.arange(len(face)), rng.integers(0, 3, len(face))
    face[rows] = rng.choice([-0.5, 0.5], len(face))
    box = (face * [0.4, 0.4, 1.2] + [1.0, 0.2, -0.3]).astype(np.float32)
    T = se3.exp(np.array([0.1, -0.05, 0.02, 0.0, 0.0, 0.1]))
    source = np.concatenate([room, box])
    target = np.concatenate([room[::-1], box + np.array([0.0, 0.7, 0.0], np.float32)])
    moved = np.arange(len(source)) >= len(room)
    return source, se3.apply(T, target).astype(np.float32), T, moved


def test_a_box_that_moved_is_told_from_the_room(packaged: HybridReg, scene: tuple) -> None:
    source, target, T, moved = scene
    result = packaged.register(source, target)
    static = result.source_static_probability
    assert static is not None
    assert static.dtype == np.float32
    assert ((static >= 0.0) & (static <= 1.0)).all()
    assert roc_auc(~moved, static) > 0.9
    assert result.target_static_probability is not None
    assert result.target_static_probability.shape == (len(target),)
    a, b = packaged.encode(source, VOXEL_M), packaged.encode(target, VOXEL_M)
    assert packaged.match(a, b).source_static_probability is None
    own = packaged.point_mask(a, b, T)
    assert roc_auc(~moved, own.static) > 0.9


def test_the_two_probabilities_stay_apart(packaged: HybridReg, room: np.ndarray) -> None:
    """Half of a cloud shows what is seen; the rest is static all the same."""
    room = room - np.array([2.2, 2.2, 1.0], np.float32)
    holed = np.insert(room, 5, np.nan, axis=0)
    a, b = packaged.encode(holed, VOXEL_M), packaged.encode(room[room[:, 0] < 0.0], VOXEL_M)
    own = packaged.point_mask(a, b, np.eye(4))
    assert own.static[5] == own.seen[5] == 0.5
    seen = np.insert(room[:, 0] < 0.0, 5, False)
    assert roc_auc(np.delete(seen, 5), np.delete(own.seen, 5)) > 0.9
    assert np.median(own.static[seen]) > 0.9


def test_no_pose_depends_on_the_head(
    packaged: HybridReg, headless: HybridReg, scene: tuple
) -> None:
    source, target, _, _ = scene
    for budget in (None, Budget(500, 64)):
        one, other = (m.register(source, target, budget=budget) for m in (packaged, headless))
        np.testing.assert_array_equal(one.T_target_source, other.T_target_source)
        np.testing.assert_array_equal(one.source_uncertainty, other.source_uncertainty)
        assert one.confidence == other.confidence
        assert other.source_static_probability is None


def test_a_few_points_speak_for_their_voxel(packaged: HybridReg, scene: tuple) -> None:
    source, target, T, moved = scene
    source = np.insert(source, 5, np.nan, axis=0)
    a, b = packaged.encode(source, 2.0 * VOXEL_M), packaged.encode(target, 2.0 * VOXEL_M)
    owner = a.encoding.pyramid.input_to_level0
    whole, few = head_input(a, b, T), head_input(a, b, T, 4)
    np.testing.assert_array_equal(whole.rows, np.flatnonzero(owner >= 0))
    np.testing.assert_array_equal(whole.rows[whole.answer[owner >= 0]], whole.rows)
    sizes = np.bincount(owner[owner >= 0])
    np.testing.assert_array_equal(np.bincount(owner[few.rows]), np.minimum(sizes, 4))
    assert (sizes > 4).any()
    assert few.answer[5] == -1
    np.testing.assert_array_equal(owner[few.rows[few.answer[owner >= 0]]], owner[owner >= 0])
    own = packaged.point_mask(a, b, T, 4)
    assert own.static[5] == 0.5
    assert roc_auc(~np.insert(moved, 5, False), own.static) > 0.85


def test_weights_without_a_head_say_so(headless: HybridReg, room: np.ndarray) -> None:
    encoded = headless.encode(room, VOXEL_M)
    with pytest.raises(WeightsError, match='no static head'):
        headless.point_mask(encoded, encoded, np.eye(4))


def test_the_order_of_the_points_does_not_matter(scene: tuple) -> None:
    torch.manual_seed(2)
    config = ModelConfig(static_width=8)
    model = HybridReg(config, HybridRegNet(config))
    source, target, T, _ = scene
    order = np.random.default_rng(0).permutation(len(source))
    b = model.encode(target, VOXEL_M)
    straight = model.point_mask(model.encode(source, VOXEL_M), b, T)
    mixed = model.point_mask(model.encode(source[order], VOXEL_M), b, T)
    np.testing.assert_allclose(mixed.static, straight.static[order], atol=2e-4)


@pytest.mark.parametrize('fine_level', [0, 1])
def test_torch_and_the_compiled_head_agree(
    scene: tuple, fine_level: int, by_torch: Callable[[HybridRegNet], Network]
) -> None:
    torch.manual_seed(2)
    config = ModelConfig(static_width=8, fine_level=fine_level)
    net = HybridRegNet(config)
    source, target, T, _ = scene
    one, other = (
        model.point_mask(model.encode(source, VOXEL_M), model.encode(target, VOXEL_M), T)
        for model in (HybridReg(config, net), HybridReg(config, by_torch(net)))
    )
    np.testing.assert_allclose(one.static, other.static, atol=1e-5)
    np.testing.assert_allclose(one.seen, other.seen, atol=1e-5)
