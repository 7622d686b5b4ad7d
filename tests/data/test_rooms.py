# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rooms: same seed same room, furniture inside the walls, figures apart from everything."""

from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.data.meshes.geometry import bounds
from hybridreg_ros.data.meshes.raycast import Caster
from hybridreg_ros.data.pair import Label
from hybridreg_ros.data.rooms.clutter import Boxes
from hybridreg_ros.data.rooms.floor import FloorGrid, inside, random_plan
from hybridreg_ros.data.rooms.furnished import background, make_room
from hybridreg_ros.data.rooms.motion import set_stage

KINDS = ('room', 'corridor', 'office', 'hall')


@pytest.mark.parametrize('kind', KINDS)
def test_the_same_seed_gives_the_same_room(kind: str) -> None:
    one, two, other = (make_room(np.random.default_rng(s), kind) for s in (3, 3, 4))
    a, b, c = (background(r.parts, r.movable) for r in (one, two, other))
    np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
    np.testing.assert_array_equal(a.mesh.faces, b.mesh.faces)
    assert a.mesh.vertices.shape != c.mesh.vertices.shape


@pytest.mark.parametrize('kind', KINDS)
def test_everything_is_finite_and_numbered(kind: str) -> None:
    room = make_room(np.random.default_rng(11), kind)
    ground = background(room.parts, room.movable)
    assert np.isfinite(ground.mesh.vertices).all()
    assert ground.mesh.faces.max() < len(ground.mesh.vertices)
    assert len(ground.plane) == len(ground.loss) == len(ground.mesh.faces)
    assert ground.plane.max() >= len(room.plan.outline) + 1, 'walls, floor and ceiling are planes'
    assert ground.loss.min() >= 0.0
    assert ground.loss.max() <= 1.0


def test_rooms_differ_in_size_height_and_content() -> None:
    rooms = [make_room(np.random.default_rng(s)) for s in range(6)]
    assert len({r.plan.height_m for r in rooms}) == 6
    assert len({len(r.parts) + len(r.movable) for r in rooms}) > 3
    assert all(len(r.focus) >= 3 for r in rooms)


def test_movable_things_stand_inside_the_walls() -> None:
    for seed in range(3):
        room = make_room(np.random.default_rng(seed), 'room')
        places = np.array([m.at[:2] for m in room.movable])
        assert inside(room.plan.outline, places).mean() > 0.95


def test_pieces_of_furniture_do_not_share_floor() -> None:
    room = make_room(np.random.default_rng(5), 'room')
    grid = FloorGrid(room.plan.outline)
    spot = room.floor.clear_spots(0.3)[0]
    low, high = np.array([-0.2, -0.2]), np.array([0.2, 0.2])
    assert grid.fits(low, high, spot)
    grid.take(low, high, spot, 0.3, 0.8)
    assert not grid.fits(low, high, spot + 0.1)
    assert grid.top_at(spot) == pytest.approx(0.8)
    assert np.isinf(grid.top_at(room.plan.outline.max(0) + 5.0))


def test_inside_is_the_even_odd_rule() -> None:
    corner = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float)
    points = np.array([[0.5, 0.5], [1.5, 1.5], [0.5, 1.5], [1.5, 0.5], [-0.1, 0.5]])
    assert inside(corner, points).tolist() == [True, False, True, True, False]


def test_outlines_are_counter_clockwise() -> None:
    for seed in range(20):
        x, y = random_plan(np.random.default_rng(seed)).outline.T
        assert x @ np.roll(y, -1) - y @ np.roll(x, -1) > 0.0


def test_a_stage_has_the_figures_asked_for() -> None:
    rng = np.random.default_rng(21)
    stage = set_stage(rng, make_room(rng, 'office'), people=2, animals=1, flying=5, shifted=2)
    movers = stage.scene.movers
    kinds = [m.label for m in movers]
    assert kinds[:3] == [Label.DEFORMING] * 3
    assert kinds[3:] == [Label.MOVING_RIGID] * (len(movers) - 3)
    assert len(movers) >= 8
    start = [m.mesh_at(0.0) for m in movers]
    later = [m.mesh_at(1.3) for m in movers]
    for a, b in zip(start, later, strict=True):
        np.testing.assert_array_equal(a.faces, b.faces)
        assert np.abs(a.vertices - b.vertices).max() > 1e-4, 'every mover moves'
    middle = np.array([m.vertices[:, :2].mean(0) for m in start[:3]])
    apart = np.linalg.norm(middle[:, None] - middle[None], axis=2)[np.triu_indices(3, 1)]
    assert apart.min() > 0.35
    for mesh in start[:2]:
        low, high = bounds(mesh)
        assert -0.1 < low[2] < 0.25
        assert 0.8 < high[2] < 2.5


def test_shifted_furniture_leaves_the_background() -> None:
    rng = np.random.default_rng(22)
    room = make_room(rng, 'room')
    everything = background(room.parts, room.movable)
    stage = set_stage(rng, room, people=0, shifted=3)
    moving = sum(len(m.mesh_at(0.0).faces) for m in stage.scene.movers)
    assert len(stage.scene.movers) == 3
    assert len(stage.background.mesh.faces) + moving == len(everything.mesh.faces)


def test_the_same_seed_gives_the_same_motion() -> None:
    meshes = []
    for _ in range(2):
        rng = np.random.default_rng(23)
        stage = set_stage(rng, make_room(rng, 'room'), people=1, flying=2, shifted=1)
        meshes.append([m.mesh_at(2.5).vertices for m in stage.scene.movers])
    for a, b in zip(*meshes, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_camera_inside_sees_walls_all_around() -> None:
    rng = np.random.default_rng(24)
    room = make_room(rng, 'room')
    ground = background(room.parts, room.movable)
    stage = set_stage(rng, room, people=0)
    angle = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    d = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(200)]).astype(np.float32)
    spot = room.floor.clear_spots(0.2)[0]
    eye = np.array([*spot, 1.4], np.float32)
    trace = Caster(stage.scene).trace(0.0, eye, d)
    assert np.isfinite(trace.distance).mean() > 0.95
    assert trace.distance[np.isfinite(trace.distance)].max() < 15.0
    assert len(ground.mesh.faces) == len(stage.background.mesh.faces)


def test_boxes_know_what_is_free() -> None:
    boxes = Boxes()
    boxes.add_ball(np.array([0.0, 0.0, 1.0]), 0.5)
    assert not boxes.free(np.array([0.3, 0.0, 1.0]), 0.1)
    assert boxes.free(np.array([1.0, 0.0, 1.0]), 0.3)
