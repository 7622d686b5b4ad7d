# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Correlation, dual normalisation, mask and top pairs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist

from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.network.matching import gaussian_correlation, pair_weights, select_pairs
from hybridreg_ros.model.network.output import SuperpointOutput


def _unit(rng: np.random.Generator, count: int, width: int) -> np.ndarray:
    x = rng.normal(size=(count, width))
    return (x / np.linalg.norm(x, axis=1, keepdims=True)).astype(np.float32)


def _coarse(x: np.ndarray, y: np.ndarray, x_sigma2: np.ndarray, y_sigma2: np.ndarray) -> Any:
    none = np.zeros((0, 2), np.float32)
    return SuperpointOutput(x, y, none, none, x_sigma2, y_sigma2)


def test_correlation_is_gaussian_of_the_distance(rng: np.random.Generator) -> None:
    x, y = _unit(rng, 9, 8), _unit(rng, 7, 8)
    s = gaussian_correlation(x, y, dual=False)
    np.testing.assert_allclose(s, np.exp(-(cdist(x, y) ** 2)), atol=1e-5, rtol=1e-4)
    row, column = s / s.sum(1, keepdims=True), s / s.sum(0, keepdims=True)
    np.testing.assert_allclose(gaussian_correlation(x, y), row * column, rtol=1e-6)


def test_pair_weights_trust_only_where_both_sides_do() -> None:
    a, b = np.array([0.1, 0.99]), np.array([0.2, 0.95])
    product = pair_weights(a, b, 'confidence_product')
    np.testing.assert_allclose(product, [[0.72, 0.045], [0.008, 0.0005]])
    tensors = torch.from_numpy(a), torch.from_numpy(b)
    np.testing.assert_allclose(pair_weights(*tensors, 'confidence_product'), product)
    paper = pair_weights(a, b, 'variance_product')
    assert paper[1, 0] > 0.8, "the paper's form keeps a moving superpoint against a static one"


@pytest.mark.parametrize('use_mask', [True, False])
def test_selection_finds_the_same_features_and_obeys_the_mask(
    rng: np.random.Generator, use_mask: bool
) -> None:
    x, order = _unit(rng, 30, 16), rng.permutation(30)
    sigma2 = np.full(30, 0.1, np.float32)
    sigma2[:10] = 0.999
    config = ModelConfig(top_pairs=20, use_mask=use_mask)
    pairs = select_pairs(_coarse(x, x[order], sigma2, sigma2[order]), config)
    assert (order[pairs[:, 1]] == pairs[:, 0]).all()
    assert bool((pairs[:, 0] >= 10).all()) is use_mask


def test_the_best_pairs_come_first(rng: np.random.Generator) -> None:
    x, y, none = _unit(rng, 12, 4), _unit(rng, 9, 4), np.zeros(12, np.float32)
    pairs = select_pairs(_coarse(x, y, none, none[:9]), ModelConfig(top_pairs=30))
    scores = gaussian_correlation(x, y, temperature=ModelConfig().pair_temperature)
    np.testing.assert_array_equal(scores[tuple(pairs.T)], np.sort(scores.ravel())[::-1][:30])


def test_fewer_superpoints_than_pairs(rng: np.random.Generator) -> None:
    x, none = _unit(rng, 3, 4), np.zeros(3, np.float32)
    pairs = select_pairs(_coarse(x, x[:2], none, none[:2]), ModelConfig())
    assert pairs.shape == (6, 2)
