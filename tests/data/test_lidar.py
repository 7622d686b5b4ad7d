# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The spinning lidar against planes and spheres, its noise, its motion, its movers."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.core.se3 import apply, exp, inverse, transform
from hybridreg_ros.data.bodies.rig import RigidMover
from hybridreg_ros.data.meshes.raycast import Caster
from hybridreg_ros.data.meshes.scene import Mesh, Scene
from hybridreg_ros.data.meshes.shapes import box, superquadric
from hybridreg_ros.data.pair import Label
from hybridreg_ros.data.sensors.lidar import make_lidar, random_lidar
from hybridreg_ros.data.sensors.lidar_tables import TABLES

pytest.importorskip('embreex')

NOTHING = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))


def standing(T: np.ndarray, time_s: float) -> np.ndarray:
    return T


FLOOR = box((200.0, 200.0, 1.0), (0.0, 0.0, -2.0))


def clean(model='even16', columns=180, **changes):
    perfect = {
        'noise_m': 0.0,
        'ring_bias_m': 0.0,
        'dropout': 0.0,
        'edge_mix': 0.0,
        'reach_m': 1e6,
        'quantum_m': 1e-4,
    }
    return replace(make_lidar(model, columns=columns), **{**perfect, **changes})


def still(time_s):
    return np.eye(4)


def test_ranges_on_a_plane_are_exact():
    scan = clean().scan(Caster(Scene(FLOOR)), 0.0, still, np.random.default_rng(0))
    down = clean().elevation_deg < -2.0
    expected = 1.5 / np.sin(np.deg2rad(-clean().elevation_deg[down]))
    ranges = np.linalg.norm(scan.points[down], axis=-1)
    near = expected < 95.0
    assert np.allclose(ranges[near], expected[near, None], rtol=1e-4)
    up = clean().elevation_deg > 0.0
    assert np.isnan(scan.points[up]).all()


def test_ranges_inside_a_ball_are_its_radius():
    ball = superquadric((10.0, 10.0, 10.0), 1.0, 1.0, 60, 80)
    scan = clean('wide64', 128).scan(Caster(Scene(ball)), 0.0, still, np.random.default_rng(0))
    ranges = np.linalg.norm(scan.points, axis=-1)
    assert np.nanmax(np.abs(ranges - 10.0)) < 0.05
    assert np.isfinite(ranges).all()


def test_noise_has_the_size_it_says():
    lidar = clean(noise_m=0.03)
    ball = superquadric((8.0, 8.0, 8.0), 1.0, 1.0, 60, 80)
    scan = lidar.scan(Caster(Scene(ball)), 0.0, still, np.random.default_rng(1))
    error = np.linalg.norm(scan.points, axis=-1) - np.linalg.norm(scan.true, axis=-1)
    assert 0.027 < error.std() < 0.035


def test_a_moving_lidar_is_skewed_and_deskewing_restores_the_room():
    room = box((30.0, 20.0, 8.0))
    twist = np.array([10.0, 1.0, 0.0, 0.0, 0.0, 1.2])

    def pose_at(time_s):
        return exp(twist * time_s)

    start = 0.3
    scan = clean(columns=360).scan(Caster(Scene(room)), start, pose_at, np.random.default_rng(0))
    walls = np.array([15.0, 10.0, 4.0])

    def off_wall(points):
        return np.abs(np.abs(apply(pose_at(start), points)) - walls).min(axis=-1)

    def flat(points):
        points = points.reshape(-1, 3)
        return points[np.isfinite(points).all(axis=1)].astype(np.float64)

    assert np.median(off_wall(flat(scan.points))) > 0.02
    assert off_wall(flat(scan.deskewed())).max() < 2e-3
    assert np.allclose(flat(scan.deskewed()), flat(scan.true), atol=2e-3)
    assert scan.times[0] == 0.0
    assert 0.09 < scan.times[-1] < 0.1
    last = inverse(pose_at(start)) @ pose_at(start + scan.times[-1])
    assert np.allclose(scan.T_start_column[-1], last, atol=1e-5)


