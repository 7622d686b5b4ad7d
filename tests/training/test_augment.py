# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hybridreg_ros.core import se3
from hybridreg_ros.data.pair import PointPair
from hybridreg_ros.training.augment import (
    augment,
    common_rotation,
    random_rotation,
    vertical_axis,
)
from hybridreg_ros.training.config import AugmentConfig

STILL = {'any_rotation_share': 0.0, 'common_rotation_rad': 0.0}
QUIET = AugmentConfig(
    noise_voxels=0.0, depth_noise=0.0, thin_share=0.0, crop_share=0.0, hole_share=0.0
)


def pair_of(n=1000, seed=0):
    rng = np.random.default_rng(seed)
    world = rng.uniform(-2, 2, (n, 3)) + np.array([0, 0, 4])
    T = se3.exp(rng.normal(0, 0.5, 6))
    return PointPair(
        source=world.astype(np.float32),
        target=se3.apply(T, world).astype(np.float32),
        T_target_source=T,
        source_label=(np.arange(n) % 3).astype(np.uint8),
        target_label=(np.arange(n) % 3).astype(np.uint8),
        source_instance=np.arange(n).astype(np.uint16),
        target_instance=np.arange(n).astype(np.uint16),
        overlap=1.0,
        dynamic_share=2 / 3,
        voxel_size_m=0.05,
    )


@pytest.mark.parametrize('seed', range(6))
@pytest.mark.parametrize('share', [0.0, 1.0])
def test_the_transform_stays_true(seed, share):
    config = dataclasses.replace(QUIET, any_rotation_share=share)
    made = augment(pair_of(), config, np.random.default_rng(seed))
    assert se3.is_rigid(made.T_target_source)
    moved = se3.apply(made.T_target_source, made.source.astype(np.float64))
    np.testing.assert_allclose(moved, made.target, atol=1e-4)


def test_scale_is_common_and_bounded():
    factors = []
    pair = pair_of()
    for seed in range(40):
        made = augment(pair, QUIET, np.random.default_rng(seed))
        size = np.linalg.norm(made.target.std(axis=0)) / np.linalg.norm(pair.target.std(axis=0))
        factors.append(size)
    assert 0.9 <= min(factors) < 0.95
    assert 1.05 < max(factors) <= 1.1


def test_relative_rotation_is_mostly_small_and_sometimes_large():
    config = dataclasses.replace(QUIET, **STILL, large_share=0.2)
    pair = pair_of(300)
    angles = []
    for seed in range(200):
        made = augment(pair, config, np.random.default_rng(seed))
        extra = pair.T_target_source[:3, :3].T @ made.T_target_source[:3, :3]
        angles.append(se3.rotation_angle_deg(extra))
    assert 10 < np.median(angles) < 25
    assert 40 < max(angles) < 61


@pytest.mark.parametrize('field', ['thin_share', 'crop_share', 'hole_share'])
def test_points_and_labels_leave_together(field):
    config = dataclasses.replace(QUIET, **{field: 1.0}, **STILL, scale_jitter=0.0)
    pair = pair_of(2000)
    fewer = 0
    for seed in range(5):
        made = augment(pair, config, np.random.default_rng(seed))
        rows = made.target_instance.astype(int)
        np.testing.assert_allclose(made.target, pair.target[rows], atol=1e-5)
        np.testing.assert_array_equal(made.target_label, pair.target_label[rows])
        assert len(made.source) == len(made.source_label) == len(made.source_instance)
        fewer += len(made.target) < 2000
    assert fewer >= 3


def test_noise_is_bounded_and_grows_with_range():
    pair = pair_of(4000)
    config = dataclasses.replace(QUIET, depth_noise=0.01, **STILL, scale_jitter=0.0)
    made = augment(pair, config, np.random.default_rng(3))
    error = np.linalg.norm(made.target - pair.target, axis=1)
    ranges = np.linalg.norm(pair.target, axis=1)
    cross = np.linalg.norm(np.cross(made.target - pair.target, pair.target), axis=1) / ranges
    assert 0 < error.mean() < 0.01 * ranges.mean()
    assert cross.max() < 1e-3 * error.max() + 1e-6


def test_never_too_few_points_are_left():
    config = AugmentConfig(thin_share=1.0, thin_keep=0.05, crop_share=1.0, crop_keep=0.1)
    for seed in range(10):
        made = augment(pair_of(300), config, np.random.default_rng(seed))
        assert len(made.source) >= 200
        assert len(made.target) >= 200


def test_same_seed_same_pair():
    a, b = (augment(pair_of(), AugmentConfig(), np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(a.source, b.source)
    np.testing.assert_array_equal(a.T_target_source, b.T_target_source)


def test_random_rotations_are_proper_and_spread():
    rng = np.random.default_rng(0)
    R = np.stack([random_rotation(rng) for _ in range(400)])
    np.testing.assert_allclose(
        R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (400, 1, 1)), atol=1e-9
    )
    assert (np.linalg.det(R) > 0).all()
    assert np.abs(R.mean(axis=0)).max() < 0.12


@pytest.mark.parametrize('vertical', [1, 2])
def test_yaw_keeps_the_vertical_and_covers_all_angles(vertical):
    config = AugmentConfig(any_rotation_share=0.0, yaw_share=1.0)
    up, ahead = np.eye(3)[vertical], np.eye(3)[0]
    angles = []
    for seed in range(200):
        R = common_rotation(config, np.random.default_rng(seed), vertical)
        np.testing.assert_allclose(R @ up, up, atol=1e-12)
        angles.append(np.arctan2(np.cross(ahead, R @ ahead) @ up, (R @ ahead) @ ahead))
    counts, _ = np.histogram(angles, bins=4, range=(-np.pi, np.pi))
    assert counts.min() > 30  # expected 50


@pytest.mark.parametrize('vertical', [1, 2])
@pytest.mark.parametrize('yaw_share', [0.0, 1.0])
def test_tilt_is_bounded_and_reaches_its_limit(vertical, yaw_share):
    config = AugmentConfig(any_rotation_share=0.0, tilt_share=1.0, yaw_share=yaw_share)
    tilts = []
    for seed in range(100):
        R = common_rotation(config, np.random.default_rng(seed), vertical)
        assert se3.is_rigid(se3.transform(R, np.zeros(3)))
        tilts.append(np.rad2deg(np.arccos(min(R[vertical, vertical], 1.0))))
    assert 20.0 < max(tilts) <= config.tilt_deg + 1e-9
    assert 8.0 < np.median(tilts) < 17.0  # expected 12.5


def test_yaw_and_tilt_shares_are_kept_to():
    config = AugmentConfig(
        any_rotation_share=0.0, yaw_share=0.7, tilt_share=0.4, common_rotation_rad=0.0
    )
    drawn = [common_rotation(config, np.random.default_rng(seed)) for seed in range(500)]
    untilted = np.mean([R[2, 2] > 1.0 - 1e-12 for R in drawn])
    untouched = np.mean([np.array_equal(R, np.eye(3)) for R in drawn])
    assert untilted == pytest.approx(0.6, abs=0.07)
    assert untouched == pytest.approx(0.3 * 0.6, abs=0.06)


def test_an_optical_frame_is_known_by_having_nothing_behind_it():
    camera = pair_of()  # everything lies at z from 2 to 6 in the source
    camera = dataclasses.replace(camera, target=camera.source)
    assert vertical_axis(camera) == 1
    below = camera.source - np.array([0.0, 0.0, 5.0], np.float32)
    assert vertical_axis(dataclasses.replace(camera, target=below)) == 2
