# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Variants of the network: each changes what it says, and the pose that comes out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.model.checkpoint import save_network
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.training.variants import VARIANTS, load_variant

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope='module')
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('weights') / 'tiny.safetensors'
    config = ModelConfig(stem=8, widths=(8, 16, 16, 32), dim=32, fine_dim=16, groups=4, heads=2)
    save_network(path, HybridRegNet(config), {})
    return path


@pytest.mark.parametrize('name', VARIANTS)
def test_every_variant_registers(name: str, weights: Path) -> None:
    model = load_variant(name, weights)
    for field, value in VARIANTS[name].items():
        assert getattr(model.config, field) == value
    points = np.random.default_rng(0).uniform(0, 3, (1500, 3)).astype(np.float32)
    result = model.register(points, points, 0.1)
    assert np.isfinite(result.T_target_source).all()


def test_the_variants_differ(weights: Path) -> None:
    points = np.random.default_rng(0).uniform(0, 3, (1500, 3)).astype(np.float32)
    few = load_variant('lgr-top-32', weights).register(points, points[::2], 0.1)
    many = load_variant('lgr-top-96', weights).register(points, points[::2], 0.1)
    assert len(many.correspondences) > len(few.correspondences)


def test_unknown_variant(weights: Path) -> None:
    with pytest.raises(ConfigError, match='expected one of hybridreg, no-mask'):
        load_variant('magic', weights)
