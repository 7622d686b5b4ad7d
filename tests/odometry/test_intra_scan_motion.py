# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Uneven motion during a scan: found with the pose, undone in the cloud and in the first map."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from tiny_world import ROOM, cast, lidar_rays, pose

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import Scan
from hybridreg_ros.odometry.config import OdometryConfig, PreprocessConfig
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.map.local_map import LocalMap
from hybridreg_ros.odometry.motion.intra_scan_motion import IntraScanMotion
from hybridreg_ros.odometry.registration.alignment import align
from hybridreg_ros.odometry.result import Reason, Source

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest

COLUMNS = 240
RAYS = lidar_rays(COLUMNS, 30)
TIMES = np.tile(np.arange(COLUMNS) / (10.0 * COLUMNS), 30)
HERE = pose(-1.0, -0.5, 0.0)


def sweep(path: Callable[[float], np.ndarray], seed: int = 0) -> np.ndarray:
    """Points (N, 3) of one turn, each seen from where the sensor was at its time."""
    points = np.zeros((len(RAYS), 3), np.float32)
    column = np.arange(len(RAYS)) % COLUMNS
    for first in range(0, COLUMNS, 8):
        some = (column >= first) & (column < first + 8)
        points[some] = cast(ROOM, path(float(TIMES[some].mean())), RAYS[some], seed=seed)[0]
    return points


def test_intra_scan_motion_carries_points_as_the_exponential_does() -> None:
    rng = np.random.default_rng(1)
    intra_scan = IntraScanMotion(rng.normal(0.0, 0.5, 6), rng.normal(0.0, 5.0, 6))
    points, times = rng.normal(0.0, 10.0, (50, 3)), rng.uniform(-0.05, 0.05, 50)
    expected = [
        se3.apply(intra_scan.at(s), p[None])[0] for p, s in zip(points, times, strict=True)
    ]
    np.testing.assert_allclose(intra_scan.undo(points, times), expected, atol=1e-9)


def test_refinement_finds_the_motion_during_the_scan() -> None:
    middle = 0.05
    rate = np.array([0.1, -0.05, 0.05, 0.1, 0.4, -0.2])
    bend = np.array([0.0, 0.0, 0.5, 0.0, 4.0, 0.0])
    truth = IntraScanMotion(rate, bend)
    points = sweep(lambda t: HERE @ truth.at(t - middle), seed=3)[::2]
    times = TIMES[::2] - middle
    still = cast(ROOM, HERE, lidar_rays(480, 60), seed=4)[0]
    local_map = LocalMap(0.15, 50.0)
    local_map.update(still.astype(np.float64), np.zeros(3))
    rigid = align(points, np.eye(4), local_map)
    found = align(points, np.eye(4), local_map, times=times)
    assert found.intra_scan is not None
    assert rigid.intra_scan is None
    turn_deg = se3.rotation_angle_deg(found.T_odom_sensor[:3, :3])
    assert turn_deg < 0.05
    assert turn_deg < 0.3 * se3.rotation_angle_deg(rigid.T_odom_sensor[:3, :3])
    assert np.trace(found.information) > 2.0 * np.trace(rigid.information)
    for s in (-middle, middle):
        off = se3.inverse(truth.at(s)) @ found.intra_scan.at(s)
        assert se3.rotation_angle_deg(off[:3, :3]) < 0.15
        assert np.linalg.norm(off[:3, 3]) < 0.01


def ride(k: int, t: float) -> np.ndarray:
    """Pose of a sensor that drives fast and pitches to and fro faster than scans follow."""
    time_s = 0.1 * k + t
    return pose(-3.5 + 4.0 * time_s, -0.5, 0.0) @ se3.exp(
        np.array([0.0, 0.0, 0.0, 0.0, 0.03 * np.sin(18.0 * time_s), 0.0])
    )


def worst_step(scans: list[Scan], config: OdometryConfig) -> tuple[float, float]:
    """Largest error of the steps of a rough ride, degrees and metres."""
    odometry = HybridOdometry(config, model=None)
    found = [odometry.step(scan) for scan in scans]
    turn, shift = [], []
    for k in range(1, len(scans)):
        step = se3.inverse(found[k - 1].pose) @ found[k].pose
        off = se3.inverse(se3.inverse(ride(k - 1, 0.0)) @ ride(k, 0.0)) @ step
        turn.append(se3.rotation_angle_deg(off[:3, :3]))
        shift.append(float(np.linalg.norm(off[:3, 3])))
    return max(turn), max(shift)


def test_a_rough_ride_keeps_its_poses_from_the_first_step_on() -> None:
    scans = [Scan(sweep(partial(ride, k), k), times=TIMES, stamp=1.0 + 0.1 * k) for k in range(8)]
    turn_deg, shift_m = worst_step(scans, OdometryConfig())
    assert turn_deg < 0.6
    assert shift_m < 0.06
    even = worst_step(scans, OdometryConfig(preprocess=PreprocessConfig(intra_scan=False)))
    assert turn_deg < 0.6 * even[0]


def test_the_first_map_is_made_again_with_the_angular_acceleration() -> None:
    def nodding(t: float) -> np.ndarray:
        turn = np.array([0.0, 0.0, 0.0, 0.0, 0.2 * t + 2.0 * t * t, 0.0])
        return pose(-1.5 + 4.0 * t, -0.5, 0.0) @ se3.exp(turn)

    odometry = HybridOdometry(OdometryConfig(), model=None)
    for k in range(2):
        points = sweep(lambda t, k=k: nodding(0.1 * k + t), k)  # type: ignore[misc]
        odometry.step(Scan(points, times=TIMES, stamp=1.0 + 0.1 * k))
    assert odometry._tracker is not None
    first = odometry._tracker._world.keyframes.last
    assert first is not None
    middle = se3.inverse(nodding(0.0)) @ nodding(float(TIMES.mean()))
    off = se3.inverse(middle) @ first.T_odom_keyframe
    assert se3.rotation_angle_deg(off[:3, :3]) < 0.3


def test_a_velocity_that_proves_wrong_leaves_the_first_map_as_it_was(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    odometry = HybridOdometry(OdometryConfig(), model=None)
    scans = [Scan(sweep(partial(ride, k), k), times=TIMES, stamp=1.0 + 0.1 * k) for k in range(3)]
    odometry.step(scans[0])
    tracker = odometry._tracker
    assert tracker is not None
    before = tracker._world.map.fine.points()
    real, calls = tracker._locator.locate, []

    def once(*args: Any) -> Any:
        calls.append(tracker._world.map.fine.points())
        return real(*args) if len(calls) == 1 else Reason.NO_OVERLAP

    monkeypatch.setattr(tracker._locator, 'locate', once)
    second = odometry.step(scans[1])
    assert len(calls) == 2
    assert not np.array_equal(calls[1], before), 'the map was made anew with the velocity'
    assert second.source is not Source.LOST
    assert second.confidence > 0.5
    stored = {tuple(p) for p in tracker._world.map.fine.points().round(3)}
    assert len(stored & {tuple(p) for p in before.round(3)}) > 0.3 * len(before)
    monkeypatch.undo()
    assert odometry.step(scans[2]).confidence > 0.5
