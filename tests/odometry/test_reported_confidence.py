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
from hybridreg_ros.odometry.config import GateConfig, OdometryConfig
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.motion.prediction import Expected, Motion
from hybridreg_ros.odometry.registration.alignment import Fit
from hybridreg_ros.odometry.result import Reason, Source
from hybridreg_ros.odometry.selection import calibration
from hybridreg_ros.odometry.selection.candidates import (
    AGAINST,
    UNHELD,
    Candidate,
    innovation,
    is_worth_it,
    log_odds,
    runner_up,
)
from hybridreg_ros.odometry.selection.fallback import Fallback
from hybridreg_ros.odometry.selection.pose_confidence import PoseEvidence, of_evidence
from hybridreg_ros.odometry.selection.reported_confidence import ReportedConfidence

PERIOD_M = 1.0
AT = pose(2.0, -1.0, 30.0)


def moved(x: float, degrees: float) -> np.ndarray:
    """A step along the sensor's x and a turn."""
    return pose(x, 0.0, degrees, z=0.0)


def candidate(T: np.ndarray, confidence: float, unheld: bool = False) -> Candidate:
    """One of which the evidence alone says so much."""
    fit = Fit(T, np.eye(6), 1.0, 1e-6 * np.eye(6), unheld=np.eye(6) * unheld)
    model = calibration.packaged().evidence
    rest = model.bias - 2.5 * model.weights['worst_axis']
    consistent = (log_odds(confidence) - rest) / model.weights['consistent']
    evidence = PoseEvidence(1.0, 1.0, consistent, 0.0, -2.5)
    assert of_evidence(evidence) == pytest.approx(confidence)
    return Candidate(fit, Source.KISS_ICP, Reason.OK, evidence, T)


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


def test_a_rival_is_another_pose_as_plausible() -> None:
    same, near = candidate(AT, 0.9), candidate(AT @ moved(0.05, 0.0), 0.8)
    far, poor = candidate(AT @ moved(0.0, 3.0), 0.6), candidate(AT @ moved(1.0, 0.0), 0.1)
    assert runner_up(AT, [], 0.1) == 0.0
    assert runner_up(AT, [same], 0.1) == pytest.approx(0.0, abs=1e-6)
    assert runner_up(AT, [same, near], 0.1) == pytest.approx(0.4)
    assert runner_up(AT, [same, near, far, poor], 0.1) == pytest.approx(0.6)


def test_a_pose_that_little_speaks_for_is_worth_it_only_as_expected_and_without_a_rival() -> None:
    doubtful = replace(candidate(AT, 0.01), innovation=-0.5)
    poor = candidate(AT @ moved(0.3, 0.0), 0.2)
    assert is_worth_it(doubtful, [doubtful, poor], 0.1, 0.3)
    assert not is_worth_it(replace(doubtful, innovation=0.1), [doubtful, poor], 0.1, 0.3)
    # One that the motion speaks against counts by what it sees; one that is the same does not.
    better = replace(candidate(AT @ moved(0.3, 20.0), 0.9), innovation=2.0)
    assert better.score < 0.0
    assert runner_up(AT, [better], 0.1) == 0.0
    assert not is_worth_it(doubtful, [doubtful, poor, better], 0.1, 0.3)
    assert is_worth_it(doubtful, [doubtful, candidate(AT @ moved(0.001, 0.0), 0.9)], 0.1, 0.3)


def test_far_poses_lose_to_near_ones_that_fit_almost_as_well() -> None:
    sure, fair, best = (candidate(AT, p) for p in (0.9, 0.7, 0.99))
    assert sure.score == replace(sure, innovation=-1.0).score == pytest.approx(log_odds(0.9))
    far = replace(sure, innovation=1.0)
    assert far.score == pytest.approx(sure.score - AGAINST)
    assert far.score < 0.0 < fair.score < replace(best, innovation=0.5).score


def test_a_pose_that_nothing_holds_ranks_as_the_prediction_and_one_unseen_last() -> None:
    held, loose = candidate(AT, 0.9), candidate(AT, 0.95, unheld=True)
    assert loose.score > held.score > loose.rank
    assert loose.rank == pytest.approx(loose.score + log_odds(UNHELD))
    unseen = replace(held, evidence=replace(held.evidence, seen=0.1))
    assert not unseen.is_seen
    assert unseen.confidence == unseen.evident == 0.0
    assert unseen.rank < candidate(AT, 0.01).rank


def test_the_network_may_doubt_its_own_pose() -> None:
    found = candidate(AT, 0.9)
    assert found.confidence == found.evident
    doubted = replace(found, vouched=0.6, doubt=0.4)
    assert doubted.confidence == 0.6
    assert doubted.rank == pytest.approx(found.rank - 0.4)


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
    locate = Fallback._locate

    def pillar_off(self: Fallback, *how: Any) -> Fit:
        """As if a wide search slipped by a period."""
        fit = locate(self, *how)
        return replace(fit, T_odom_sensor=fit.T_odom_sensor @ moved(PERIOD_M, 0.0))

    monkeypatch.setattr(Fallback, '_locate', pillar_off)
    config = OdometryConfig(registrar='kiss-icp', gate=GateConfig(sure=1.0))  # all ways are tried
    odometry = HybridOdometry(config, model=None)
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
