# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Reported confidence knows where else a pose could be; far poses must be better."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tiny_world import Box, lidar_rays, pose, scans

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.motion.prediction import Expected, Motion
from hybridreg_ros.odometry.registration.alignment import Fit
from hybridreg_ros.odometry.result import Reason
from hybridreg_ros.odometry.selection import calibration
from hybridreg_ros.odometry.selection.candidates import (
    Candidate,
    against_motion,
    innovation,
    is_worth_it,
    log_odds,
    rank,
    runner_up,
)
from hybridreg_ros.odometry.selection.fallback import Fallback
from hybridreg_ros.odometry.selection.pose_confidence import PoseEvidence, Verdict, of_evidence
from hybridreg_ros.odometry.selection.reported_confidence import ReportedConfidence

PERIOD_M = 1.0
AT = pose(2.0, -1.0, 30.0)


def moved(x: float, degrees: float) -> np.ndarray:
    """A step along the sensor's x and a turn."""
    return pose(x, 0.0, degrees, z=0.0)


def candidate(T: np.ndarray, confidence: float) -> Candidate:
    fit = Fit(T, np.eye(6), 1.0, 1e-6 * np.eye(6))
    return Candidate(fit, PoseEvidence(1.0, 1.0, 1.0), Verdict(confidence, None), T)


def test_innovation_is_the_deviation_in_voxels_and_degrees_and_what_is_usual() -> None:
    calm = Expected(AT, 0.0, 0.0, 0.1)
    assert innovation(AT @ moved(0.3, 0.0), calm, 0.1) == pytest.approx(np.log10(3.1))
    assert innovation(AT @ moved(0.0, 4.0), calm, 0.1) == pytest.approx(np.log10(4.1))
    assert innovation(AT @ moved(0.3, 4.0), calm, 0.1) == pytest.approx(np.log10(5.1))
    assert innovation(AT, calm, 0.1) == pytest.approx(-1.0)
    jerky = Expected(AT, 0.2, float(np.deg2rad(3.0)), 0.1)
    assert innovation(AT @ moved(0.3, 4.0), jerky, 0.1) == pytest.approx(np.log10(0.1 + 2.0**0.5))
    assert innovation(AT @ moved(0.3, 4.0), replace(calm, known=False), 0.1) == 0.0
    assert innovation(AT, None, 0.1) == 0.0


def test_no_motion_is_known_before_the_second_pose() -> None:
    motion = Motion()
    assert not motion.expect(100).known
    motion.stop(0)
    motion.advance(pose(0.1, 0.0, 0.0), 100_000_000)
    assert motion.expect(200_000_000).known
    motion.stop(200_000_000)
    assert not motion.expect(300_000_000).known


def test_out_of_reach_is_what_no_acceleration_explains() -> None:
    soon, later = (Expected(AT, 0.01, 0.01, seconds) for seconds in (0.1, 0.5))
    assert soon.is_out_of_reach(AT @ moved(0.11, 0.0))
    assert soon.is_out_of_reach(AT @ moved(0.0, 6.0))
    assert not soon.is_out_of_reach(AT @ moved(0.09, 5.0))
    assert not later.is_out_of_reach(AT @ moved(2.4, 100.0))
    assert not replace(soon, known=False).is_out_of_reach(AT @ moved(9.0, 90.0))


def test_a_rival_is_another_pose_as_plausible() -> None:
    same, near = candidate(AT, 0.9), candidate(AT @ moved(0.05, 0.0), 0.8)
    far, poor = candidate(AT @ moved(0.0, 3.0), 0.6), candidate(AT @ moved(1.0, 0.0), 0.1)
    assert runner_up(AT, [], 0.1) == 0.0
    assert runner_up(AT, [same], 0.1) == pytest.approx(0.0, abs=1e-6)
    assert runner_up(AT, [same, near], 0.1) == pytest.approx(0.4)
    assert runner_up(AT, [same, near, far, poor], 0.1) == pytest.approx(0.6)


def test_a_pose_that_little_speaks_for_is_worth_it_only_as_expected_and_without_a_rival() -> None:
    doubtful = replace(candidate(AT, 0.01), innovation=-0.5)
    poor = replace(candidate(AT @ moved(0.3, 0.0), 0.1), evidence=PoseEvidence(0.9, 0.9, 0.6, 0.3))
    assert 0.01 < of_evidence(poor.evidence) < 0.3
    assert is_worth_it(doubtful, [doubtful, poor], 0.1, 0.3)
    assert not is_worth_it(replace(doubtful, innovation=0.1), [doubtful, poor], 0.1, 0.3)
    # One that the motion refuses counts by what speaks for it; one that is the same does not.
    refused = Verdict(0.0, Reason.DISAGREES_WITH_MOTION)
    better = replace(candidate(AT @ moved(0.3, 20.0), 0.0), verdict=refused)
    assert of_evidence(better.evidence) > 0.5
    assert runner_up(AT, [better], 0.1) == 0.0
    assert not is_worth_it(doubtful, [doubtful, poor, better], 0.1, 0.3)
    assert is_worth_it(doubtful, [doubtful, candidate(AT @ moved(0.001, 0.0), 0.9)], 0.1, 0.3)


