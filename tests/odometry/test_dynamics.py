# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The dynamic mask as the front end publishes it: movers found, still things left alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from tiny_world import ROOM, Ball, Box, cast, depth_rays, lidar_rays, pose, walk

from hybridreg_ros.core.scan import Scan
from hybridreg_ros.odometry.config import DynamicsConfig, OdometryConfig
from hybridreg_ros.odometry.frontend import HybridOdometry

if TYPE_CHECKING:
    from hybridreg_ros.odometry.result import OdometryResult

LIDAR = lidar_rays(360, 40)
DEPTH = depth_rays(160, 120)
WALKER = Ball((2.6, -1.4, 1.2), 0.4, (-0.25, 0.6, 0.0))


def run(
    world: tuple[Box | Ball, ...], poses: list, rays: np.ndarray, period_s: float = 0.2
) -> tuple[list[OdometryResult], list[np.ndarray]]:
    odometry = HybridOdometry(model=None)
    results, labels = [], []
    for k, T in enumerate(poses):
        points, moving = cast(world, T, rays, k * period_s, seed=k)
        labels.append(moving)
        results.append(odometry.step(Scan(points, stamp=100.0 + k * period_s, frame_id='s')))
    return results, labels


@pytest.mark.parametrize('rays', [LIDAR, DEPTH], ids=['lidar', 'depth'])
def test_walker_is_found_and_the_room_is_not(rays: np.ndarray) -> None:
    poses = [pose(-2.0 + 0.02 * k, 0.0, 0.0) for k in range(20)]
    results, labels = run((*ROOM, WALKER), poses, rays)
    late = slice(10, None)
    mask = np.concatenate([r.dynamic_probability > 0.5 for r in results[late]])
    truth = np.concatenate(labels[late])
    assert truth.sum() > 200
    both = (mask & truth).sum()
    assert both / truth.sum() > 0.95
    assert both / mask.sum() > 0.95
    assert (mask & ~truth).sum() / (~truth).sum() < 0.001


@pytest.mark.parametrize('rays', [LIDAR, DEPTH], ids=['lidar', 'depth'])
def test_still_room_has_no_dynamic_points(rays: np.ndarray) -> None:
    results, _ = run(ROOM, walk(15, step_m=0.1, turn_deg=4.0), rays)
    share = np.mean(np.concatenate([r.dynamic_probability > 0.5 for r in results]))
    assert share < 0.001


def test_what_comes_into_view_is_new_and_not_dynamic() -> None:
    # The camera turns by 60 degrees: most of what it sees at the end it has never seen.
    poses = [pose(0.0, 0.0, 5.0 * k) for k in range(13)]
    results, _ = run(ROOM, poses, DEPTH)
    assert max(float(np.mean(r.dynamic_probability > 0.5)) for r in results) < 0.003


def test_a_ball_that_stops_fades_but_never_at_once() -> None:
    period_s = 0.25
    odometry = HybridOdometry(model=None)
    found = []
    for k in range(24):
        time_s = min(k, 12) * period_s
        points, moving = cast((*ROOM, WALKER), pose(-2.0, 0.0, 0.0), LIDAR, time_s, seed=k)
        result = odometry.step(Scan(points, stamp=100.0 + k * period_s, frame_id='s'))
        found.append(float(np.mean(result.dynamic_probability[moving] > 0.5)))
    assert found[12] > 0.6
    assert found[14] > 0.6  # hysteresis: it has stopped, and still counts as moving


def test_switched_off_gives_zeros() -> None:
    config = OdometryConfig(dynamics=DynamicsConfig(enabled=False))
    odometry = HybridOdometry(config, model=None)
    for k in range(6):
        points, _ = cast((*ROOM, WALKER), pose(-2.0, 0.0, 0.0), LIDAR, 0.4 * k, seed=k)
        result = odometry.step(Scan(points, stamp=100.0 + 0.4 * k))
    assert not result.dynamic_probability.any()


def test_pose_holds_while_much_of_the_view_moves() -> None:
    crowd = tuple(
        Ball((0.6 + 0.3 * k, -1.2 + 0.8 * k, 1.2), 0.45, (0.0, 0.5 - 0.3 * k, 0.0))
        for k in range(4)
    )
    poses = [pose(-2.0 + 0.03 * k, 0.0, 0.0) for k in range(15)]
    results, labels = run((*ROOM, *crowd), poses, DEPTH)
    assert np.mean(np.concatenate(labels)) > 0.15
    error = [
        np.linalg.norm(r.pose[:3, 3] - (T[:3, 3] - poses[0][:3, 3]))
        for r, T in zip(results, poses, strict=True)
    ]
    assert max(error) < 0.03
