# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Behind its sensor: less is done per scan, it is said, and poses and mask stay what they are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from neighbourhood_registrar import NeighbourhoodRegistrar
from tiny_world import lidar_rays, scans, walk

from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.load import EFFORTS, FULL, HASTY, QUICK, Load
from hybridreg_ros.odometry.result import Source

if TYPE_CHECKING:
    from hybridreg_ros.model.budget import Budget
    from hybridreg_ros.odometry.result import OdometryResult


def test_less_at_once_and_more_again_after_a_calm_while() -> None:
    load = Load()
    assert load.effort(False).level == 0
    assert [load.effort(True).level for _ in range(4)] == [1, 2, 3, 3]
    levels = [load.effort(False).level for _ in range(1000)]
    assert levels == sorted(levels, reverse=True)
    assert (levels[0], levels[-1]) == (3, 0)


def test_what_fails_again_and_again_is_tried_less_often() -> None:
    load = Load()

    def until_all() -> int:
        load.effort(True)
        return next(k for k in range(1000) if load.effort(False).level == 0)

    once, twice, thrice = until_all(), until_all(), until_all()
    assert once < twice < thrice
    for _ in range(3000):
        load.effort(False)
    assert until_all() == once


def test_each_level_does_less() -> None:
    assert HASTY.max_superpoints < QUICK.max_superpoints < FULL.max_superpoints
    assert [e.first_look for e in EFFORTS] == [QUICK, HASTY, HASTY, HASTY]
    assert [e.newest for e in EFFORTS] == [False, False, True, True]
    assert [e.update_every for e in EFFORTS] == [1, 1, 2, 3]
    assert [e.thorough for e in EFFORTS] == [True, False, False, False]


class _Counting(NeighbourhoodRegistrar):
    """A registrar that notes at which budgets a sequence was begun."""

    def __init__(self) -> None:
        super().__init__()
        self.budgets: list[Budget] = []

    def sequence(self, budget: Budget) -> _Counting:
        self.budgets.append(budget)
        return self


def test_behind_its_sensor_poses_stay_right_and_the_map_is_made_less_often() -> None:
    poses, registrar = walk(12), _Counting()
    odometry = HybridOdometry(OdometryConfig(), model=registrar)
    results: list[OdometryResult] = []
    updates = []
    for scan in scans(poses, lidar_rays()):
        result, rest = odometry.locate(scan, behind=len(results) > 2)
        results.append(rest())
        assert result.load == results[-1].load
        assert odometry._tracker is not None
        updates.append(odometry._tracker._world.map.updates)
    assert [r.load for r in results] == [0, 0, 0, 1, 2] + [3] * 7
    assert registrar.budgets == [QUICK, HASTY]
    assert {r.source for r in results[1:]} == {Source.HYBRIDREG}
    assert updates[2] == 3
    assert 4 <= updates[-1] <= 4 + 1 + 8 // 3 + sum(r.is_keyframe for r in results[3:])
    for result, pose in zip(results, poses, strict=True):
        error = np.linalg.norm((np.linalg.inv(poses[0]) @ pose)[:3, 3] - result.pose[:3, 3])
        assert error < 0.02
        assert len(result.dynamic_probability) == len(result.scan)
