# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Further attempts at doubtful pairs: which is taken, when none is made, frames put right."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros import HybridReg
from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import ConfigError, RegistrationError
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.pose.confidence import ConfidenceFeatures
from hybridreg_ros.model.result import Correspondences, RegistrationResult
from hybridreg_ros.model.retry import (
    FRAMES,
    NARROW_FRAMES,
    exchanged,
    frames_of,
    in_order,
    most_confident,
    rotated,
    rotated_back,
)

if TYPE_CHECKING:
    from hybridreg_ros.model.reference.network import HybridRegNet

T = se3.transform(se3.so3_exp(np.array([0.2, -0.1, 0.4])), np.array([1.0, -2.0, 0.5]))


def result(confidence: float, seconds: float = 1.0) -> RegistrationResult:
    points = np.random.default_rng(0).normal(size=(20, 3)).astype(np.float32)
    none = np.zeros(0, np.float32)
    pairs = Correspondences(points, se3.apply(T, points), np.ones(20, np.float32))
    timings = {'encode': 0.5 * seconds, 'total': seconds}
    features = ConfidenceFeatures()
    return RegistrationResult(T, confidence, none, none, pairs, T, 20, 0.05, features, timings)


def test_most_confident_attempt_counts_and_sums_time() -> None:
    later = [lambda: result(0.6, 2.0), lambda: result(0.4, 4.0)]
    best = most_confident(result(0.5), later, sure=0.8)
    assert best.confidence == 0.6
    assert best.attempts == 3
    assert best.timings_s == {'encode': 3.5, 'total': 7.0}


def test_no_attempt_without_doubt() -> None:
    def never() -> RegistrationResult:
        raise AssertionError('not needed')

    assert most_confident(result(0.8), [never], sure=0.8).attempts == 1
    second = most_confident(result(0.1), [lambda: result(0.9), never], sure=0.8)
    assert (second.attempts, second.confidence) == (2, 0.8)  # doubt at first sight leaves a trace


def test_attempt_that_is_refused_is_passed_over() -> None:
    def refused() -> RegistrationResult:
        raise RegistrationError('too few voxels')

    best = most_confident(result(0.1), [refused, lambda: result(0.3)], sure=0.8)
    assert (best.confidence, best.attempts) == (0.3, 3)


def test_as_many_attempts_can_be_asked_for_as_there_are_ways() -> None:
    assert len(FRAMES) == len(NARROW_FRAMES)
    most = 2 + len(FRAMES)  # as it is, the other way round, in each frame
    assert ModelConfig(attempts=most).attempts == most
    with pytest.raises(ConfigError, match='attempts'):
        ModelConfig(attempts=most + 1)


def cone(seed: int, count: int = 400) -> np.ndarray:
    """(N, 3) points in a narrow view along z, nearer towards +y."""
    rng = np.random.default_rng(seed)
    rays = np.stack([rng.uniform(-0.7, 0.7, count), rng.uniform(-0.4, 0.4, count)], axis=1)
    depth = 3.0 - 2.0 * rays[:, 1]
    return np.column_stack([rays * depth[:, None], depth]).astype(np.float32)


def test_frames_turn_with_a_narrow_view_and_a_view_all_round_with_its_walls() -> None:
    source, target = cone(0), cone(1)
    Q = se3.so3_exp(np.array([1.0, -0.5, 2.0]))
    straight = frames_of(source, target)
    for R, turned in zip(straight, frames_of(rotated(source, Q), rotated(target, Q)), strict=True):
        np.testing.assert_allclose(turned @ Q, R, atol=1e-3)
    around = np.concatenate([source, source * [1, 1, -1]]).astype(np.float32)
    # mostly walls along x, ground, and something round: the angle is known up to right angles
    normals = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1], [0.6, 0.8, 0]], np.float32).repeat(
        5, axis=0
    )
    normals = np.concatenate([normals, normals[:5]])
    first = frames_of(around, around, normals)[0]
    for yaw in (0.3, 1.2, -2.0):
        Q = se3.so3_exp(np.array([0.0, 0.0, yaw]))
        again = frames_of(rotated(around, Q), rotated(around, Q), rotated(normals, Q))[0]
        angle = se3.rotation_angle_deg(again @ Q @ first.T)
        assert abs((angle + 45.0) % 90.0 - 45.0) < 0.1


def test_order_depends_on_neither_roles_nor_rotation() -> None:
    near, far = cone(0), np.float32(1.1) * cone(1)
    near[0] = np.nan
    Q = se3.so3_exp(np.array([1.0, -0.5, 2.0]))
    assert in_order(near, far)
    assert not in_order(far, near)
    assert in_order(rotated(near, Q), rotated(far, Q))
    near[1] = np.inf
    assert in_order(near, far)
    assert not in_order(far, near)


def test_exchanged_result_maps_the_other_way() -> None:
    straight = dataclasses.replace(
        result(0.5),
        source_uncertainty=np.zeros(3, np.float32),
        target_uncertainty=np.ones(4, np.float32),
    )
    back = exchanged(straight)
    np.testing.assert_allclose(
        back.T_target_source @ straight.T_target_source, np.eye(4), atol=1e-12
    )
    np.testing.assert_allclose(back.T_lgr @ straight.T_lgr, np.eye(4), atol=1e-12)
    assert (len(back.source_uncertainty), len(back.target_uncertainty)) == (4, 3)
    pairs = back.correspondences
    moved = se3.apply(back.T_target_source, pairs.source)
    np.testing.assert_allclose(moved, pairs.target, atol=1e-5)


@pytest.mark.parametrize('R', FRAMES + NARROW_FRAMES)
def test_result_in_rotated_frames_is_put_right(R: np.ndarray) -> None:
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    straight, C = result(0.5), se3.transform(R, np.zeros(3))
    pairs = straight.correspondences
    turned = dataclasses.replace(
        straight,
        T_target_source=C @ T @ se3.inverse(C),
        T_lgr=C @ T @ se3.inverse(C),
        correspondences=Correspondences(
            rotated(pairs.source, R), rotated(pairs.target, R), pairs.weights
        ),
    )
    back = rotated_back(turned, R)
    np.testing.assert_allclose(back.T_target_source, T, atol=1e-9)
    np.testing.assert_allclose(back.T_lgr, T, atol=1e-9)
    np.testing.assert_allclose(back.correspondences.source, pairs.source, atol=1e-5)
    np.testing.assert_allclose(back.correspondences.target, pairs.target, atol=1e-5)


def test_register_tries_again_while_in_doubt(compact_net: HybridRegNet, room: np.ndarray) -> None:
    shift = np.array([0.8, -0.4, 0.4], np.float32)
    found = {}
    for attempts in (1, 5):
        config = dataclasses.replace(compact_net.config, attempts=attempts, sure=1.0)
        found[attempts] = HybridReg(config, compact_net).register(room, room + shift, 0.05)
    one, five = found[1], found[5]
    assert (one.attempts, five.attempts) == (1, 5)
    assert five.confidence >= one.confidence
    np.testing.assert_allclose(
        five.T_target_source, se3.transform(np.eye(3), shift.astype(float)), atol=1e-3
    )
    pairs = five.correspondences
    offset = np.linalg.norm(pairs.source + shift - pairs.target, axis=1)
    assert (offset < 0.15).sum() >= five.inliers > 0
    assert five.source_uncertainty.shape == (len(room),)
