# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What a sensor may get wrong: the front end never fails and never pretends."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tiny_world import ROOM, depth_rays, lidar_rays, pose, scans, walk

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.odometry.config import LostConfig, OdometryConfig, PreprocessConfig
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.result import LOST_VARIANCE, OdometryResult, Reason, Source
from hybridreg_ros.odometry.selection.fallback import Fallback

if TYPE_CHECKING:
    from hybridreg_ros.odometry.registration.alignment import Fit

RAYS = lidar_rays()


def run(clouds: list[Scan], config: OdometryConfig | None = None) -> list[OdometryResult]:
    odometry = HybridOdometry(config, model=None)
    return [odometry.step(scan) for scan in clouds]


def moved(scan: Scan, seconds: float) -> Scan:
    return replace(scan, stamp=scan.stamp + round(seconds * NS_PER_S))


def with_points(scan: Scan, points: np.ndarray) -> Scan:
    return Scan(points, stamp=scan.stamp, frame_id=scan.frame_id)


def jumps(results: list[OdometryResult]) -> float:
    """Largest distance between neighbouring poses, metres."""
    places = np.array([r.pose[:3, 3] for r in results])
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).max())


def is_lost(result: OdometryResult) -> bool:
    """Whether a result says LOST in all the ways it must."""
    return (
        result.source is Source.LOST
        and result.confidence == 0.0
        and np.array_equal(np.diag(result.covariance), np.full(6, LOST_VARIANCE))
    )


@pytest.mark.parametrize('count', [0, 1, 5])
def test_clouds_of_few_points_before_any_other_are_lost(count: int) -> None:
    cloud = Scan(np.ones((count, 3), np.float32), stamp=1.0)
    result = run([cloud])[0]
    assert is_lost(result)
    assert result.reason is Reason.TOO_FEW_POINTS
    assert result.dynamic_probability.shape == (count,)


def test_empty_cloud_on_the_way_is_coasted_over() -> None:
    clouds = scans(walk(8), RAYS)
    clouds[5] = with_points(clouds[5], np.zeros((0, 3), np.float32))
    results = run(clouds)
    assert results[5].reason is Reason.TOO_FEW_POINTS
    assert results[5].confidence == 0.0
    assert results[5].covariance[0, 0] > 4.0 * results[4].covariance[0, 0]
    assert results[6].confidence > 0.9
    assert jumps(results) < 0.12


def test_covered_sensor_is_lost_and_recovers_where_it_is() -> None:
    poses = walk(5)
    clouds = scans(poses + [poses[-1]] * 8, RAYS)
    hand = np.random.default_rng(0).normal([0.6, 0.0, 0.0], 0.1, (4000, 3)).astype(np.float32)
    for k in range(5, 9):
        clouds[k] = with_points(clouds[k], hand)
    results = run(clouds)
    assert all(r.confidence == 0.0 for r in results[5:9])
    assert is_lost(results[8])
    assert results[9].reason is Reason.RECOVERED
    assert results[9].source is Source.KISS_ICP
    assert np.linalg.norm(results[9].pose[:3, 3] - results[4].pose[:3, 3]) < 0.05
    assert results[-1].confidence > 0.9


def with_crowd(scan: Scan, seed: int, share: float = 0.5) -> Scan:
    """The scan with something rough close in front of one side of the view."""
    rng = np.random.default_rng(seed)
    points = scan.points.copy()
    bearing = points[:, 1] / points[:, 0]
    hidden = bearing < np.quantile(bearing, share)
    points[hidden] *= rng.uniform(0.5, 0.6, (hidden.sum(), 1))
    return with_points(scan, points)


@pytest.mark.parametrize('share', [0.3, 0.5, 0.7])
def test_a_crowd_that_comes_at_once_is_doubted_but_not_lost(share: float) -> None:
    poses, faster = walk(6), walk(7, step_m=0.1)
    poses += [poses[-1] @ se3.inverse(faster[0]) @ T for T in faster[1:]]
    clouds = scans(poses, depth_rays())
    clouds[6:] = [with_crowd(scan, k, share) for k, scan in enumerate(clouds[6:])]
    results = run(clouds)
    assert results[6].confidence < 0.3
    assert results[6].reason is Reason.LOW_CONFIDENCE
    assert min(r.confidence for r in results[7:]) > 0.9
    start = se3.inverse(poses[0])
    for k in range(6, len(poses)):  # one that coasts is 2 cm off after the first step
        off = se3.inverse(start @ poses[k]) @ results[k].pose
        assert np.linalg.norm(off[:3, 3]) < 0.005
    lost = run(clouds[:7], OdometryConfig(lost=LostConfig(after_bad_frames=1)))
    assert is_lost(lost[-1])


