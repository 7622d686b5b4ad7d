# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The re-associated, tabulated attention equals the paper's formula and keeps its symmetries."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from hybridreg_ros.core import se3
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.geometry.pyramid import pairwise_bins
from hybridreg_ros.model.network.packed import sinusoids
from hybridreg_ros.model.reference.attention import CrossLayer, GeometryTable, SelfLayer

SMALL: dict[str, Any] = {'dim': 32, 'heads': 4}


def _layer(config: ModelConfig) -> tuple[GeometryTable, SelfLayer]:
    torch.manual_seed(5)
    return GeometryTable(config), SelfLayer(config)


def _points(rng: np.random.Generator, count: int = 40) -> np.ndarray:
    return rng.uniform(-30, 30, (count, 3)).astype(np.float32)


@pytest.mark.parametrize('reduction', ['mean', 'max'])
def test_reassociated_scores_equal_plain_formula(rng: np.random.Generator, reduction: str) -> None:
    config = ModelConfig(angle_reduction=reduction, **SMALL)
    table, layer = _layer(config)
    bins = torch.from_numpy(pairwise_bins(_points(rng), config))
    q = torch.randn(4, 40, 8)
    fast = layer.geometric_scores(q, table(), bins)
    rows = table()[bins.long()]
    angles = rows[:, :, 1:]
    reduced = angles.amax(dim=2) if reduction == 'max' else angles.mean(dim=2)
    r = layer.position(rows[:, :, 0] + reduced).view(40, 40, layer.heads, layer.width)
    plain = torch.einsum('hnc,nmhc->hnm', q, r)
    torch.testing.assert_close(fast, plain, atol=1e-4, rtol=1e-4)


def test_table_is_close_to_the_continuous_embedding(rng: np.random.Generator) -> None:
    config = ModelConfig(**SMALL)
    points = _points(rng)
    bins = torch.from_numpy(pairwise_bins(points, config))
    distance = np.linalg.norm(points[:, None] - points[None], axis=2).ravel()
    exact = torch.from_numpy(sinusoids(distance / config.sigma_distance, config.dim))
    nearest = GeometryTable(config).sinusoid[bins[:, :, 0].flatten().long()]
    error = (exact - nearest).norm(dim=1) / exact.norm(dim=1)
    assert error.max() < 0.5 * config.distance_step / config.sigma_distance
    assert error.mean() < 0.02


def test_self_attention_does_not_change_under_rigid_motion(rng: np.random.Generator) -> None:
    config = ModelConfig(**SMALL)
    table, layer = _layer(config)
    points, x = _points(rng).astype(np.float64), torch.randn(40, 32)
    T = se3.exp(np.array([5.0, -7.0, 2.0, 1.0, 0.5, -2.0]))

    def run(p: np.ndarray) -> torch.Tensor:
        return layer(x, table(), torch.from_numpy(pairwise_bins(p.astype(np.float32), config)))

    layer.position.weight.data *= 30.0  # let geometry decide the attention
    still, moved = run(points), run(se3.apply(T, points))
    sheared = run(points * np.array([1.0, 1.0, 1.5]))
    assert (still - moved).abs().mean() < 0.02 * (still - sheared).abs().mean()


def test_layers_are_permutation_equivariant(rng: np.random.Generator) -> None:
    config = ModelConfig(**SMALL)
    table, layer = _layer(config)
    cross = CrossLayer(config)
    points, x, y = _points(rng), torch.randn(40, 32), torch.randn(17, 32)
    order = rng.permutation(40)
    bins = torch.from_numpy(pairwise_bins(points, config))
    moved = torch.from_numpy(pairwise_bins(points[order], config))
    straight = layer(x, table(), bins)[order]
    torch.testing.assert_close(layer(x[order], table(), moved), straight, atol=1e-5, rtol=1e-4)
    plain, shuffled = cross(x, y)[0], torch.from_numpy(rng.permutation(17))
    torch.testing.assert_close(cross(x[order], y)[0], plain[order], atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(cross(x, y[shuffled])[0], plain, atol=1e-5, rtol=1e-4)
