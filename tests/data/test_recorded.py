# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pairs as recorded: the same by seed, few moving points, labels that agree with the geometry."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial import cKDTree

from hybridreg_ros.core.se3 import apply
from hybridreg_ros.data.hybridmatch.recorded import GAP_S, REACH_M, shot_times, who_moves
from hybridreg_ros.data.hybridmatch.recorded_rooms import KIND as ROOM
from hybridreg_ros.data.hybridmatch.recorded_streets import KIND as STREET
from hybridreg_ros.data.hybridmatch.room_pairs import make_samples, scene_of
from hybridreg_ros.data.overlap import near_cells
from hybridreg_ros.data.sensors.lidar_pattern import raster, rosette

if TYPE_CHECKING:
    from collections.abc import Callable

    from hybridreg_ros.data.hybridmatch.take import Sample
    from hybridreg_ros.data.sensors.lidar_pattern import PatternLidar

KINDS = {'street-recorded': STREET, 'room-recorded': ROOM}
SEEDS = (2, 3, 5)


@pytest.fixture(scope='module', params=KINDS)
def made(request: pytest.FixtureRequest) -> tuple[str, list[Sample]]:
    """Some pairs of a kind."""
    return request.param, [s for seed in SEEDS for s in make_samples(request.param, seed)]


def test_the_same_by_seed(made: tuple[str, list[Sample]]) -> None:
    kind, samples = made
    assert scene_of(kind) == kind.split('-')[0]
    again = make_samples(kind, SEEDS[0])
    assert 0 < len(again) <= 8
    for one, two in zip(samples, again, strict=False):
        assert one.pair.name == two.pair.name
        np.testing.assert_array_equal(one.pair.source, two.pair.source)
        np.testing.assert_array_equal(one.pair.target_label, two.pair.target_label)
    assert len({s.pair.name for s in samples}) == len(samples)


def test_within_bounds(made: tuple[str, list[Sample]]) -> None:
    kind, samples = made
    for sample in samples:
        pair = sample.pair
        gap = abs(sample.truth.times_s[0] - sample.truth.times_s[1])
        assert GAP_S[0] - 1e-6 <= gap <= GAP_S[1]
        assert np.linalg.norm(pair.T_target_source[:3, 3]) <= REACH_M
        assert pair.dynamic_share <= KINDS[kind].most_moving
        assert 2000 <= len(pair.source) <= 131_072
        for side in ('source', 'target'):
            label, instance = getattr(pair, f'{side}_label'), getattr(pair, f'{side}_instance')
            np.testing.assert_array_equal(label > 0, instance > 0)
    shares = np.array([s.pair.dynamic_share for s in samples])
    assert (shares > 0.0).mean() > 0.5


def test_static_overlays_and_moving_does_not(made: tuple[str, list[Sample]]) -> None:
    kind, samples = made
    near_m = 0.25 if kind.startswith('street') else 0.08
    behind: list[float] = []
    for sample in samples:
        pair, truth = sample.pair, sample.truth
        there = np.asarray(apply(pair.T_target_source, pair.source.astype(np.float64)))
        away, _ = cKDTree(pair.target).query(there)
        seen = truth.seen & (np.linalg.norm(pair.source, axis=1) < 25.0)
        assert np.median(away[seen]) < near_m
        moved = np.linalg.norm(truth.flow(pair), axis=1)
        assert not moved[pair.source_label == 0].any()
        gone = moved > 2.0 * near_m
        behind += away[gone].tolist()
    # What moves leaves its place: feet and backs may lie near other surfaces, most of it does not.
    assert len(behind) > 200
    assert np.median(behind) > near_m


def test_half_stand_and_calm_scenes_are_calm() -> None:
    units = [(None,)] * 8
    may = np.ones((8, 2), np.bool_)
    may[0, 0], may[1] = False, False
    moving = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        kept, moves = who_moves(rng, units, np.full(8, 0.004), may, 0.018)  # type: ignore[arg-type]
        assert not kept[1]
        assert kept[2:].all()
        assert (moves <= kept).all()
        assert moves[0] == kept[0]
        moving.append(int(moves.sum()))
    assert 0 in moving
    assert max(moving) <= 5
    assert 2.0 < np.mean(moving) < 5.0


def test_shot_times_lie_within_the_gap() -> None:
    times = shot_times(np.random.default_rng(0), 3.0)
    assert times[0] == 0.0
    assert (np.diff(times) >= 0.0).all()
    assert times[1] >= GAP_S[0]
    assert times[-1] <= 3.0


@pytest.mark.parametrize(('make', 'half_deg'), [(rosette, 38.0), (raster, 61.0)])
def test_pattern_lidars_fill_their_view_and_never_repeat(
    make: Callable[[np.random.Generator], PatternLidar], half_deg: float
) -> None:
    lidar = make(np.random.default_rng(0))
    rays = lidar.directions()
    azimuth = np.rad2deg(np.arctan2(rays[..., 1], rays[..., 0]))
    elevation = np.rad2deg(np.arcsin(rays[..., 2]))
    assert half_deg - 6.0 < np.abs(azimuth).max() < half_deg
    assert 10.0 < np.abs(elevation).max() < 14.0
    cells = np.histogram2d(azimuth.ravel(), elevation.ravel(), (30, 10))[0]
    assert (cells > 0).mean() > 0.9
    assert not np.allclose(rays, replace(lidar, phase_s=0.1).directions(), atol=1e-3)


def test_near_cells_finds_what_lies_in_the_cells_around() -> None:
    rng = np.random.default_rng(0)
    points, others = rng.uniform(0.0, 2.0, (400, 3)), rng.uniform(0.0, 2.0, (60, 3))
    low = np.minimum(points.min(0), others.min(0))
    mine, their = (np.floor((p - low) / 0.2) for p in (points, others))
    brute = (np.abs(mine[:, None] - their[None]) <= 1).all(-1).any(1)
    np.testing.assert_array_equal(near_cells(points, others, 0.2), brute)
