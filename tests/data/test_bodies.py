# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bodies: constant topology, real movement, sane size, feet on the ground, closed skins."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.data.bodies import movers
from hybridreg_ros.data.bodies.animals import SHAPES
from hybridreg_ros.data.bodies.humans import human_rig
from hybridreg_ros.data.bodies.humans_motion import LIMITS, make_motion
from hybridreg_ros.data.bodies.rig import Part, RigidMover
from hybridreg_ros.data.bodies.track import KeyFrames, Track, loop_track, straight_track
from hybridreg_ros.data.pair import Label

ORIGIN = np.zeros(3)
if TYPE_CHECKING:
    from collections.abc import Callable

    from hybridreg_ros.data.meshes.scene import Mover

MAKERS: dict[str, Callable[..., Mover]] = {
    'cloth': movers.make_cloth,
    'door': movers.make_door,
    'suitcase': movers.make_suitcase,
    'robot_arm': movers.make_robot_arm,
    'fan': movers.make_fan,
}


def displacement_m(mover, first_s, second_s):
    a, b = mover.mesh_at(first_s).vertices, mover.mesh_at(second_s).vertices
    return float(np.linalg.norm(b - a, axis=1).mean())


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize('activity', movers.HUMAN_ACTIVITIES)
def test_humans_keep_their_topology_stay_finite_and_stand_on_the_ground(activity):
    start = np.array([3.0, -2.0, 0.5])
    for seed in range(3):
        human = movers.make_human(rng(seed), start, 1.0, activity=activity)
        faces = human.mesh_at(0.0).faces
        for time_s in (0.0, 0.4, 2.7, 60.0):
            mesh = human.mesh_at(time_s)
            assert mesh.vertices.dtype == np.float32
            assert np.array_equal(mesh.faces, faces)
            assert np.isfinite(mesh.vertices).all()
            assert -0.35 < mesh.vertices[:, 2].min() - 0.5 < 0.1
            assert np.ptp(mesh.vertices, axis=0).max() < 3.2
            assert np.linalg.norm(mesh.vertices[:, :2].mean(0) - start[:2]) < 3.5


@pytest.mark.parametrize('activity', ['walk', 'run', 'turn', 'dance', 'bend', 'reach'])
def test_active_humans_move_by_more_than_a_quarter_metre_within_three_seconds(activity):
    most = []
    for seed in range(5):
        human = movers.make_human(rng(seed), ORIGIN, activity=activity)
        most.append(max(displacement_m(human, 1.0, 1.0 + d) for d in (0.3, 1.0, 2.0, 3.0)))
    assert np.mean(np.array(most) > 0.25) >= 0.8


@pytest.mark.parametrize('kind', list(SHAPES))
def test_animals_of_every_kind_walk_on_the_ground(kind):
    low, high = SHAPES[kind].shoulder_m
    animal = movers.make_animal(rng(4), ORIGIN, kind=kind, activity='trot')
    mesh = animal.mesh_at(0.7)
    assert np.array_equal(mesh.faces, animal.mesh_at(3.0).faces)
    assert 0.7 * low < np.ptp(mesh.vertices[:, 2]) < 2.6 * high
    assert -0.1 * high < mesh.vertices[:, 2].min() < 0.02
    assert displacement_m(animal, 0.0, 1.0) > 0.25


@pytest.mark.parametrize('activity', movers.ANIMAL_ACTIVITIES)
def test_every_animal_activity_is_finite(activity):
    animal = movers.make_animal(rng(1), ORIGIN, kind='dog', activity=activity)
    assert np.isfinite(animal.mesh_at(12.3).vertices).all()
    assert animal.label is Label.DEFORMING


@pytest.mark.parametrize('name', list(MAKERS))
def test_other_things_move_and_keep_their_topology(name):
    thing = MAKERS[name](rng(2), np.array([1.0, 2.0, 0.0]), 0.5)
    a, b = thing.mesh_at(0.0), thing.mesh_at(0.8)
    assert np.array_equal(a.faces, b.faces)
    assert a.faces.max() < len(a.vertices)
    assert displacement_m(thing, 0.0, 0.8) > 0.01
    rigid = name in ('door', 'suitcase')
    assert thing.label is (Label.MOVING_RIGID if rigid else Label.DEFORMING)


def test_a_rigid_mover_keeps_all_distances():
    door = movers.make_door(rng(3), ORIGIN)
    a, b = (door.mesh_at(t).vertices.astype(np.float64) for t in (0.0, 1.1))
    near = np.linalg.norm(a[:50] - a[50:100], axis=1)
    assert np.allclose(near, np.linalg.norm(b[:50] - b[50:100], axis=1), atol=1e-5)


