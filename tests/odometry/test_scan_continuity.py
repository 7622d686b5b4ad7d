# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A scan begins where the last one ended: what that says, and what it keeps from happening."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest
from test_intra_scan_motion import HERE, TIMES, sweep
from tiny_world import ROOM, cast, lidar_rays, pose

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.map.local_map import LocalMap
from hybridreg_ros.odometry.motion.intra_scan_motion import NO_INTRA_SCAN_MOTION, IntraScanMotion
from hybridreg_ros.odometry.motion.prediction import Expected, Start
from hybridreg_ros.odometry.preprocess import preprocess, recognise_sensor
from hybridreg_ros.odometry.registration import covariance
from hybridreg_ros.odometry.registration.alignment import align
from hybridreg_ros.odometry.registration.scan_continuity import ScanContinuity

if TYPE_CHECKING:
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan

EXPECTED = Expected(HERE, 0.05, 0.02, 0.1)
TWIST = np.array([2.0, 0.1, 0.0, 0.05, 0.3, -0.2])
MIDDLE = 0.05


def standing(T: np.ndarray, time_s: float) -> np.ndarray:
    return T


def clouds() -> list[PreprocessedScan]:
    """Two scans of 0.1 s, one after the other, of a sensor that moves evenly, deskewed."""
    points = cast(ROOM, HERE, lidar_rays(240, 30), seed=1)[0]
    config = OdometryConfig()
    sensor = recognise_sensor(points, config)
    scans = [Scan(points, times=TIMES, stamp=1.0 + 0.1 * k, frame_id='s') for k in range(2)]
    return [preprocess(scan, sensor, config.preprocess, TWIST) for scan in scans]


def stamp_of(cloud: PreprocessedScan, k: int) -> int:
    """Instant of the k-th cloud, ns."""
    return NS_PER_S + k * NS_PER_S // 10 + round(cloud.instant_s * NS_PER_S)


def followed(count: int, k: int = 1, late_s: float = 0.0) -> Expected:
    """What is expected of the k-th scan after so many were registered, all at the same place."""
    first, second = clouds()
    left = ScanContinuity()
    for earlier in range(count):
        left.end_at(first, HERE, None, stamp_of(first, earlier - count + 1))
    return left.expect(EXPECTED, second, stamp_of(second, k) + round(late_s * NS_PER_S))


def test_an_even_motion_begins_where_the_last_scan_ended() -> None:
    first, second = clouds()
    there, left = HERE @ se3.exp(0.1 * TWIST), ScanContinuity()
    left.end_at(first, HERE, None, stamp_of(first, 0))
    told = left.expect(EXPECTED, second, stamp_of(second, 1))
    assert told.start is not None
    _, pull = told.start.pull(there, NO_INTRA_SCAN_MOTION)
    np.testing.assert_allclose(pull, 0.0, atol=1e-4)
    twice = told.widened(2.0, 3.0)
    assert twice.start is not None
    assert twice.start.shift_m == 2.0 * told.start.shift_m
    assert twice.start.turn_rad == 3.0 * told.start.turn_rad


def test_an_end_of_long_ago_or_of_nothing_says_nothing() -> None:
    first, second = clouds()
    assert followed(3).start is not None
    assert followed(3, k=2).start is None, 'a scan was dropped'
    assert followed(3, k=-3).start is None
    assert followed(0).start is None
    left = ScanContinuity()
    left.end_at(replace(first, times=None), HERE, None, stamp_of(first, 0))
    assert left.expect(EXPECTED, second, stamp_of(second, 1)).start is None
    left.end_at(first, HERE, None, stamp_of(first, 0))
    left.end()
    assert left.expect(EXPECTED, second, stamp_of(second, 1)).start is None


def test_the_spread_shrinks_from_end_to_end_and_grows_with_the_gap() -> None:
    starts = [followed(count).start for count in (1, 3, 20)]
    shifts = [start.shift_m for start in starts if start is not None]
    assert len(shifts) == 3
    assert shifts[0] > 1.5 * shifts[1] > 1.5 * shifts[2]
    assert shifts[2] == pytest.approx(0.01, rel=0.02)
    far = followed(20, late_s=0.04).start
    assert far is not None
    assert far.shift_m == pytest.approx(0.01 + 0.4**2 * EXPECTED.shift_m, rel=0.05)
    first, second = clouds()
    left = ScanContinuity()
    for _ in range(20):
        left.end_at(first, HERE, None, stamp_of(first, 0))
    left.forget()
    left.end_at(first, HERE, None, stamp_of(first, 0))
    anew = left.expect(EXPECTED, second, stamp_of(second, 1)).start
    assert anew is not None
    assert anew.shift_m == pytest.approx(shifts[0])


