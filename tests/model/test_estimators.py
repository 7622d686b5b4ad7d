# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""LGR and RANSAC: exact on clean matches, right with 60 % outliers, honest with none."""

from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.core import se3
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.network.estimators import (
    PointMatches,
    batched_kabsch,
    estimate_pose,
    lgr,
    mutual_matches,
    ransac,
)

TRUE = se3.exp(np.array([8.0, -5.0, 3.0, 0.4, -0.3, 0.9]))


def _matches(rng: np.random.Generator, outliers: float, noise: float = 0.0) -> PointMatches:
    """40 patches of 12 matches; whole patches and single matches are wrong."""
    patch = np.repeat(np.arange(40), 12)
    centre = rng.uniform(-40, 40, (40, 3))
    source = centre[patch] + rng.uniform(-4, 4, (480, 3))
    target = (
        se3.apply(TRUE, source) + rng.normal(0, noise, (480, 3))
        if noise
        else (se3.apply(TRUE, source))
    )
    bad_patch = np.arange(40) < 40 * outliers * 0.7
    bad = bad_patch[patch] | (rng.random(480) < 0.3 * outliers)
    target = np.where(bad[:, None], rng.uniform(-40, 40, (480, 3)), target)
    return PointMatches(source, target, rng.uniform(0.1, 1.0, 480), patch)


@pytest.mark.parametrize('estimator', ['lgr', 'ransac'])
def test_exact_on_clean_matches(rng: np.random.Generator, estimator: str) -> None:
    config = ModelConfig(estimator=estimator)
    estimate = estimate_pose(_matches(rng, 0.0), config)
    np.testing.assert_allclose(estimate.V_target_source, TRUE, atol=1e-9)
    assert estimate.inliers.all()
    assert estimate.residual < 1e-9


@pytest.mark.parametrize('method', [lgr, ransac])
def test_right_with_sixty_percent_outliers(rng: np.random.Generator, method: object) -> None:
    matches = _matches(rng, 0.85, noise=0.3)
    wrong = np.linalg.norm(se3.apply(TRUE, matches.source) - matches.target, axis=1) > 3.0
    assert wrong.mean() > 0.6
    estimate = method(matches, 2.0, 5)  # type: ignore[operator]
    error = se3.inverse(TRUE) @ estimate.V_target_source
    assert se3.rotation_angle_deg(error[:3, :3]) < 0.5
    assert np.linalg.norm(error[:3, 3]) < 0.5
    assert not estimate.inliers[wrong].any()
    assert 0.2 < estimate.residual < 1.0


def test_agreement_tells_right_from_wrong(rng: np.random.Generator) -> None:
    right = lgr(_matches(rng, 0.3), 2.0, 5)
    wrong = lgr(_matches(rng, 1.4), 2.0, 5)
    assert right.agreeing > 0.6 > 0.2 > wrong.agreeing


@pytest.mark.parametrize('count', [0, 1, 2])
def test_too_few_matches_give_the_identity_without_inliers(count: int) -> None:
    few = PointMatches(
        np.ones((count, 3)), np.ones((count, 3)), np.ones(count), np.zeros(count, np.int64)
    )
    for method in (lgr, ransac):
        estimate = method(few, 2.0, 5)
        np.testing.assert_array_equal(estimate.V_target_source, np.eye(4))
        assert estimate.inliers.shape == (count,)
        assert not estimate.inliers.any()


def test_matches_spread_thin_over_patches_still_give_a_pose(rng: np.random.Generator) -> None:
    source = rng.uniform(-20, 20, (30, 3))
    thin = PointMatches(source, se3.apply(TRUE, source), np.ones(30), np.arange(30))
    np.testing.assert_allclose(lgr(thin, 2.0, 5).V_target_source, TRUE, atol=1e-9)


def test_ransac_with_fewer_samples(rng: np.random.Generator) -> None:
    estimate = ransac(_matches(rng, 0.3), 2.0, 5, samples=100)
    np.testing.assert_allclose(estimate.V_target_source, TRUE, atol=1e-6)
    assert len(estimate.inliers) == 100


def test_batched_kabsch_equals_single(rng: np.random.Generator) -> None:
    source, target = rng.normal(size=(6, 9, 3)), rng.normal(size=(6, 9, 3))
    target[3] = source[3] * np.array([1.0, 1.0, -1.0])  # a reflection must not be returned
    weights = rng.random((6, 9))
    weights[2, 5:] = 0.0
    batch = batched_kabsch(source, target, weights)
    for i in range(6):
        np.testing.assert_allclose(
            batch[i], se3.kabsch(source[i], target[i], weights[i]), atol=1e-9
        )
        assert np.linalg.det(batch[i, :3, :3]) == pytest.approx(1.0)


def test_mutual_matches_equal_plain_loops(rng: np.random.Generator) -> None:
    scores = rng.random((4, 7, 9)).astype(np.float32)
    rows, columns = rng.random((4, 7)) < 0.8, rng.random((4, 9)) < 0.8
    found = set(zip(*mutual_matches(scores, rows, columns, 3, 0.05), strict=True))
    expected = set()
    for p in range(4):
        s = np.where(rows[p][:, None] & columns[p][None], scores[p], -1.0)
        for i in range(7):
            for j in range(9):
                best_row = (s[i] > s[i, j]).sum() < 3
                best_column = (s[:, j] > s[i, j]).sum() < 3
                if s[i, j] > 0.05 and best_row and best_column:
                    expected.add((p, i, j))
    assert found == expected