def test_movers_are_seen_where_they_are_at_the_time_of_their_column():
    target = box((1.0, 1.0, 4.0))

    def sliding(time_s):
        return transform(np.eye(3), np.array([-10.0 + 20.0 * time_s, 0.0, 0.0]))

    scene = Scene(FLOOR, (RigidMover(target, sliding),))
    scan = clean('wide64', 720).scan(Caster(scene), 0.0, still, np.random.default_rng(0))
    hit = scan.instance == 1
    assert (scan.label[hit] == Label.MOVING_RIGID).all()
    assert hit.sum() > 100
    # Half a turn after the start the sensor looks along -x, and the box has moved 1 m.
    face = scan.points[hit][:, 0].max()
    assert face == pytest.approx(-10.0 + 20.0 * 0.05 + 0.5, abs=0.1)
    frozen = clean('wide64', 720).scan(
        Caster(scene), 0.0, still, np.random.default_rng(0), frozen_s=0.2
    )
    assert frozen.points[frozen.instance == 1][:, 0].max() == pytest.approx(-5.5, abs=0.05)


def test_many_small_movers_equal_one_cast_of_all():
    movers = []
    for k in range(12):
        place = transform(np.eye(3), np.array([5 * np.cos(k), 5 * np.sin(k), 0.0]))
        movers.append(RigidMover(box((0.5, 0.5, 2.0)), partial(standing, place)))
    scene = Scene(FLOOR, tuple(movers))
    scan = clean('wide64', 256).scan(Caster(scene), 0.0, still, np.random.default_rng(0))
    rays = clean('wide64', 256).directions().reshape(-1, 3)
    hits = Caster(scene).cast(0.0, np.zeros(3, np.float32), rays)
    assert np.array_equal(scan.instance.ravel(), hits.instance)
    seen = np.isfinite(scan.points[..., 0]).ravel()
    ranges = np.linalg.norm(scan.points.reshape(-1, 3), axis=1)
    assert np.allclose(ranges[seen], hits.distance[seen], atol=1e-3)


def test_dark_far_surfaces_and_glass_are_lost():
    caster = Caster(Scene(FLOOR))
    rng = np.random.default_rng(0)
    share = [
        np.isfinite(clean(reach_m=r).scan(caster, 0.0, still, rng).points).mean()
        for r in (5.0, 50.0, 1e6)
    ]
    assert share[0] < share[1] < share[2]
    glass = np.ones(len(FLOOR.faces), np.float32)
    assert np.isnan(clean().scan(caster, 0.0, still, rng, loss=glass).points).all()


@pytest.mark.parametrize('model', list(TABLES))
def test_beam_tables_fall_from_top_to_bottom(model):
    lidar = make_lidar(model)
    assert len(lidar.elevation_deg) == int(''.join(c for c in model if c.isdigit()))
    assert (np.diff(lidar.elevation_deg) < 0.0).all()
    assert lidar.directions().shape == (len(lidar.elevation_deg), lidar.columns, 3)
    assert np.allclose(np.linalg.norm(lidar.directions(), axis=-1), 1.0, atol=1e-5)


def test_scans_of_one_seed_are_identical():
    lidar = random_lidar(np.random.default_rng(3), columns=90)
    caster = Caster(Scene(FLOOR))
    a, b = (lidar.scan(caster, 0.0, still, np.random.default_rng(5)).points for _ in range(2))
    assert np.array_equal(a, b, equal_nan=True)


def test_unknown_models_are_refused():
    with pytest.raises(ConfigError, match='model: expected one of even16'):
        make_lidar('sonar')
    with pytest.raises(ConfigError, match='columns: expected at least 16, found 3'):
        make_lidar('even16', columns=3)