def test_a_walk_that_turns_back_at_once_is_not_taken_for_one_that_goes_on() -> None:
    """The scans stand better elsewhere than where the motion so far leads."""
    way = walk(20)
    results = run(scans([*way, *way[::-1], *way], lidar_rays(120, 16), world=ROOM))
    assert sum(is_lost(r) for r in results) <= 1  # 14 when poses that nothing holds may win
    assert sum(r.reason is Reason.DEGENERATE for r in results) <= 2
    start = se3.inverse(way[0])
    assert np.linalg.norm((se3.inverse(start @ way[-1]) @ results[-1].pose)[:3, 3]) < 0.1


def test_a_tentative_pose_changes_neither_the_map_nor_the_past() -> None:
    poses = walk(7)
    clouds = scans(poses, depth_rays())
    odometry = HybridOdometry(model=None)
    for scan in clouds[:6]:
        odometry.step(scan)
    assert odometry._tracker is not None
    world = odometry._tracker._world
    before, last = world.map.updates, world.sightings._last
    past = world.dynamics._past.looks(0)
    doubted = odometry.step(with_crowd(clouds[6], 6))
    assert doubted.reason is Reason.LOW_CONFIDENCE
    assert not is_lost(doubted)
    assert world.map.updates == before
    assert world.dynamics._past.looks(0) == past
    assert world.sightings._last is not last


