# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import doctest

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import mannwhitneyu

from hybridreg_ros.core import se3
from hybridreg_ros.metrics import registration as reg


def random_pose(rng):
    return se3.exp(np.concatenate([rng.normal(size=3), rng.normal(size=3)]))


def test_doctests():
    result = doctest.testmod(reg)
    assert result.attempted > 8
    assert result.failed == 0


@pytest.mark.parametrize('seed', range(5))
def test_rotation_error_against_scipy(seed):
    rng = np.random.default_rng(seed)
    A, B = random_pose(rng), random_pose(rng)
    relative = Rotation.from_matrix(A[:3, :3]).inv() * Rotation.from_matrix(B[:3, :3])
    assert reg.rotation_error_deg(A, B) == pytest.approx(np.rad2deg(relative.magnitude()))


def test_rmse_against_a_loop_and_empty():
    rng = np.random.default_rng(0)
    A, B, points = random_pose(rng), random_pose(rng), rng.normal(size=(7, 3))
    total = 0.0
    for p in points:
        a = A[:3, :3] @ p + A[:3, 3]
        b = B[:3, :3] @ p + B[:3, 3]
        total += sum((a - b) ** 2)
    assert reg.rmse_m(A, B, points) == pytest.approx((total / 7) ** 0.5)
    assert reg.rmse_m(A, B, points[:0]) == float('inf')


def test_errors_do_not_depend_on_the_world_frame():
    rng = np.random.default_rng(1)
    A, B, W = random_pose(rng), random_pose(rng), random_pose(rng)
    assert reg.rotation_error_deg(W @ A, W @ B) == pytest.approx(reg.rotation_error_deg(A, B))
    points = rng.normal(size=(5, 3))
    assert reg.rmse_m(W @ A, W @ B, points) == pytest.approx(reg.rmse_m(A, B, points))


def test_recall_of_no_pairs_is_unknown():
    assert np.isnan(reg.feature_matching_recall(np.array([])))


def test_inlier_ratio_uses_the_true_transform():
    rng = np.random.default_rng(2)
    T = random_pose(rng)
    source = rng.normal(size=(10, 3))
    target = se3.apply(T, source)
    target[:4] += [0.3, 0.0, 0.0]
    assert reg.inlier_ratio(T, source, target) == pytest.approx(0.6)
    assert reg.inlier_ratio(T, source[:0], target[:0]) == 0.0


def test_coarse_precision_of_nothing_is_zero():
    none = np.zeros(0, np.int64)
    assert reg.coarse_precision(np.ones((2, 2)), none, none) == 0.0


@pytest.mark.parametrize('levels', [4, 1000])
def test_auc_against_mann_whitney(levels):
    rng = np.random.default_rng(3)
    positive = rng.random(80) < 0.4
    score = np.round((rng.random(80) + 0.3 * positive) * levels) / levels
    u = mannwhitneyu(score[positive], score[~positive]).statistic
    expected = u / (positive.sum() * (~positive).sum())
    assert reg.roc_auc(positive, score) == pytest.approx(expected)
    assert np.isnan(reg.roc_auc(np.ones(3, bool), score[:3]))


def test_bootstrap_covers_the_normal_interval():
    rng = np.random.default_rng(4)
    values = rng.normal(1.0, 2.0, 400)
    low, high = reg.bootstrap_interval(values)
    half = 1.96 * values.std() / 20.0
    assert low == pytest.approx(values.mean() - half, abs=0.05)
    assert high == pytest.approx(values.mean() + half, abs=0.05)
    assert all(np.isnan(reg.bootstrap_interval(np.array([]))))
