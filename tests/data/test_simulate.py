# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated sequences: the same for the same seed, poses and labels that fit the clouds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.core.se3 import apply, exp, inverse, log
from hybridreg_ros.data.sequences.frame import LIDAR_FRAME, SimulatedFrame
from hybridreg_ros.data.sequences.simulate import CAMERA_FRAME, simulate
from hybridreg_ros.data.sequences.street import street_frames

SIZE = (48, 36)


@pytest.fixture(scope='module')
def room() -> list[SimulatedFrame]:
    return list(simulate('room', 4, 5.0, 3, size=SIZE))


@pytest.fixture(scope='module')
def street() -> list[SimulatedFrame]:
    return list(street_frames(np.arange(3) / 10.0, 10.0, 1, '10-30', columns=128))


def plane_distance(points: np.ndarray, others: np.ndarray, reach: float) -> np.ndarray:
    """Distance of those points that have a neighbour within reach to the plane there."""
    away, rows = cKDTree(others).query(points, 8)
    near = away[:, 0] < reach
    patch = others[rows[near]]
    centre = patch.mean(1)
    spread = np.einsum('nki,nkj->nij', patch - centre[:, None], patch - centre[:, None])
    normal = np.linalg.eigh(spread)[1][:, :, 0]
    return np.abs(np.einsum('ni,ni->n', points[near] - centre, normal))


def test_the_same_seed_gives_the_same_room(room: list[SimulatedFrame]) -> None:
    again = list(simulate('room', 4, 5.0, 3, size=SIZE))
    for one, two in zip(room, again, strict=True):
        assert one.points.tobytes() == two.points.tobytes()
        assert one.label.tobytes() == two.label.tobytes()
        np.testing.assert_array_equal(one.T_world_sensor, two.T_world_sensor)


def test_a_room_sequence_is_organised(room: list[SimulatedFrame]) -> None:
    assert [f.stamp_s for f in room] == pytest.approx([0.0, 0.2, 0.4, 0.6])
    for frame in room:
        assert frame.shape == (SIZE[1], SIZE[0])
        assert frame.points.shape == (SIZE[0] * SIZE[1], 3)
        assert frame.points.dtype == np.float32
        assert len(frame.label) == len(frame.instance) == len(frame.points)
        assert frame.frame_id == CAMERA_FRAME
        assert frame.times is None
        seen = np.isfinite(frame.points).all(1)
        assert seen.mean() > 0.3
        assert frame.points[seen][:, 2].min() > 0.29
        R = frame.T_world_sensor[:3, :3]
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)


def test_a_room_background_stands_still(room: list[SimulatedFrame]) -> None:
    clouds = []
    for frame in (room[0], room[-1]):
        static = np.isfinite(frame.points).all(1) & (frame.label == 0)
        clouds.append(apply(frame.T_world_sensor, frame.points[static].astype(np.float64)))
    assert np.median(plane_distance(clouds[0], clouds[1], 0.15)) < 0.02
    step = log(inverse(room[0].T_world_sensor) @ room[1].T_world_sensor)
    assert 1e-3 < np.linalg.norm(step[:3]) < 0.4


@pytest.mark.slow
def test_a_calm_room_has_no_movers() -> None:
    for frame in simulate('room', 2, 5.0, 4, dynamic='none', size=SIZE):
        assert not frame.label.any()


@pytest.mark.slow
@pytest.mark.parametrize(('dynamic', 'low', 'high'), [('10-30', 0.05, 0.4), ('30-50', 0.2, 0.65)])
def test_rooms_move_as_much_as_asked_for(dynamic: str, low: float, high: float) -> None:
    shares = []
    for seed in range(3):
        for frame in simulate('room', 4, 1.0, seed, dynamic=dynamic, size=SIZE):
            seen = np.isfinite(frame.points).all(1)
            shares.append((frame.label[seen] > 0).mean())
    assert low < np.mean(shares) < high


def test_the_same_seed_gives_the_same_street(street: list[SimulatedFrame]) -> None:
    again = next(street_frames(np.arange(3) / 10.0, 10.0, 1, '10-30', columns=128))
    assert again.points.tobytes() == street[0].points.tobytes()
    assert again.instance.tobytes() == street[0].instance.tobytes()


def test_a_street_sequence_has_times_and_labels(street: list[SimulatedFrame]) -> None:
    for frame in street:
        rings, columns = frame.shape
        assert columns == 128
        assert frame.points.shape == (rings * columns, 3)
        assert frame.frame_id == LIDAR_FRAME
        assert frame.times is not None
        assert frame.times.shape == (rings * columns,)
        assert frame.times.min() == 0.0
        assert 0.09 < frame.times.max() < 0.1
        seen = np.isfinite(frame.points).all(1)
        assert seen.mean() > 0.2
        share = (frame.label[seen] > 0).mean()
        assert 0.02 < share < 0.6
        np.testing.assert_array_equal(frame.label > 0, frame.instance > 0)


def test_a_street_background_stands_still(street: list[SimulatedFrame]) -> None:
    clouds = []
    for frame, after in ((street[0], street[1]), (street[1], street[2])):
        xi = log(inverse(frame.T_world_sensor) @ after.T_world_sensor)
        static = np.isfinite(frame.points).all(1) & (frame.label == 0)
        assert frame.times is not None
        points, times = frame.points[static].astype(np.float64), frame.times[static]
        world = np.empty_like(points)
        for t in np.unique(times):
            column = times == t
            world[column] = apply(frame.T_world_sensor @ exp(t / 0.1 * xi), points[column])
        clouds.append(world)
    assert np.median(plane_distance(clouds[0], clouds[1], 0.3)) < 0.02
    raw = street[0].T_world_sensor[:3, 3] - street[2].T_world_sensor[:3, 3]
    assert np.linalg.norm(raw) > 0.05


@pytest.mark.slow
def test_a_calm_street_has_no_movers() -> None:
    frame = next(street_frames(np.arange(2) / 10.0, 10.0, 5, 'none', columns=64))
    assert not frame.label.any()
    assert not frame.instance.any()


@pytest.mark.parametrize(
    ('wrong', 'text'),
    [
        ({'scene': 'moon'}, 'scene: expected'),
        ({'dynamic': '50-70'}, 'dynamic: expected'),
        ({'frames': 0}, 'frames: expected at least 1'),
        ({'rate_hz': 0.0}, 'rate_hz: expected'),
        ({'size': (8, 8)}, 'size: expected'),
    ],
)
def test_arguments_are_checked(wrong: dict, text: str) -> None:
    arguments = {'scene': 'room', 'frames': 2} | wrong
    with pytest.raises(ConfigError, match=text):
        simulate(**arguments)


def test_streets_are_not_endless() -> None:
    with pytest.raises(ConfigError, match='frames: expected at most 4083'):
        simulate('street', 5000)
