# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The view is covered and comes back: what stood before the camera is no evidence."""

from __future__ import annotations

import numpy as np
from tiny_world import ROOM, Ball, Box, cast, depth_rays, pose, walk

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import Scan
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.keyframes import Keyframe
from hybridreg_ros.odometry.preprocess import preprocess, recognise_sensor
from hybridreg_ros.odometry.result import OdometryResult, Reason, Source
from hybridreg_ros.odometry.visibility.sightings import Sightings

RAYS = depth_rays(160, 120)
COVERED, BLIND = (6, 7), (8, 9)


def covered_walk() -> tuple[list[OdometryResult], list[np.ndarray]]:
    """A walk in which a ball fills the view for two scans, then nothing is seen in two."""
    poses = walk(14, step_m=0.04, turn_deg=1.0)
    odometry, results = HybridOdometry(OdometryConfig(), model=None), []
    for k, T in enumerate(poses):
        world: tuple[Box | Ball, ...] = ROOM
        if k in COVERED:
            ahead = T[:3, 3] + 0.9 * T[:3, 0]
            x, y, z = ahead - 0.1 * k * np.array([0.0, 0.1, 0.0])
            world = (*ROOM, Ball((x, y, z), 0.42, (0.0, 0.1, 0.0)))
        points = cast(world, T, RAYS, 0.1 * k, seed=k)[0]
        points = points[:20] if k in BLIND else points
        results.append(odometry.step(Scan(points, stamp=10.0 + 0.1 * k, frame_id='s')))
    return results, poses


def test_a_covered_view_does_not_lose_the_pose() -> None:
    results, poses = covered_walk()
    assert {results[k].reason for k in BLIND} == {Reason.TOO_FEW_POINTS}
    for k in range(BLIND[-1] + 1, len(poses)):
        assert results[k].source is not Source.LOST
        assert results[k].confidence > 0.7
        off = se3.inverse(se3.inverse(poses[0]) @ poses[k]) @ results[k].pose
        assert np.linalg.norm(off[:3, 3]) < 0.03
        assert se3.rotation_angle_deg(off[:3, :3]) < 0.5


def test_movers_are_not_drawn_and_keyframes_speak_for_what_they_hid() -> None:
    here = pose(-1.0, -0.5, 0.0)
    empty, _ = cast(ROOM, here, RAYS)
    world = (*ROOM, Ball((0.0, -0.5, 1.2), 0.42, (1.0, 0.0, 0.0)))
    full, moving = cast(world, here, RAYS, seed=1)
    config = OdometryConfig()
    sensor = recognise_sensor(empty, config)

    def drawn(sightings: Sightings, points: np.ndarray, still: np.ndarray | None) -> None:
        scan = Scan(points, stamp=1.0, frame_id='s')
        cloud = preprocess(scan, sensor, config.preprocess, np.zeros(6))
        image = sightings.draw(cloud, here)
        image = image if still is None else image.only(still)
        keyframe = Keyframe(0, scan.stamp, here, cloud.map_points)
        sightings.keep(image, () if still is not None else [keyframe])

    known, fooled = Sightings(sensor), Sightings(sensor)
    for sightings, still in ((known, ~moving), (fooled, np.ones(len(full), np.bool_))):
        drawn(sightings, empty, None)
        drawn(sightings, full, still)
    found = known.evidence(empty, here, 1.0)
    assert found.seen > 0.95
    assert found.consistent > 0.95
    assert fooled.evidence(empty, here, 1.0).consistent > 0.95  # the keyframe saw behind it
    fresh = Sightings(sensor)
    drawn(fresh, full, np.ones(len(full), np.bool_))
    assert fresh.evidence(empty, here, 1.0).consistent < 0.9
    in_front = known.evidence(full, here, 1.0)
    assert abs(in_front.before - moving.mean()) < 0.05
    fresh.clear()
    assert fresh.evidence(empty, here, 1.0).seen == 0.0