def test_the_same_seed_gives_the_same_body_and_another_seed_another():
    one = movers.make_human(rng(5), ORIGIN).mesh_at(1.0).vertices
    assert np.array_equal(one, movers.make_human(rng(5), ORIGIN).mesh_at(1.0).vertices)
    other = movers.make_human(rng(6), ORIGIN).mesh_at(1.0).vertices
    assert one.shape != other.shape or not np.allclose(one, other, atol=0.05)


def volume_m3(part: Part) -> float:
    """Signed volume: positive only for a skin that is closed and wound outwards."""
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    return float(np.einsum('ij,ij->', a, np.cross(b, c)) / 6.0)


def test_skins_are_closed_and_face_outwards():
    skin = human_rig(rng(7), load=False).skin
    edges = np.sort(
        np.concatenate([skin.faces[:, [0, 1]], skin.faces[:, [1, 2]], skin.faces[:, [2, 0]]]),
        axis=1,
    )
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count == 2).all()
    assert 0.02 < abs(volume_m3(skin)) < 0.3


def test_coarse_people_have_far_fewer_triangles_and_the_same_size():
    fine, coarse = human_rig(rng(8)).skin, human_rig(rng(8), coarse=True).skin
    assert len(coarse.faces) < 0.45 * len(fine.faces)
    assert np.allclose(np.ptp(fine.vertices, axis=0), np.ptp(coarse.vertices, axis=0), atol=0.08)


def test_limbs_keep_within_joint_limits():
    for activity in movers.HUMAN_ACTIVITIES:
        motion = make_motion(rng(9), activity, ORIGIN, 0.0, leg_m=0.9)
        for time_s in np.linspace(0.0, 9.0, 19):
            angles = motion(float(time_s)).angles
            assert (angles >= LIMITS[..., 0] - 1e-9).all()
            assert (angles <= LIMITS[..., 1] + 1e-9).all()


def test_a_walker_follows_its_track_at_its_speed_and_the_ground():
    track = straight_track(np.array([0.0, 0.0]), 0.0)
    human = movers.make_human(
        rng(1), ORIGIN, activity='walk', track=track, speed_mps=1.5, ground=lambda x, y: 0.1 * x
    )
    a, b = human.mesh_at(0.0).vertices, human.mesh_at(4.0).vertices
    assert abs((b - a)[:, 0].mean() - 6.0) < 0.2
    assert abs(b[:, 2].min() - 0.6) < 0.15


def test_unknown_activities_and_kinds_are_refused_in_one_line():
    with pytest.raises(ConfigError, match='activity: expected one of walk'):
        movers.make_human(rng(), ORIGIN, activity='fly')
    with pytest.raises(ConfigError, match='kind: expected one of dog'):
        movers.make_animal(rng(), ORIGIN, kind='dragon')
    with pytest.raises(ConfigError, match="found 'fly'"):
        movers.make_animal(rng(), ORIGIN, activity='fly')


def test_tracks_measure_their_length_and_go_on():
    square = Track(np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), closed=True)
    assert square.length_m == pytest.approx(4.0)
    assert np.allclose(square.at(4.5)[0], square.at(0.5)[0])
    line = straight_track(np.zeros(2), 0.5 * np.pi, 2.0)
    assert np.allclose(line.at(5.0)[0], [0.0, 5.0])
    assert np.allclose(line.at(-1.0)[0], [0.0, -1.0])


def test_loops_start_where_and_as_asked_and_stay_near():
    loop = loop_track(rng(3), np.array([2.0, 1.0]), 0.7, reach_m=1.5)
    place, heading = loop.at(0.0)
    assert np.allclose(place, [2.0, 1.0])
    assert np.cos(heading - 0.7) > 0.98
    assert np.linalg.norm(loop.points - [2.0, 1.0], axis=1).max() < 3.0 * np.sqrt(2)


def test_key_frames_pass_through_their_keys():
    keys = KeyFrames(np.array([[0.0], [1.0], [5.0]]), 0.5)
    assert [float(keys.at(t)[0]) for t in (0.0, 0.5, 1.0, 1.5)] == [0.0, 1.0, 5.0, 0.0]
    assert float(keys.at(0.25)[0]) == pytest.approx(0.5)


def test_rigid_movers_are_movers():
    mover = movers.make_suitcase(rng(1), ORIGIN)
    assert isinstance(mover, RigidMover)
