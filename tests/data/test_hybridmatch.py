# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pairs: the same bytes for the same seed, labels that are right, overlap that is measured."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial import cKDTree

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.core.se3 import apply
from hybridreg_ros.data.hybridmatch import street_pairs
from hybridreg_ros.data.hybridmatch.room_pairs import (
    CROWD,
    SPLITS,
    cell_of,
    make_pairs,
    make_samples,
    parse_split,
    scene_of,
)
from hybridreg_ros.data.hybridmatch.shards import encode_pair
from hybridreg_ros.data.hybridmatch.stage import make_world
from hybridreg_ros.data.meshes.scene import Standing

if TYPE_CHECKING:
    from hybridreg_ros.data.hybridmatch.take import Sample
    from hybridreg_ros.data.pair import PointPair

SEED = 8_990_000


@cache
def some(split: str, still: bool = False, scenes: int = 1) -> tuple[Sample, ...]:
    """Samples of the first scenes that give any."""
    found: list[Sample] = []
    for seed in range(SEED, SEED + 60):
        made = make_samples(split, seed, count=2, still=still)
        found += made
        scenes -= bool(made)
        if scenes == 0:
            return tuple(found)
    raise AssertionError(f'no pair of {split} in 60 scenes')


def nearest(pair: PointPair) -> np.ndarray:
    """Distance (N,) of each source point to the nearest target point."""
    away: np.ndarray = cKDTree(pair.target).query(apply(pair.T_target_source, pair.source))[0]
    return away


def test_overlap_is_what_a_search_of_neighbours_finds() -> None:
    for split in ('room-match-rigid', 'room-match-10-30'):
        for sample in some(split):
            pair = sample.pair
            away = nearest(pair)
            static = pair.source_label == 0
            found = float((away[static] < pair.voxel_size_m).mean())
            assert pair.overlap == pytest.approx(found, abs=0.12)


def test_pairs_keep_the_limits_of_their_cell() -> None:
    for split in ('room-match-rigid', 'room-match-10-30'):
        cell = cell_of(split)
        for sample in some(split):
            pair = sample.pair
            assert cell.overlap[0] < pair.overlap < cell.overlap[1]
            moving = (pair.source_label > 0).sum() + (pair.target_label > 0).sum()
            share = moving / (len(pair.source) + len(pair.target))
            assert pair.dynamic_share == pytest.approx(share)
            if not cell.frozen:
                assert cell.dynamic[0] <= share <= cell.dynamic[1]
                assert sample.displacement_m > 0.25
            assert min(len(pair.source), len(pair.target)) >= 2000
            assert pair.source.dtype == np.float32
            assert np.isfinite(pair.source).all()
            assert len(pair.source_label) == len(pair.source_instance) == len(pair.source)
            np.testing.assert_array_equal(pair.source_label > 0, pair.source_instance > 0)


def test_the_levels_of_a_scene_differ_in_what_moves_alone() -> None:
    worlds = {}
    for level in ('rigid', '10-30', '30-50'):
        cell = cell_of(f'room-match-{level}')
        rng = np.random.default_rng([SEED + 1, 1])
        worlds[level] = make_world(rng, crowded=True, wanted=CROWD, cell=cell)
    still, part, full = worlds.values()
    assert still is not None
    assert part is not None
    assert full is not None
    for world in (part, full):
        np.testing.assert_array_equal(world.view.poses, still.view.poses)
        np.testing.assert_array_equal(world.gone, still.gone)
        np.testing.assert_array_equal(world.view.crowd[1], still.view.crowd[1])
        assert world.camera.max_depth_m == still.camera.max_depth_m
        assert world.displacement_m > 0.25
    assert not still.view.dynamic.any()
    np.testing.assert_array_equal(full.view.dynamic, full.view.crowd)
    assert (part.view.dynamic <= part.view.crowd).all()
    assert 0.0 < part.view.dynamic.mean() < 0.8 * part.view.crowd.mean()
    standing = [isinstance(mover, Standing) for mover in part.caster.scene.movers]
    assert any(standing)
    assert not all(standing)


@pytest.mark.slow
@pytest.mark.parametrize('split', ['room-lomatch-30-50', 'room-match-30-50', 'room-lomatch-rigid'])
def test_rare_cells_fill(split: str) -> None:
    cell = cell_of(split)
    for sample in some(split, scenes=2):
        assert cell.overlap[0] < sample.pair.overlap < cell.overlap[1]
        assert cell.frozen or 0.3 <= sample.pair.dynamic_share <= 0.5


def test_the_same_seed_gives_the_same_bytes() -> None:
    seed = some('room-match-10-30')[0].pair.seed
    (first,) = make_pairs('room-match-10-30', seed, 1)
    assert encode_pair(first) == encode_pair(some('room-match-10-30')[0].pair)


def test_the_still_twin_shows_the_target_without_motion() -> None:
    (sample, *_) = some('room-match-10-30', still=True)
    plain = some('room-match-10-30')[0]
    assert encode_pair(sample.pair) == encode_pair(plain.pair), 'the twin changes nothing'
    assert plain.still is None
    assert sample.still is not None
    pair = sample.pair
    moving = apply(pair.T_target_source, pair.source[pair.source_label > 0])
    there = cKDTree(sample.still).query(moving)[0]
    then = cKDTree(pair.target).query(moving)[0]
    assert np.median(there) < np.median(then)
    assert np.median(there) < 0.05


def test_the_two_clouds_of_a_rigid_pair_have_no_movers() -> None:
    for sample in some('room-match-rigid', still=True):
        assert sample.still is sample.pair.target
        assert sample.displacement_m == 0.0


def test_views_of_a_scene_are_not_repeated() -> None:
    poses = [s.pair.T_target_source.tobytes() for s in some('room-match-rigid')]
    assert len(set(poses)) == len(poses)


def test_the_training_mixture_names_its_cells() -> None:
    pairs = [sample.pair for sample in some('room-train')]
    names = [p.name for p in pairs]
    assert len(set(names)) == len(names)
    assert all(p.name.startswith(f'room-{p.seed:07d}-') for p in pairs)


def test_street_names_lead_to_streets(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def street_cell(*args: object, **kwargs: object) -> list[Sample]:
        calls.append((args, kwargs))
        return []

    monkeypatch.setattr(street_pairs, 'street_cell', street_cell)
    for split in ('street-lomatch-30-50', 'street-match-rigid'):
        assert make_samples(split, 7, count=2, still=True) == []
        assert calls[-1] == ((7, cell_of(split), 2), {'still': True, 'name': split})
    make_samples('street-train', 8)
    make_samples('street-train', 9)
    assert calls[-1][0][1] != calls[-2][0][1], 'the mixture goes through its cells'


@pytest.mark.slow
def test_a_street_pair_is_a_street_pair() -> None:
    for seed in range(SEED, SEED + 20):
        for pair in make_pairs('street-match-10-30', seed, 1):
            assert pair.name.startswith('street-match-10-30-')
            assert pair.voxel_size_m == pytest.approx(0.3)
            assert 0.1 <= pair.dynamic_share <= 0.3
            return
    raise AssertionError('no street pair in 20 scenes')


def test_split_names() -> None:
    assert len(SPLITS) == 12
    assert parse_split('street-lomatch-30-50') == ('street', 'lomatch', '30-50')
    assert scene_of('street-train') == 'street'
    for wrong in ('room', 'room-match', 'room-match-10', 'roof-match-rigid', 'room-train-rigid'):
        with pytest.raises(ConfigError, match='split: expected'):
            scene_of(wrong)
    with pytest.raises(ConfigError, match='split: expected'):
        cell_of('room-matches-rigid')
