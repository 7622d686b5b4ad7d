# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Floors and walls behind things: found in spite of what stands before them, and never movers."""

from __future__ import annotations

import numpy as np
import pytest
from test_rings import TRUNKS, ring_scan
from tiny_world import Box, cast, lidar_rays, pose

from hybridreg_ros.core.scan import Scan
from hybridreg_ros.odometry.dynamics.background import lies_on_background, lies_on_plane
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.map.local_map import VoxelLevel

SENSOR = np.array([0.0, 0.0, 1.5])
SLACK_M = 0.08


def sheet(step_m: float, noise_m: float = 0.01) -> np.ndarray:
    """Points (N, 3), metres, of a floor of 4 m by 4 m around the origin, with noise."""
    rng = np.random.default_rng(7)
    flat = np.stack(np.meshgrid(*[np.arange(-2.0, 2.0, step_m)] * 2), -1).reshape(-1, 2)
    return np.c_[flat, rng.normal(0.0, noise_m, len(flat))]


def legs() -> np.ndarray:
    """Points (N, 3), metres, of two legs that stand at (1, 0), up to 0.8 m high."""
    height = np.arange(0.05, 0.8, 0.05)
    at = [[1.0, y] for y in (-0.15, 0.15)]
    return np.concatenate([np.c_[np.tile(p, (len(height), 1)), height] for p in at])


def crowd() -> np.ndarray:
    """Points (N, 3), metres, of six legs within half a metre of (1, 0), up to 0.8 m high."""
    height = np.arange(0.05, 0.8, 0.05)
    at = np.random.default_rng(3).uniform([0.5, -0.5], [1.5, 0.5], (6, 2))
    return np.concatenate([np.c_[np.tile(p, (len(height), 1)), height] for p in at])


def stored(*parts: np.ndarray) -> VoxelLevel:
    """A level with cubes of 1 m that holds these points."""
    level = VoxelLevel(1.0, 20)
    points = np.concatenate(parts)
    level.add(points, np.ones(len(points)), SENSOR, 0.0)
    return level


def test_floor_around_legs_is_floor_though_the_legs_are_in_the_map() -> None:
    level = stored(sheet(0.1), legs())
    near = sheet(0.07)
    near = near[np.hypot(near[:, 0] - 1.0, near[:, 1]) < 0.5]
    assert lies_on_background(near, SENSOR, level, SLACK_M).all()
    assert lies_on_plane(near, level, 1, SLACK_M).mean() > 0.95  # its fit leaves two legs out too
    among = stored(sheet(0.1), crowd())
    assert lies_on_background(near, SENSOR, among, SLACK_M).all()
    assert lies_on_plane(near, among, 1, SLACK_M).mean() < 0.7  # what a crowd spoils without it
    high = legs()[legs()[:, 2] > SLACK_M + 0.05]
    assert not lies_on_background(high, SENSOR, level, SLACK_M).any()


def test_only_what_is_level_is_ground() -> None:
    wall = sheet(0.1)[:, [2, 0, 1]] + [3.0, 0.0, 1.5]
    level = stored(wall)
    inner = wall[(np.abs(wall[:, 1:] - [0.0, 1.5]) < 1.0).all(axis=1)]
    assert lies_on_background(inner, SENSOR, level, SLACK_M).all()
    assert not lies_on_background(inner, SENSOR, level, SLACK_M, up=np.array([0.0, 0, 1])).any()
    assert lies_on_background(inner, SENSOR, level, SLACK_M, up=np.array([1.0, 0, 0])).all()


@pytest.mark.parametrize('points', [np.zeros((0, 3)), np.full((3, 3), 50.0)])
def test_where_nothing_is_stored_nothing_lies_on_anything(points: np.ndarray) -> None:
    on = lies_on_background(points, SENSOR, stored(sheet(0.1)), SLACK_M)
    assert on.shape == (len(points),)
    assert not on.any()


@pytest.mark.parametrize(
    ('start', 'step', 'radius'),
    [((4.0, -1.5), (-0.1, 0.12), 0.25), ((3.0, -1.0), (-0.03, 0.05), 0.3)],
    ids=['walker', 'stroller'],
)
def test_ground_around_a_walker_is_not_called_moving_by_few_rings(
    start: tuple[float, float], step: tuple[float, float], radius: float
) -> None:
    height_m = 0.6  # a low robot, whose rings pass the ground close to the legs
    odometry = HybridOdometry(model=None)
    false = true = 0
    for k in range(25):
        walker = np.array([start[0] + k * step[0], start[1] + k * step[1], radius])
        points = ring_scan(0.02 * k, k, np.vstack([TRUNKS, walker]), height_m)
        result = odometry.step(Scan(points, stamp=k * 100_000_000))
        off = np.hypot(*(points[:, :2] - walker[:2] + [0.02 * k, 0.0]).T) - radius
        called = result.dynamic_probability > 0.5
        if k >= 8:
            true += int((called & (off < 0.1) & (points[:, 2] > 0.1 - height_m)).sum())
            false += int((called & (off > 0.2)).sum())
    assert true > 5000
    assert false < 0.01 * true


def test_ground_that_a_bent_scan_raises_does_not_move() -> None:
    yard = (
        Box((-30.0, -30.0, 0.0), (30.0, 30.0, 12.0), inside=True),
        Box((6.0, 4.0, 0.0), (9.0, 8.0, 3.0)),
        Box((-9.0, -8.0, 0.0), (-6.0, -5.0, 4.0)),
        Box((4.0, -9.0, 0.0), (7.0, -7.0, 2.5)),
    )
    odometry, rays = HybridOdometry(model=None), lidar_rays(720, 64)
    for k in range(20):
        points, _ = cast(yard, pose(0.1 * k, 0.0, 0.0), rays, 0.1 * k, seed=k)
        quarter = (points[:, 1] < 0.0) & (points[:, 0] > 0.0)
        if k >= 10:  # from here on a nod of a degree at the end of each turn is not found
            points[quarter, 2] += 0.02 * np.linalg.norm(points[quarter], axis=1)
        result = odometry.step(Scan(points, stamp=100.0 + 0.1 * k))
        assert np.mean(result.dynamic_probability[quarter] > 0.5) < 0.02
