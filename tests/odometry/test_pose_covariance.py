# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The covariance of a pose fits its errors, and grows with the way."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tiny_world import lidar_rays, scans, walk

from hybridreg_ros.benchmark.suite_data import load
from hybridreg_ros.benchmark.suite_list import chosen
from hybridreg_ros.core import se3
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.registration import covariance
from hybridreg_ros.odometry.registration.covariance import Surroundings

if TYPE_CHECKING:
    from pathlib import Path


def test_position_errors_in_a_moving_room_are_as_large_as_is_said(tmp_path: Path) -> None:
    (sequence,) = chosen('dev', ['dev-room-502'], frames=16)
    frames = load(sequence, tmp_path, tmp_path)
    odometry, start = HybridOdometry(), se3.inverse(frames[0].T_world_sensor)
    squared = []
    for frame in frames:
        result = odometry.step(frame.scan)
        off = (result.pose - start @ frame.T_world_sensor)[:3, 3]
        squared.append(off @ np.linalg.solve(result.covariance[:3, :3], off))
    assert 0.2 < np.median(squared[1:]) < 6.0  # 2.4 of many errors; these share the first scan's


def test_it_grows_with_the_way_and_not_with_the_time() -> None:
    way = walk(24, step_m=0.3)
    way += [way[-1]] * 8
    odometry = HybridOdometry(model=None)
    results = [odometry.step(scan) for scan in scans(way, lidar_rays())]
    spread = [np.sqrt(np.trace(r.covariance[:3, :3])) for r in results]
    assert spread[0] < 1e-5 < spread[1]
    assert spread[23] > 1.8 * spread[1]
    assert spread[-1] < 1.1 * spread[23]
    twist = [np.trace(r.twist_covariance[:3, :3]) for r in results[1:]]
    assert twist[-1] < 3.0 * np.median(twist[:4])  # errors that two poses share are in none


def test_a_turn_moves_what_is_far() -> None:
    spread = np.diag([1e-4, 4e-4, 9e-4, 0.0, 0.0, 1e-4])
    there = se3.transform(np.eye(3), np.array([10.0, 0.0, 0.0]))
    carried = Surroundings(spread).carried(np.eye(4), there, np.zeros(6)).random
    np.testing.assert_allclose(np.diag(carried), [1e-4, 4e-4 + 1e-2, 9e-4, 0.0, 0.0, 1e-4])
    assert carried[1, 5] == pytest.approx(1e-3)


def test_a_drift_grows_with_the_way_and_not_with_its_root() -> None:
    way = [se3.transform(np.eye(3), np.array([5.0 * k, 0.0, 0.0])) for k in range(9)]
    known, spread = Surroundings(np.zeros((6, 6))), []
    for here, there in pairwise(way):
        known = known.carried(here, there, covariance.DRIFT['lidar'])
        spread.append(np.sqrt(np.diag(known.covariance)))
    along, across, turn = np.array(spread)[:, [0, 1, 5]].T
    np.testing.assert_allclose(along, along[0] * np.arange(1, 9))
    np.testing.assert_allclose(turn, turn[0] * np.arange(1, 9))
    swept = 5.0 * turn[:7].sum()  # each turn carries all that comes after
    assert across[7] == pytest.approx(np.hypot(along[7], swept))


@pytest.mark.parametrize(('twist', 'speed'), [(None, 5.0), (np.array([2.0, 0, 0, 0, 0, 0]), 2.5)])
def test_what_nothing_holds_adds_up(twist: np.ndarray | None, speed: float) -> None:
    free = np.zeros((6, 6))
    free[0, 0] = 1.0
    steps = [covariance.along(free, twist, 0.1 * k, 0.1 * (k + 1)) for k in range(10)]
    expected = np.zeros((6, 6))
    expected[0, 0] = speed**2
    np.testing.assert_allclose(np.sum(steps, axis=0), expected, atol=1e-12)
