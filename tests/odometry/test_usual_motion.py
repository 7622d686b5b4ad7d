# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rough rides with scans left out: the motion within scans, and what of it is only the map's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_intra_scan_motion import HERE, TIMES, sweep
from test_scan_continuity import MIDDLE, clouds
from tiny_world import ROOM, cast, lidar_rays, pose

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.map.local_map import LocalMap
from hybridreg_ros.odometry.motion.intra_scan_motion import IntraScanMotion
from hybridreg_ros.odometry.motion.usual_motion import UsualMotion
from hybridreg_ros.odometry.registration.alignment import align
from hybridreg_ros.odometry.registration.scan_continuity import ScanContinuity

PITCH = 4
STEP_S = 0.2


def pitched(value: float) -> np.ndarray:
    """(6,) motion that is a pitch alone."""
    return value * np.eye(6)[PITCH]


def nodding(time_s: float) -> np.ndarray:
    """Pose of a slow sensor that pitches to and fro within each scan."""
    return pose(-3.0 + time_s, -0.5, 0.0) @ se3.exp(pitched(0.03 * np.sin(18.0 * time_s)))


def test_a_rough_walk_with_scans_left_out_unbends_its_map(monkeypatch: pytest.MonkeyPatch) -> None:
    bends, taken = [], ScanContinuity.end_at

    def watched(self: ScanContinuity, *args: Any) -> None:
        cloud, found, intra_scan, stamp = args
        at = stamp / NS_PER_S - 1.0
        first, last = (
            se3.inverse(nodding(at + s)) @ cloud.pose_at(s, found, intra_scan)
            for s in (cloud.times.min(), 0.0)
        )
        bends.append(se3.rotation_angle_deg((se3.inverse(first) @ last)[:3, :3]))
        taken(self, *args)

    monkeypatch.setattr(ScanContinuity, 'end_at', watched)
    odometry, poses = HybridOdometry(model=None), []
    for at in STEP_S * np.arange(14):
        points = sweep(lambda t, at=at: nodding(at + t))  # type: ignore[misc]
        poses.append(odometry.step(Scan(points, times=TIMES, stamp=1.0 + at)).pose)
    assert bends[0] > 1.0, 'the two scans of the first map say little of the motion within them'
    assert max(bends[-3:]) < 0.5
    steps = [
        se3.inverse(se3.inverse(nodding(STEP_S * k)) @ nodding(STEP_S * (k + 1)))
        @ se3.inverse(poses[k])
        @ poses[k + 1]
        for k in range(13)
    ]
    assert max(se3.rotation_angle_deg(step[:3, :3]) for step in steps) < 1.0


def left_of_a_bent_map(scans: int, bent: float) -> np.ndarray:
    """Rates of pitch, rad/s, by which the motion found is off, on a rough ride in a bent map.

    The map bends the motion of every scan by as much as it is bent; a scan that is straightened
    takes a quarter of that out of it.
    """
    cloud, continuity, off = replace(clouds()[0], twist=np.zeros(6)), ScanContinuity(), []
    for k in range(scans):
        at = STEP_S * k
        stamp = round(at * NS_PER_S)
        told = continuity.informed(cloud, STEP_S)
        usual = told.usual
        assert usual is not None
        off.append(bent - usual.shared[0, PITCH])
        rate, bend = 0.46 * np.cos(23.0 * at) + bent, -5.3 * np.sin(23.0 * at)
        found = IntraScanMotion(pitched(rate), pitched(bend), 1e6 * np.eye(18))
        there = se3.exp(pitched(0.02 * np.sin(23.0 * at)))
        continuity.end_at(told, there, usual.own(found), stamp)
        bent -= 0.25 * usual.shared[0, PITCH]
    return np.abs(off)


def test_what_the_map_is_bent_by_is_told_from_a_rough_ride() -> None:
    off = left_of_a_bent_map(40, 0.3)
    assert off[0] == pytest.approx(0.3)
    assert off[10:].max() < 0.15
    assert off[25:].max() < 0.06
    assert left_of_a_bent_map(40, 0.0)[10:].max() < 0.1, 'a straight map stays so'


def test_a_bend_that_is_known_is_not_taken_for_motion() -> None:
    nod = IntraScanMotion(pitched(-0.4), np.zeros(6))
    still = cast(ROOM, HERE, lidar_rays(240, 30), seed=4)[0].astype(np.float64)
    times = TIMES - MIDDLE
    local_map = LocalMap(0.15, 50.0)
    local_map.update(nod.undo(still, times), np.zeros(3))  # as if a nod had been undone
    points = sweep(lambda t: HERE, seed=3)[::20]  # the sensor stands
    rates = []
    for usual in (UsualMotion(), UsualMotion(np.array([nod.rate, nod.bend]))):
        fit = align(points, np.eye(4), local_map, times=times[::20], usual=usual)
        found = fit.intra_scan
        assert found is not None
        assert found.rate[PITCH] < -0.2, 'as the map shows it'
        assert fit.overlap > 0.9
        rates.append(usual.own(found).rate[PITCH])
    assert abs(rates[1]) < 0.1 < 0.5 * abs(rates[0])


def test_where_no_scan_is_left_out_nothing_usual_is_asked() -> None:
    cloud = clouds()[0]
    continuity = ScanContinuity()
    assert continuity.informed(cloud, 0.1) is cloud
    assert continuity.informed(cloud, 0.2).usual is not None
    assert continuity.informed(replace(cloud, times=None), 0.2).usual is None
