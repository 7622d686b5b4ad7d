# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Mask scores against set arithmetic, and the accumulator against one big mask."""

from __future__ import annotations

import doctest
import math

import numpy as np
import pytest

from hybridreg_ros.metrics import mask


def test_doctests() -> None:
    assert doctest.testmod(mask, globs={'np': np, **vars(mask)}).failed == 0


@pytest.mark.parametrize('share', [0.0, 0.05, 0.5, 1.0])
def test_score_against_sets(share: float) -> None:
    rng = np.random.default_rng(7)
    predicted, truth = rng.random(5000) < 0.3, rng.random(5000) < share
    called, moving = set(np.flatnonzero(predicted)), set(np.flatnonzero(truth))
    result = mask.score(mask.count(predicted, truth))
    both = called & moving
    assert result.iou == pytest.approx(len(both) / len(called | moving))
    assert result.precision == pytest.approx(len(both) / len(called))
    if moving:
        assert result.recall == pytest.approx(len(both) / len(moving))
    else:
        assert math.isnan(result.recall)
    if share < 1.0:
        still = set(range(5000)) - moving
        assert result.false_share == pytest.approx(len(called - moving) / len(still))
    assert result.moving_share == pytest.approx(len(moving) / 5000)


def test_nothing_called_nothing_moving() -> None:
    result = mask.score(mask.count(np.zeros(4, bool), np.zeros(4, bool)))
    assert math.isnan(result.iou)
    assert math.isnan(result.precision)
    assert result.false_share == 0.0


@pytest.mark.parametrize('shape', [(3,), (4, 1)])
def test_shapes_must_agree(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r'expected two \(N,\) masks'):
        mask.count(np.zeros(shape, bool), np.zeros(4, bool))
    with pytest.raises(ValueError, match=r'expected two \(N,\) masks'):
        mask.count(np.zeros((2, 2), bool), np.zeros((2, 2), bool))
