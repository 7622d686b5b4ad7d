# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Static points meet the other surface, moving ones do not: measured, on every split."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from label_truth import SIGMAS, LabelCheck, check_labels

from hybridreg_ros.core.se3 import exp
from hybridreg_ros.data.hybridmatch.room_pairs import SPLITS, make_samples
from hybridreg_ros.data.pair import Label

if TYPE_CHECKING:
    from hybridreg_ros.data.hybridmatch.take import Sample

pytest.importorskip('embreex')
SEED = 8_990_000
FAST = ('room-match-rigid', 'room-lomatch-rigid', 'room-match-10-30', 'street-match-10-30')


@cache
def first(split: str) -> Sample:
    """The first pair of a split whose movers can tell."""
    for seed in range(SEED, SEED + 60):
        for sample in make_samples(split, seed, count=1):
            if split.endswith('rigid') or check_labels(sample).judged > 0.3:
                return sample
    raise AssertionError(f'no pair of {split} in 60 scenes')


def is_right(sample: Sample) -> bool:
    """Whether the labels of a pair agree with its clouds."""
    found = check_labels(sample)
    meets = found.static_points >= 100 and found.met > 0.8 and found.static < SIGMAS
    return meets and (np.isnan(found.left) or found.left > SIGMAS)


@pytest.mark.parametrize('split', FAST)
def test_labels_are_right(split: str) -> None:
    sample = first(split)
    assert is_right(sample)
    if split.endswith('rigid'):
        assert not sample.pair.source_label.any()
        assert not sample.pair.target_label.any()
    else:
        found = check_labels(sample)
        assert found.carried < SIGMAS < found.left


def test_wrong_transforms_and_labels_are_found() -> None:
    sample = first('room-match-10-30')
    pair = sample.pair
    for twist in ([0.3, 0.3, 0.3, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.15, 0.15, 0.15]):
        T = pair.T_target_source @ exp(np.array(twist))
        assert not is_right(replace(sample, pair=replace(pair, T_target_source=T)))
    # Movers sold as background, and as seen by both.
    blank, truth = np.zeros_like, sample.truth
    hidden = replace(
        pair, source_label=blank(pair.source_label), target_label=blank(pair.target_label)
    )
    everything = replace(truth, seen=truth.seen | (pair.source_label > 0))
    found = check_labels(replace(sample, pair=hidden, truth=everything))
    assert found.stray > 3.0 * check_labels(sample).stray + 0.02


def test_truth_tells_how_points_move() -> None:
    sample = first('room-match-10-30')
    pair, truth = sample.pair, sample.truth
    flow = truth.flow(pair)
    assert flow.shape == pair.source.shape
    assert not flow[pair.source_label == Label.STATIC].any()
    assert np.linalg.norm(flow[pair.source_label > 0], axis=1).max() > 0.1
    assert truth.sigma_m.shape == (len(pair.source),)
    assert (truth.sigma_m > 0.0).all()
    still = replace(sample, truth=replace(truth, times_s=(truth.times_s[0],) * 2))
    np.testing.assert_allclose(still.truth.flow(pair), 0.0, atol=1e-6)


def fifty_that_tell(split: str) -> list[LabelCheck]:
    """The first pairs of a split, up to the fiftieth that has surfaces both clouds see."""
    found: list[LabelCheck] = []
    for seed in range(SEED + 100, SEED + 500):
        found += [check_labels(sample) for sample in make_samples(split, seed)]
        if np.isfinite([f.static for f in found]).sum() >= 50:
            return found
    raise AssertionError(f'{len(found)} pairs of {split} in 400 scenes, too few that can tell')


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize('split', SPLITS)
def test_labels_are_right_on_fifty_pairs(split: str) -> None:
    found = fifty_that_tell(split)
    static, stray, carried, left = (
        np.array([getattr(f, name) for f in found])
        for name in ('static', 'stray', 'carried', 'left')
    )
    told = ~np.isnan(static)
    # Two lidars far apart in a park share little but foliage, which is no surface.
    assert told.mean() > (0.9 if 'lomatch' not in split or split.startswith('room') else 0.25)
    room = split.startswith('room')
    assert (static[told] < SIGMAS).mean() >= (1.0 if room else 0.95)
    assert np.median(static[told]) < (1.0 if room else 1.5)
    assert np.median(stray) < 0.05
    if split.endswith('rigid'):
        assert np.isnan(left).all()
        return
    tell = ~np.isnan(left)
    assert tell.mean() > 0.4, 'something moves measurably'
    # A body that bends or crouches comes to lie where another part of it was: not in all pairs.
    assert (left[tell] > SIGMAS).mean() > 0.9
    assert np.median(left[tell]) > 2.0 * SIGMAS
    assert np.median(carried[tell]) < SIGMAS
