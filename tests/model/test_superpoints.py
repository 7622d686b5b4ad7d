# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Correlation, dual normalisation, mask and top pairs."""

from __future__ import annotations

import pytest
import torch
from torch.nn.functional import normalize

from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.network.superpoints import (
    gaussian_correlation,
    pair_weights,
    select_pairs,
)


def test_correlation_is_gaussian_of_the_distance() -> None:
    torch.manual_seed(0)
    x, y = normalize(torch.randn(9, 8), dim=1), normalize(torch.randn(7, 8), dim=1)
    s = gaussian_correlation(x, y, dual=False)
    torch.testing.assert_close(s, torch.exp(-(torch.cdist(x, y) ** 2)), atol=1e-5, rtol=1e-4)
    dual = gaussian_correlation(x, y)
    row, column = s / s.sum(1, keepdim=True), s / s.sum(0, keepdim=True)
    torch.testing.assert_close(dual, row * column)


def test_pair_weights_trust_only_where_both_sides_do() -> None:
    a, b = torch.tensor([0.1, 0.99]), torch.tensor([0.2, 0.95])
    product = pair_weights(a, b, 'confidence_product')
    paper = pair_weights(a, b, 'variance_product')
    torch.testing.assert_close(product, torch.tensor([[0.72, 0.045], [0.008, 0.0005]]))
    assert paper[1, 0] > 0.8, "the paper's form keeps a moving superpoint against a static one"


@pytest.mark.parametrize('use_mask', [True, False])
def test_selection_finds_the_same_features_and_obeys_the_mask(use_mask: bool) -> None:
    torch.manual_seed(0)
    x = normalize(torch.randn(30, 16), dim=1)
    order = torch.randperm(30)
    sigma2 = torch.full((30,), 0.1)
    sigma2[:10] = 0.999
    config = ModelConfig(top_pairs=20, use_mask=use_mask)
    pairs = select_pairs(x, x[order], sigma2, sigma2[order], config)
    assert (order[pairs.index[:, 1]] == pairs.index[:, 0]).all()
    assert (pairs.scores[:-1] >= pairs.scores[1:]).all()
    assert bool((pairs.index[:, 0] >= 10).all()) is use_mask


def test_fewer_superpoints_than_pairs() -> None:
    x = normalize(torch.randn(3, 4), dim=1)
    pairs = select_pairs(x, x[:2], torch.zeros(3), torch.zeros(2), ModelConfig())
    assert pairs.index.shape == (6, 2)