def test_far_poses_lose_to_near_ones_that_fit_almost_as_well() -> None:
    assert against_motion(0.9, -1.0) == against_motion(0.9, 0.0) == pytest.approx(log_odds(0.9))
    assert against_motion(0.9, 1.0) < 0.0 < against_motion(0.7, 0.0) < against_motion(0.99, 0.5)


def test_a_stiff_pose_beats_a_loose_one_only_where_the_motion_is_old() -> None:
    loose, stiff = (
        PoseEvidence(0.97, 0.9, 0.96, 0.03, -1.3),
        PoseEvidence(0.96, 0.9, 0.96, 0.03, -2.3),
    )
    fine = [Verdict(of_evidence(e), None) for e in (loose, stiff)]
    soon = [rank(e, v, s, True) for e, v, s in zip((loose, stiff), fine, (-0.3, 0.3), strict=True)]
    late = [
        rank(e, v, s, False) for e, v, s in zip((loose, stiff), fine, (-0.3, 0.3), strict=True)
    ]
    assert soon[0] > soon[1]
    assert late[0] < late[1]
    fault = Verdict(0.0, Reason.NO_OVERLAP)
    assert rank(stiff, fault, -1.0, True) == rank(stiff, fault, -1.0, False) == -np.inf


def test_confidence_falls_with_all_that_speaks_against_a_pose() -> None:
    usual = ReportedConfidence(log_odds(0.999), -1.5, -1.2, -0.5, 0.0)
    assert usual.confidence < 0.999, 'the evidence is not what holds it down'
    against = [
        replace(usual, evident=log_odds(0.8)),
        replace(usual, unmatched=-0.3),
        replace(usual, disagreement=0.0),
        replace(usual, innovation=1.0),
        replace(usual, runner_up=0.9),
    ]
    doubt = 1.0 - usual.confidence
    assert doubt < 0.03
    assert all(1.0 - told.confidence > 1.5 * doubt for told in against)
    assert set(calibration.packaged().confidence.weights) == set(vars(usual))
    # That nothing speaks against a pose is no evidence for it.
    bare = replace(
        usual, evident=log_odds(0.4), unmatched=-2.0, disagreement=-2.5, innovation=-1.0
    )
    assert bare.confidence == pytest.approx(0.4)


def _colonnade() -> tuple[Box, ...]:
    """A long hall with a pillar every metre: it looks alike one metre further on."""
    hall = Box((-60.0, -2.0, 0.0), (60.0, 2.0, 3.0), inside=True)
    pillars = [
        Box((x, side, 0.0), (x + 0.3, side + 0.3, 3.0))
        for x in np.arange(-30.0, 30.0, PERIOD_M)
        for side in (-2.0, 1.7)
    ]
    return (hall, *pillars)


def test_a_pose_one_pillar_further_on_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    poses = [pose(0.02 * k, 0.0, 0.0) for k in range(12)]
    clouds = scans(poses, lidar_rays(360, 32), world=_colonnade())
    follow, wide = Fallback.follow, []

    def pillar_off(self: Fallback, cloud: Any, guess: np.ndarray, *how: Any, **so: Any) -> Any:
        """As if a wide search had slipped by a period, from the eighth scan on."""
        fit = follow(self, cloud, guess, *how, **so)
        if so.get('near'):
            return fit
        wide.append(fit)
        if len(wide) < 8:
            return fit
        return replace(fit, T_odom_sensor=fit.T_odom_sensor @ moved(PERIOD_M, 0.0))

    monkeypatch.setattr(Fallback, 'follow', pillar_off)
    odometry = HybridOdometry(OdometryConfig(registrar='kiss-icp'), model=None)
    results = [odometry.step(scan) for scan in clouds]
    off = [
        np.linalg.norm((se3.inverse(se3.inverse(poses[0]) @ T) @ r.pose)[:3, 3])
        for T, r in zip(poses, results, strict=True)
    ]
    slipped = [c for c in odometry.judged if c.innovation > 0.5]
    assert slipped  # the pillar further on was considered for the last scan
    assert slipped[0].evidence.consistent > 0.8  # and fits
    assert max(off) < 0.05
    assert odometry.reported_confidence is not None
    assert odometry.reported_confidence.runner_up > 0.5  # and the report knows of it
    assert odometry.reported_confidence.innovation < 0.0
