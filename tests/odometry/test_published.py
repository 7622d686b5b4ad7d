# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Losses, switches and recoveries on recordings made for them, read from the written results."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tiny_world import ROOM, Ball, Box, lidar_rays, pose, scans, walk

from hybridreg_ros.cli.main import main
from hybridreg_ros.core import se3
from hybridreg_ros.core.pointcloud2 import from_arrays
from hybridreg_ros.core.scan import Scan
from hybridreg_ros.replay.bag_writer import BagWriter
from hybridreg_ros.replay.recording import RecordedFrame, write_recording

if TYPE_CHECKING:
    from pathlib import Path

RAYS = lidar_rays()
STEP_NS = 100_000_000


@dataclass(frozen=True)
class Published:
    """What a replay wrote."""

    rows: list[dict[str, Any]]
    poses: np.ndarray
    metrics: dict[str, Any]

    def said(self, key: str) -> list[Any]:
        return [r[key] for r in self.rows]


def published(folder: Path, clouds: list[Scan], truth: list[np.ndarray]) -> Published:
    """Write a bag, replay it through the command, read the files back."""
    bag = folder / 'world.mcap'
    with BagWriter(bag) as writer:
        write_recording(
            (
                RecordedFrame(scan.stamp, 'sensor', from_arrays(scan.points), T)
                for scan, T in zip(clouds, truth, strict=True)
            ),
            writer,
        )
    out = folder / 'out'
    arguments = ['replay', str(bag), '--registrar', 'kiss-icp', '--no-clouds', '--out', str(out)]
    assert main(arguments) == 0
    metrics = json.loads((out / 'metrics.json').read_text())
    poses = np.loadtxt(out / 'odometry.tum')
    return Published(metrics['per_frame'], poses[:, 1:4], metrics)


def places(truth: list[np.ndarray]) -> np.ndarray:
    start = se3.inverse(truth[0])
    return np.array([(start @ T)[:3, 3] for T in truth])


def test_dropped_frames_are_bridged(tmp_path: Path) -> None:
    truth = walk(16)
    clouds = scans(truth, RAYS)
    kept = [k for k in range(16) if k not in {6, 7, 8, 9}]
    found = published(tmp_path, [clouds[k] for k in kept], [truth[k] for k in kept])
    assert found.metrics['sources'] == {'kiss_icp': 11}
    assert min(found.said('confidence')) > 0.9
    off = np.linalg.norm(found.poses - places([truth[k] for k in kept]), axis=1)
    assert off.max() < 0.03


def test_covered_sensor_is_lost_and_found_again(tmp_path: Path) -> None:
    truth = walk(5)
    truth += [truth[-1]] * 8
    clouds = scans(truth, RAYS)
    hand = np.random.default_rng(0).normal([0.6, 0.0, 0.0], 0.1, (4000, 3)).astype(np.float32)
    for k in range(5, 9):
        clouds[k] = Scan(hand, stamp=clouds[k].stamp, frame_id='sensor')
    found = published(tmp_path, clouds, truth)
    assert found.said('confidence')[5:9] == [0.0] * 4
    assert found.said('source')[8] == 'lost'
    assert found.said('reason')[9] == 'recovered'
    assert found.said('source')[9:] == ['kiss_icp'] * 4
    off = np.linalg.norm(found.poses[9:] - places(truth)[9:], axis=1)
    assert off.max() < 0.05


def test_everything_moving_is_never_believed(tmp_path: Path) -> None:
    truth = walk(4) + [walk(4)[-1]] * 5
    clouds = scans(truth, RAYS)
    rng = np.random.default_rng(3)
    for k in range(4, 9):
        rays = rng.normal(size=(5000, 3))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        points = (rays * rng.uniform(1.0, 8.0, (5000, 1))).astype(np.float32)
        clouds[k] = Scan(points, stamp=clouds[k].stamp, frame_id='sensor')
    found = published(tmp_path, clouds, truth)
    assert max(found.said('confidence')[4:]) == 0.0
    assert found.said('source')[-1] == 'lost'
    jumps = np.linalg.norm(np.diff(found.poses, axis=0), axis=1)
    assert jumps.max() < 0.15


def test_teleport_is_lost_then_a_new_map_is_announced(tmp_path: Path) -> None:
    hall = (
        Box((-49.0, 20.0, 0.0), (-30.0, 45.0, 6.0), inside=True),
        Box((-38.0, 34.0, 0.0), (-35.0, 36.0, 4.0)),
        Box((-46.0, 26.0, 0.0), (-44.0, 33.0, 2.0)),
        Ball((-36.0, 26.0, 2.0), 1.5),
    )
    here = walk(5)
    there = [pose(-40.0 + 0.05 * k, 30.0, 10.0) for k in range(20)]
    clouds = scans(here, RAYS) + scans(there, RAYS, world=hall, start_s=100.5, period_s=1.0)
    found = published(tmp_path, clouds, here + there)
    assert found.said('confidence')[5] == 0.0
    assert 'lost' in found.said('source')[5:9]
    again = found.said('reason').index('recovered')
    assert found.said('confidence')[again] == 0.0
    assert min(found.said('confidence')[again + 2 :]) > 0.9
    jumps = np.linalg.norm(np.diff(found.poses, axis=0), axis=1)
    assert jumps.max() < 1.0  # one second at the velocity before


@pytest.mark.slow
def test_memory_does_not_grow_over_a_looped_sequence() -> None:
    """2,000 frames round a loop of 40 poses: after the first rounds nothing may grow."""
    from hybridreg_ros.core.pages import resident_mb
    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.odometry.frontend import HybridOdometry

    way = walk(20)
    clouds = scans(way + way[::-1], lidar_rays(120, 16), world=ROOM)
    odometry = HybridOdometry(OdometryConfig(registrar='kiss-icp'), model=None)
    before = 0.0
    for k in range(2000):
        scan = clouds[k % len(clouds)]
        odometry.step(Scan(scan.points, stamp=10**9 + k * STEP_NS, frame_id='sensor'))
        if k == 400:
            before = resident_mb()
    assert resident_mb() - before < 10.0