def test_what_a_start_adds_is_the_gradient_of_its_cost() -> None:
    rng = np.random.default_rng(2)
    start = Start(-0.05, HERE @ se3.exp(rng.normal(0.0, 0.01, 6)), 0.02, 0.01)
    intra_scan = IntraScanMotion(rng.normal(0.0, 0.1, 6), rng.normal(0.0, 1.0, 6))
    weight = np.repeat([0.02**-2, 0.01**-2], 3)

    def cost(step: np.ndarray) -> float:
        T = HERE @ se3.transform(se3.so3_exp(step[3:6]), step[:3])
        moved = IntraScanMotion(intra_scan.rate + step[6:12], intra_scan.bend + step[12:])
        off = se3.log(se3.inverse(start.pose) @ T @ moved.at(start.second))
        return 0.5 * float(weight @ off**2)

    information, gradient = start.pull(HERE, intra_scan)
    steps = 1e-6 * np.eye(18)
    numeric = np.array([(cost(s) - cost(-s)) / 2e-6 for s in steps])
    np.testing.assert_allclose(gradient, numeric, atol=0.05 * np.abs(numeric).max())
    np.testing.assert_allclose(information, information.T)
    assert np.linalg.eigvalsh(information)[0] > -1e-6 * np.linalg.eigvalsh(information)[-1]


def test_a_nod_that_scan_and_map_share_is_not_taken_for_motion() -> None:
    nod = IntraScanMotion(np.array([0.0, 0.0, 0.0, 0.0, -0.4, 0.0]), np.zeros(6))
    still = cast(ROOM, HERE, lidar_rays(240, 30), seed=4)[0].astype(np.float64)
    times = TIMES - MIDDLE
    local_map = LocalMap(0.15, 50.0)
    local_map.update(nod.undo(still, times), np.zeros(3))  # as if a nod had been undone
    points = sweep(lambda t: HERE, seed=3)[::20]  # the sensor stands
    expected = Expected(np.eye(4), 0.02, 0.005, 0.1, np.full(3, 0.3))
    begun = replace(expected, start=Start(-MIDDLE, np.eye(4), 0.0015, np.deg2rad(0.03)))
    found = [
        align(points, np.eye(4), local_map, times=times[::20], prior=prior).intra_scan
        for prior in (expected, begun)
    ]
    assert found[0] is not None
    assert found[1] is not None
    assert found[0].rate[4] < -0.2, 'no registration sees it'
    assert abs(found[1].rate[4]) < 0.7 * abs(found[0].rate[4])


def test_the_reported_pose_is_less_sure_the_farther_it_is_carried() -> None:
    still = cast(ROOM, HERE, lidar_rays(480, 60), seed=4)[0].astype(np.float64)
    local_map = LocalMap(0.15, 50.0)
    local_map.update(still, np.zeros(3))
    points = sweep(lambda t: HERE, seed=3)
    fit = align(points, np.eye(4), local_map, times=TIMES - MIDDLE)
    spreads = [covariance.of_fit(fit, s, 1.0) for s in (0.0, -0.02, -0.05)]
    sizes = [covariance.weakest_m(spread) for spread in spreads]
    assert sizes[0] < sizes[1] < sizes[2]
    turns = [np.linalg.eigvalsh(spread[3:, 3:])[-1] for spread in spreads]
    assert turns[0] < turns[1] < turns[2]
    assert all(np.linalg.eigvalsh(spread)[0] > 0.0 for spread in spreads)
    np.testing.assert_allclose(covariance.of_fit(fit, -0.05, 3.0), 3.0 * spreads[2], rtol=1e-6)


def test_a_scan_without_points_is_not_continued(monkeypatch: pytest.MonkeyPatch) -> None:
    told = []
    real = ScanContinuity.expect

    def watched(self: ScanContinuity, *args: object) -> Expected:
        told.append(real(self, *args))  # type: ignore[arg-type]
        return told[-1]

    monkeypatch.setattr(ScanContinuity, 'expect', watched)
    odometry = HybridOdometry(OdometryConfig(), model=None)
    for k in range(6):
        T = pose(-1.0 + 0.1 * k, -0.5, 0.0)
        points = sweep(partial(standing, T), seed=k) if k != 4 else np.zeros((0, 3), np.float32)
        times = TIMES[: len(points)]
        odometry.step(Scan(points, times=times, stamp=1.0 + 0.1 * k, frame_id='s'))
    assert [one.start is not None for one in told] == [False, True, True, False]
