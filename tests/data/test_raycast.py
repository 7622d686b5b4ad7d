# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rays against planes and balls whose distance is known by formula."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from hybridreg_ros.core.errors import DependencyError
from hybridreg_ros.data.meshes.geometry import moved
from hybridreg_ros.data.meshes.raycast import CLOCK, Caster
from hybridreg_ros.data.meshes.scene import Mesh, Scene, Standing, merge
from hybridreg_ros.data.meshes.shapes import box, superquadric
from hybridreg_ros.data.pair import Label


class Slider:
    """A box of 0.2 m that moves along x by one metre a second, at z = 1."""

    label = Label.MOVING_RIGID

    def __init__(self) -> None:
        self.calls = 0

    def mesh_at(self, time_s: float) -> Mesh:
        self.calls += 1
        return moved(box([0.2, 0.2, 0.2]), [time_s, 0.0, 1.0])


class Sideways(Slider):
    """The same along y."""

    def mesh_at(self, time_s: float) -> Mesh:
        return moved(box([0.2, 0.2, 0.2]), [0.0, time_s, 1.0])


def wall(z: float, half: float = 50.0) -> Mesh:
    corners = [[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]]
    return Mesh(np.array(corners, np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def fan(rng: np.random.Generator, count: int = 500) -> np.ndarray:
    d = np.column_stack([rng.uniform(-0.8, 0.8, (count, 2)), np.ones(count)])
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


def test_plane_distance_and_normal_are_exact(rng: np.random.Generator) -> None:
    d = fan(rng)
    hits = Caster(Scene(wall(3.0))).cast(0.0, np.zeros(3, np.float32), d)
    np.testing.assert_allclose(hits.distance, 3.0 / d[:, 2], rtol=1e-5)
    np.testing.assert_allclose(hits.normal, np.tile([0.0, 0.0, -1.0], (len(d), 1)), atol=1e-6)
    assert not hits.label.any()
    assert not hits.instance.any()


def test_ball_distance_follows_the_formula(rng: np.random.Generator) -> None:
    ball = moved(superquadric([1.0, 1.0, 1.0], 1.0, 1.0, 61, 120), [0.0, 0.0, 4.0])
    d = fan(rng)
    hits = Caster(Scene(ball)).cast(0.0, np.zeros(3, np.float32), d)
    along = 4.0 * d[:, 2]
    inside = 1.0 - (16.0 - along**2)
    true = along - np.sqrt(np.maximum(inside, 0.0))
    well_hit = inside > 0.05
    np.testing.assert_allclose(hits.distance[well_hit], true[well_hit], atol=4e-3)
    assert np.isinf(hits.distance[inside < -0.01]).all()
    assert not hits.normal[inside < -0.01].any()


def test_the_nearer_of_background_and_mover_is_seen() -> None:
    slider = Slider()
    caster = Caster(Scene(wall(3.0), (slider,)))
    d = np.array([[0.0, 0.0, 1.0]], np.float32)
    now, later = (caster.cast(t, np.zeros(3, np.float32), d) for t in (0.0, 0.5))
    assert now.distance[0] == pytest.approx(0.9)
    assert (now.instance[0], now.label[0]) == (1, Label.MOVING_RIGID)
    assert later.distance[0] == pytest.approx(3.0)
    assert (later.instance[0], later.label[0]) == (0, Label.STATIC)
    bare = caster.trace(0.0, np.zeros(3, np.float32), d, movers=False)
    assert bare.distance[0] == pytest.approx(3.0)


def test_each_mover_has_its_own_instance() -> None:
    left = Slider()

    class Right(Slider):
        label = Label.DEFORMING

        def mesh_at(self, time_s: float) -> Mesh:
            return moved(super().mesh_at(time_s), [-0.5, 0.0, 0.0])

    d = np.array([[0.0, 0.0, 1.0], [-0.5, 0.0, 1.0]])
    d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
    hits = Caster(Scene(wall(3.0), (left, Right()))).cast(0.0, np.zeros(3, np.float32), d)
    assert hits.instance.tolist() == [1, 2]
    assert hits.label.tolist() == [Label.MOVING_RIGID, Label.DEFORMING]


def test_the_triangle_of_a_hit_belongs_to_the_static_mesh() -> None:
    scene = Scene(merge([wall(5.0), moved(wall(2.0, 0.1), [1.0, 0.0, 0.0])]), (Slider(),))
    d = np.array([[0.0, 0.0, 1.0], [0.45, 0.0, 0.9], [0.0, 0.9, 1.0], [0.0, 0.0, -1.0]])
    d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
    face = Caster(scene).trace(0.0, np.zeros(3, np.float32), d).face
    assert face[0] == -1, 'a mover has no static triangle'
    assert face[1] in (2, 3)
    assert face[2] in (0, 1)
    assert face[3] == -1


def test_movers_are_posed_once_per_time() -> None:
    slider = Slider()
    caster = Caster(Scene(wall(3.0), (slider,)))
    d = np.array([[0.0, 0.0, 1.0]], np.float32)
    for time_s in (0.0, 0.5, 0.0, 0.5):
        caster.cast(time_s, np.zeros(3, np.float32), d)
    assert slider.calls == 2
    assert CLOCK.seconds > 0.0
    assert CLOCK.rays > 0


def test_an_empty_scene_gives_misses() -> None:
    none = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    hits = Caster(Scene(none)).cast(0.0, np.zeros(3, np.float32), np.eye(3, dtype=np.float32))
    assert np.isinf(hits.distance).all()


def test_missing_embree_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'embreex.mesh_construction', None)
    with pytest.raises(DependencyError, match='needs embreex'):
        Caster(Scene(wall(1.0)))


def test_what_is_halted_stands_and_belongs_to_the_background() -> None:
    scene = Scene(wall(3.0), (Slider(), Sideways()))
    caster = Caster(scene).halted(np.array([False, True]), 0.5)
    assert isinstance(caster.scene.movers[0], Standing)
    assert caster.scene.movers[1] is scene.movers[1]
    # At 0.8 s the first still stands at x = 0.5, the second has got to y = 0.8.
    d = np.array([[0.5, 0.0, 0.9], [0.8, 0.0, 0.9], [0.0, 0.8, 0.9], [0.0, 0.5, 0.9]])
    d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
    trace = caster.trace(0.8, np.zeros(3, np.float32), d)
    assert trace.instance.tolist() == [1, 0, 2, 0]
    assert caster.labels(trace.instance).tolist() == [0, 0, int(Label.MOVING_RIGID), 0]
    whole = Caster(scene).trace(0.8, np.zeros(3, np.float32), d)
    assert whole.instance.tolist() == [0, 1, 2, 0], 'the scene itself is as before'
