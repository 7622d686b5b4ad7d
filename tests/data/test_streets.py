# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Streets: rough ground, a free way, movers that stay around, pairs that suit their cell."""

from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.core.se3 import apply, is_rigid
from hybridreg_ros.data.hybridmatch.cell import Cell
from hybridreg_ros.data.hybridmatch.street_pairs import _with_some_moving, street_cell
from hybridreg_ros.data.meshes.raycast import Caster
from hybridreg_ros.data.meshes.scene import Standing
from hybridreg_ros.data.overlap import near_cells
from hybridreg_ros.data.streets.outdoors import KINDS, make_street
from hybridreg_ros.data.streets.traffic import Accompanying
from hybridreg_ros.data.streets.vehicles import KINDS as VEHICLES
from hybridreg_ros.data.streets.vehicles import cart, make_vehicle

pytest.importorskip('embreex')


@pytest.fixture(scope='module')
def world():
    return make_street(np.random.default_rng(1), 'street', (0.1, 0.3), travel_m=20.0)


def test_every_triangle_is_described(world):
    count = len(world.scene.static.faces)
    assert world.loss.shape == world.plane.shape == (count,)
    assert np.isfinite(world.scene.static.vertices).all()
    assert world.scene.static.faces.max() < len(world.scene.static.vertices)
    assert (world.plane == 1).sum() > 1000
    assert 0.0 < (world.loss > 0).mean() < 0.3


def test_the_ground_is_rough_and_agrees_with_its_mesh(world):
    terrain = world.layout.terrain
    line = np.array([terrain.at(s, 0.0)[0] for s in np.linspace(46.0, 60.0, 57)])
    fine = line[:, 2] - np.convolve(np.pad(line[:, 2], 4, mode='edge'), np.full(9, 1 / 9), 'valid')
    assert fine.std() > 0.002
    corners = terrain.mesh(step_m=2.0, reach_m=25.0).vertices[::97]
    heights = terrain.heights(corners[:, :2].astype(np.float64))
    assert np.median(np.abs(heights - corners[:, 2])) < 0.02


def test_the_way_is_smooth_and_above_the_ground(world):
    poses = [world.path.pose_at(t) for t in np.arange(0.0, 1.0, 0.05)]
    assert all(is_rigid(T) for T in poses)
    step = np.linalg.norm(np.diff([T[:3, 3] for T in poses], axis=0), axis=1)
    assert np.allclose(step, 0.05 * world.path.ride.speed_mps, rtol=0.35, atol=0.02)
    for T in poses:
        above = T[2, 3] - world.layout.terrain.height(T[0, 3], T[1, 3])
        assert 0.2 < above < 2.6
        assert T[2, 2] > 0.95


@pytest.mark.parametrize('kind', KINDS)
def test_no_mover_stands_on_the_sensor(kind):
    world = make_street(np.random.default_rng(7), kind, (0.1, 0.3), travel_m=5.0)
    for time_s in (0.0, 1.5):
        eye = world.path.pose_at(time_s)[:3, 3]
        for mover in world.scene.movers:
            vertices = mover.mesh_at(time_s).vertices
            assert np.isfinite(vertices).all()
            assert np.linalg.norm(vertices - eye, axis=1).min() > 0.15


def test_companions_stay_in_their_window(world):
    terrain = world.layout.terrain
    way = Accompanying(terrain, 2.0, 5.0, -1.5, 45.0, 4.0, 12.0)
    for time_s in (0.0, 0.7, 3.0, 9.9):
        place, _ = way.at(1.5 * time_s)
        here, _ = terrain.centre.at(45.0 + 4.0 * time_s)
        assert np.linalg.norm(place - here) < 15.0


def test_two_streets_differ_and_one_seed_repeats():
    made = [
        make_street(np.random.default_rng(s), 'park', (0.0, 0.0), travel_m=1.0) for s in (1, 1, 2)
    ]
    assert np.array_equal(made[0].scene.static.vertices, made[1].scene.static.vertices)
    assert len(made[0].scene.static.faces) != len(made[2].scene.static.faces)
    assert made[0].scene.movers == ()


def test_bad_arguments_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ConfigError, match='kind: expected one of street'):
        make_street(rng, 'moon')
    with pytest.raises(ConfigError, match='moving_share_target: expected'):
        make_street(rng, 'street', (0.5, 0.2))
    with pytest.raises(ConfigError, match='travel_m: expected 0 to 5000'):
        make_street(rng, 'street', travel_m=-1.0)


@pytest.mark.parametrize('kind', VEHICLES)
def test_vehicles_stand_on_the_ground_and_differ(kind):
    a, b = (make_vehicle(np.random.default_rng(s), kind).vertices for s in (1, 2))
    for vertices in (a, b):
        size = np.ptp(vertices, axis=0)
        assert abs(vertices[:, 2].min()) < 0.05
        assert size[0] > size[1] > 0.8
        assert size.max() < 14.0
    assert a.shape != b.shape or np.abs(a - b).max() > 0.05


def test_unknown_vehicles_are_refused():
    with pytest.raises(ConfigError, match='kind: expected one of car'):
        make_vehicle(np.random.default_rng(0), 'ship')
    assert len(cart(np.random.default_rng(0)).faces) > 50


def test_as_much_moves_as_the_cell_asks_for(world):
    caster = Caster(world.scene)
    crowd = (0.3, 0.5)
    standing = {}
    for name, cell in {
        'rigid': Cell((0.3, 0.9), crowd=crowd, frozen=True),
        '10-30': Cell((0.3, 0.9), (0.1, 0.3), crowd),
        '30-50': Cell((0.3, 0.9), (0.3, 0.5), crowd),
    }.items():
        chosen = _with_some_moving(np.random.default_rng(3), caster, cell, (1.0, 4.0))
        standing[name] = sum(isinstance(m, Standing) for m in chosen.scene.movers)
    assert standing['rigid'] == len(world.scene.movers)
    assert 0 < standing['10-30'] < len(world.scene.movers)
    assert standing['30-50'] == 0


@pytest.mark.slow
def test_pairs_suit_their_cell_and_static_points_meet():
    cell = Cell((0.3, 0.98), (0.1, 0.3))
    samples = [s for seed in range(2) for s in street_cell(seed, cell, 2, still=True)]
    assert samples
    for sample in samples:
        pair = sample.pair
        assert 0.3 < pair.overlap < 0.98
        assert 0.1 <= pair.dynamic_share <= 0.3
        assert sample.still is not None
        assert 1500 <= len(pair.source) <= 15000
        moved = apply(pair.T_target_source, pair.source[pair.source_label == 0].astype(float))
        near = near_cells(moved, pair.target[pair.target_label == 0].astype(float), 0.3)
        assert abs(near.mean() - pair.overlap) < 0.08


@pytest.mark.slow
def test_a_frozen_pair_is_all_static_and_repeats():
    cell = Cell((0.2, 0.99), frozen=True)
    pair = next(s.pair for seed in range(4) for s in street_cell(seed, cell, 1))
    assert pair.dynamic_share == 0.0
    assert not pair.source_label.any()
    assert not pair.target_instance.any()
    again = street_cell(pair.seed, cell, 1)[0].pair
    assert np.array_equal(again.source, pair.source)
    assert np.array_equal(again.target, pair.target)
