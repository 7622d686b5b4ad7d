# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Weights of the choice between poses: fitted to planted contests, and to a real pair's."""

from __future__ import annotations

import numpy as np
import pytest
from conftest_training import TINY, make_pair

from hybridreg_ros.model.pose.score import TRACES, WEIGHTS
from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.model.register import HybridReg
from hybridreg_ros.training.choice import Contest, contest, fit_weights, held_out_wins, won

N = len(TRACES)


def planted(rng, count, weights, noise=0.3):
    """Contests in which the pose with the largest weighted traces is right, mostly."""
    out = []
    for i in range(count):
        x = rng.normal(size=(10, N)) * rng.uniform(0.5, 2.0, N)
        right = np.zeros(10, bool)
        right[np.argmax(x @ weights + noise * rng.normal(size=10))] = True
        out.append(Contest(f'scene-{i // 3}', x, right))
    return out


def test_planted_weights_are_found():
    rng = np.random.default_rng(0)
    true = np.array([1.0, -2.0, 0.0, 3.0, 0.5, 0.0, -1.0, 2.0])
    train, test = planted(rng, 300, true), planted(rng, 300, true)
    weights = fit_weights(train)
    cosine = weights @ true / np.linalg.norm(weights) / np.linalg.norm(true)
    assert cosine > 0.97
    best = won(test, true).mean()
    assert won(test, weights).mean() > best - 0.05
    assert best > 0.8
    assert held_out_wins(train).mean() > 0.7


def test_chance_does_not_win_held_out_scenes():
    rng = np.random.default_rng(1)
    contests = planted(rng, 120, np.zeros(N), noise=1.0)
    assert held_out_wins(contests).mean() < 0.3  # chance: 0.1
    assert won(contests, fit_weights(contests)).mean() < 0.5


def test_contests_that_nobody_can_lose_say_nothing():
    rng = np.random.default_rng(2)
    x = rng.normal(size=(4, N))
    lost, safe = Contest('a', x, np.zeros(4, bool)), Contest('b', x, np.ones(4, bool))
    with pytest.raises(ValueError, match='no pair has right and wrong'):
        fit_weights([lost, safe])
    np.testing.assert_array_equal(won([lost, safe], WEIGHTS), [False, True])


def test_contest_of_a_pair():
    pair = make_pair(0)
    found = contest(HybridReg(TINY, HybridRegNet(TINY)), pair)
    assert found.scene == 'boxes'
    assert found.traces.shape == (len(found.right), N)
    assert np.isfinite(found.traces).all()
    assert len(found.right) % 2 == 0
    shares = found.traces[:, [TRACES.index(n) for n in ('fit', 'tight', 'trusted', 'agreement')]]
    assert ((shares >= 0.0) & (shares <= 1.0)).all()