def test_other_ways_than_close_to_the_prediction_are_tried_only_in_doubt(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reaches: list[float] = []
    follow = Fallback._follow

    def counted(self: Fallback, scan: Any, guess: Any, reach_m: float, basin: Any) -> Fit:
        reaches.append(reach_m)
        return follow(self, scan, guess, reach_m, basin)

    monkeypatch.setattr(Fallback, '_follow', counted)
    clouds = scans(walk(7), depth_rays())
    odometry = HybridOdometry(model=None)
    for scan in clouds[:5]:
        odometry.step(scan)
    reaches.clear()
    odometry.step(clouds[5])
    assert len(reaches) == 1
    assert 0.0 < reaches[0] < 0.1  # metres: the walk is even
    reaches.clear()
    odometry.step(with_crowd(clouds[6], 6))
    assert len(reaches) == 5
    assert 0.0 < reaches[0] < 0.1 < min(reaches[1:])


def test_teleport_is_lost_then_starts_a_new_map_and_says_so() -> None:
    other = [pose(-40.0 + 0.05 * k, 30.0, 10.0) for k in range(14)]
    far = scans(other, RAYS, world=_hall(), start_s=100.5)
    config = OdometryConfig(lost=LostConfig(after_bad_frames=2, reanchor_after_s=0.25))
    results = run(scans(walk(5), RAYS) + far, config)
    reasons = [r.reason for r in results]
    assert results[5].confidence == 0.0
    assert is_lost(results[6])
    again = reasons.index(Reason.RECOVERED)
    assert np.diag(results[again].covariance).min() == LOST_VARIANCE
    for result in results[again + 1 :]:  # how far the sensor went unseen stays unknown
        assert 0.1**2 < result.covariance[:3, :3].max() < LOST_VARIANCE
    assert [r.adrift for r in results] == [k >= again for k in range(len(results))]
    assert results[-1].confidence > 0.9
    assert results[-1].source is Source.KISS_ICP
    assert jumps(results) < 0.3


def _hall() -> tuple:
    from tiny_world import Ball, Box

    return (
        Box((-49.0, 20.0, 0.0), (-30.0, 45.0, 6.0), inside=True),
        Box((-38.0, 34.0, 0.0), (-35.0, 36.0, 4.0)),
        Box((-46.0, 26.0, 0.0), (-44.0, 33.0, 2.0)),
        Ball((-36.0, 26.0, 2.0), 1.5),
    )


@pytest.mark.parametrize(
    ('seconds', 'reason'),
    [
        (-0.1, Reason.STAMP_REPEATED),
        (-0.25, Reason.STAMP_BACKWARDS),
        (3600.0, Reason.STAMP_JUMP),
        (-3600.0, Reason.STAMP_BACKWARDS),
    ],
)
def test_odd_stamp_is_refused_and_counted(seconds: float, reason: Reason) -> None:
    clouds = scans(walk(8), RAYS)
    clouds[5] = moved(clouds[5], seconds)
    odometry = HybridOdometry(model=None)
    results = [odometry.step(scan) for scan in clouds]
    assert [r.accepted for r in results] == [True] * 5 + [False] + [True] * 2
    assert results[5].reason is reason
    assert np.array_equal(results[5].pose, results[4].pose)
    assert odometry.refused == {reason: 1}
    assert results[7].confidence > 0.9


@pytest.mark.parametrize('seconds', [3600.0, -3600.0])
def test_new_time_base_is_taken_after_a_few_scans(seconds: float) -> None:
    clouds = scans(walk(12, step_m=0.03, turn_deg=1.0), RAYS)
    clouds = clouds[:5] + [moved(scan, seconds) for scan in clouds[5:]]
    results = run(clouds)
    assert [r.accepted for r in results[5:]] == [False] * 2 + [True] * 5
    assert results[-1].confidence > 0.9
    assert jumps(results) < 0.15


def test_other_frame_is_refused_until_reset() -> None:
    clouds = scans(walk(6), RAYS)
    clouds[3:] = [replace(scan, frame_id='other') for scan in clouds[3:]]
    odometry = HybridOdometry(model=None)
    results = [odometry.step(scan) for scan in clouds]
    assert [r.reason for r in results[3:]] == [Reason.FRAME_CHANGED] * 3
    assert not any(r.accepted for r in results[3:])
    odometry.reset()
    assert odometry.step(moved(clouds[5], 0.1)).reason is Reason.FIRST_SCAN


def test_absurd_coordinates_change_nothing() -> None:
    clouds = scans(walk(5), RAYS)
    clean = run(clouds)
    wild = np.array([[1e9, 0, 0], [-1e9, 1e9, 1e9], [0, 0, -1e9], [3e38, 0, 0]], np.float32)
    dirty = [with_points(s, np.concatenate([s.points, wild])) for s in clouds]
    results = run(dirty)
    np.testing.assert_allclose(results[-1].pose, clean[-1].pose, atol=0.005)
    assert (results[-1].dynamic_probability[-4:] == 0.0).all()


def test_only_absurd_coordinates_are_too_few_points() -> None:
    cloud = Scan(np.full((1000, 3), 1e9, np.float32), stamp=1.0)
    assert is_lost(run([cloud])[0])


def test_what_the_sensor_cannot_see_is_left_out() -> None:
    """By the sensor's own limit (a lidar's 0.5 m) from the first scan on, or by the setting."""
    cloud = scans(walk(1), RAYS)[0]
    near = np.array([[0.1, 0, 0], [0, 0.3, 0.3], [0, 0, 0]], np.float32)
    dirty = with_points(cloud, np.concatenate([near, cloud.points]))
    odometry = HybridOdometry(model=None)
    for _ in range(2):
        seen = odometry.seen(dirty)
        np.testing.assert_array_equal(seen.points, cloud.points)
        assert seen.near == 3
        np.testing.assert_array_equal(seen.rows, np.arange(3, 3 + len(cloud)))
        odometry.step(seen)
    config = OdometryConfig(preprocess=PreprocessConfig(min_range_m=0.2))
    assert HybridOdometry(config, model=None).seen(dirty).near == 2
    empty = with_points(cloud, np.zeros((0, 3), np.float32))
    assert odometry.seen(empty) is empty


def test_millimetres_are_said(caplog: pytest.LogCaptureFixture) -> None:
    cloud = scans(walk(1), RAYS)[0]
    assert is_lost(run([with_points(cloud, 1000.0 * cloud.points)])[0])
    assert 'this looks like millimetres; divide the coordinates by 1000' in caplog.text


@pytest.mark.parametrize('times', ['equal', 'nan', 'far'])
def test_bad_point_times_are_not_used(times: str) -> None:
    clouds = scans(walk(5), RAYS)
    bad = {'equal': 0.05, 'nan': np.nan, 'far': 1e6}[times]
    timed = [
        replace(s, times=np.where(np.arange(len(s)) % 2, bad, bad if times == 'equal' else 0.0))
        for s in clouds
    ]
    results = run(timed)
    assert not any(r.deskewed for r in results)
    np.testing.assert_allclose(results[-1].pose, run(clouds)[-1].pose, atol=1e-9)


def test_line_and_plane_give_finite_results() -> None:
    flat = np.random.default_rng(1).uniform(-3, 3, (4000, 3)).astype(np.float32)
    line, plane = flat.copy(), flat.copy()
    line[:, 1:] = 0.0
    plane[:, 2] = -1.0
    for points in (line, plane):
        clouds = [Scan(points, stamp=100.0 + 0.1 * k) for k in range(4)]
        results = run(clouds)
        assert all(np.isfinite(r.pose).all() for r in results)
        assert all(np.isfinite(r.covariance).all() for r in results)


def test_many_points_take_bounded_time() -> None:
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(1_500_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = (directions * rng.uniform(4.0, 4.1, (len(directions), 1))).astype(np.float32)
    results = run([Scan(points, stamp=100.0), Scan(points, stamp=100.1)])
    assert results[1].dynamic_probability.shape == (len(points),)
    assert results[1].timings_s['total'] < 10.0
