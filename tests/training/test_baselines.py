# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Baselines find an easy transform; kept scores survive a kill and are never mixed."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros.core.errors import ConfigError, DependencyError, FileFormatError
from hybridreg_ros.core.se3 import apply, exp, inverse
from hybridreg_ros.data.loaders.posed_frames import recorded_pair
from hybridreg_ros.metrics.registration import rotation_error_deg, wilson_interval
from hybridreg_ros.training.baselines import METHODS
from hybridreg_ros.training.evaluate import evaluate_method
from hybridreg_ros.training.kept_scores import KeptScores

if TYPE_CHECKING:
    from pathlib import Path

    from hybridreg_ros.data.pair import PointPair


@pytest.fixture(scope='module')
def pair() -> PointPair:
    """Three walls with bumps, turned by 50 degrees."""
    rng = np.random.default_rng(0)
    flat = rng.uniform(0.0, 3.0, (9000, 2))
    bump = 0.25 * np.sin(3.1 * flat[:, 0]) * np.cos(2.3 * flat[:, 1] + flat[:, 0])
    wall = np.repeat(np.arange(3), 3000)
    cloud = np.zeros((9000, 3))
    for k in range(3):
        rows = wall == k
        cloud[rows, k] = (1.0 + 0.3 * k) * bump[rows]
        cloud[rows, (k + 1) % 3], cloud[rows, (k + 2) % 3] = flat[rows].T
    T = exp(np.array([0.6, -0.4, 0.3, 0.3, 0.2, 0.8]))
    target = cloud[rng.random(9000) < 0.8]
    source = apply(inverse(T), cloud[rng.random(9000) < 0.8])
    return recorded_pair(source.astype(np.float32), target.astype(np.float32), T, 0.06, 'walls-0')


@pytest.mark.parametrize('name', list(METHODS))
def test_baselines_register_an_easy_pair(name: str, pair: PointPair) -> None:
    pytest.importorskip('open3d' if name == 'fpfh' else 'kiss_matcher')
    T = METHODS[name](pair)
    assert rotation_error_deg(pair.T_target_source, T) < 5.0
    assert np.linalg.norm(T[:3, 3] - pair.T_target_source[:3, 3]) < 0.2


@pytest.mark.parametrize(
    ('name', 'module'), [('fpfh', 'open3d'), ('kiss-matcher', 'kiss_matcher')]
)
def test_a_missing_package_is_named(
    name: str, module: str, pair: PointPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DependencyError, match=r'hybridreg_ros\[bench\]'):
        METHODS[name](pair)


def test_kept_scores_go_on_after_a_kill(tmp_path: Path, pair: PointPair) -> None:
    (score,) = evaluate_method('truth', lambda p: p.T_target_source, [pair]).scores
    path, about = tmp_path / 'new' / 's.jsonl', {'method': 'truth'}
    kept = KeptScores(path, about)
    assert kept.of(pair) is None
    kept.add(score)
    kept.add(replace(score, name='walls-1', rmse_m=math.inf))
    with path.open('a') as stream:
        stream.write('{"name": "half a li')
    again = KeptScores(path, about)
    assert again.of(pair) == kept.of(pair)
    other = again.of(replace(pair, name='walls-1'))
    assert other is not None
    assert not other.right
    assert again.of(replace(pair, overlap=0.123)) is None, 'the pair was another then'
    again.add(replace(score, name='walls-2'))
    assert len([json.loads(line) for line in path.read_text().splitlines()]) == 4
    with pytest.raises(ConfigError, match='holds scores of'):
        KeptScores(path, {'method': 'other'})
    path.write_text('no scores\n')
    with pytest.raises(FileFormatError, match='holds no scores'):
        KeptScores(path, about)
    memory = KeptScores(None, about)
    memory.add(score)
    assert memory.of(pair) == score


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(0)
    for share in (0.05, 0.5, 0.9):
        inside = [
            low <= share <= high
            for low, high in (wilson_interval(int(k), 50) for k in rng.binomial(50, share, 2000))
        ]
        assert 0.92 < np.mean(inside) < 0.98
    assert wilson_interval(0, 10)[0] == pytest.approx(0.0)
    assert wilson_interval(10, 10)[1] == pytest.approx(1.0)
    assert all(math.isnan(v) for v in wilson_interval(0, 0))
