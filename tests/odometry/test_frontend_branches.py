# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Network branch and fallback: who leads, why, and that odom does not jump between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from neighbourhood_registrar import NeighbourhoodRegistrar
from tiny_world import lidar_rays, pose, scans, walk

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import ConfigError, RegistrationError
from hybridreg_ros.core.scan import Scan
from hybridreg_ros.model.budget import Budget
from hybridreg_ros.odometry import tracker
from hybridreg_ros.odometry.config import (
    GateConfig,
    KeyframeConfig,
    LostConfig,
    OdometryConfig,
)
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.keyframes import Keyframe
from hybridreg_ros.odometry.network_branch import LearnedBranch
from hybridreg_ros.odometry.registration.kiss import KissRegistration
from hybridreg_ros.odometry.result import OdometryResult, Reason, Source

RAYS = lidar_rays()
ASKING = OdometryConfig()


def worst_error_m(results: list[OdometryResult], poses: list) -> float:
    start = se3.inverse(poses[0])
    return max(
        float(np.linalg.norm((se3.inverse(start @ T) @ r.pose)[:3, 3]))
        for T, r in zip(poses, results, strict=True)
    )


def test_network_leads_and_encodes_each_scan_once() -> None:
    poses = walk(10)
    registrar = NeighbourhoodRegistrar()
    odometry = HybridOdometry(ASKING, model=registrar)
    results = [odometry.step(scan) for scan in scans(poses, RAYS)]
    assert odometry.has_network
    assert {r.source for r in results[1:]} == {Source.HYBRIDREG}
    assert {r.reason for r in results[1:]} == {Reason.OK}
    assert worst_error_m(results, poses) < 0.02
    assert registrar.encodes == len(results)
    assert {'encode', 'match', 'refine', 'dynamics', 'map'} <= set(results[-1].timings_s)


def test_only_encodings_that_were_asked_for_last_are_kept() -> None:
    registrar = NeighbourhoodRegistrar()
    branch = LearnedBranch(registrar, 2)
    clouds = [scan.points for scan in scans(walk(4), RAYS)]
    frames = [Keyframe(k, k, np.eye(4), points) for k, points in enumerate(clouds)]
    encodes = []
    for number in (0, 1, 0, 2, 0, 1):  # 1 is asked for longest ago when 2 comes
        before, scan = registrar.encodes, branch.encode(clouds[3], Budget())
        assert branch.propose(scan, frames[number]) is not None
        encodes.append(registrar.encodes - before)
    assert encodes == [2, 2, 1, 2, 1, 2]  # the scan itself, and the keyframe if it was not kept


def test_encodings_of_keyframes_that_are_not_asked_for_go() -> None:
    registrar = NeighbourhoodRegistrar()
    branch = LearnedBranch(registrar, 8)
    clouds = [scan.points for scan in scans(walk(4), RAYS)]
    frames = [Keyframe(k, k, np.eye(4), points) for k, points in enumerate(clouds)]
    scan = branch.encode(clouds[3], Budget())
    for frame in frames[:3]:
        assert branch.propose(scan, frame) is not None
    assert registrar.encodes == 4
    branch.keep_only(frames[1:])
    for frame in frames[1:3]:
        branch.propose(scan, frame)
    assert registrar.encodes == 4
    branch.propose(scan, frames[0])
    assert registrar.encodes == 5


def test_only_recent_keyframes_keep_their_encodings_while_the_pose_is_known() -> None:
    config = replace(ASKING, keyframe=KeyframeConfig(max_distance=0.5, window=2))
    odometry = HybridOdometry(config, model=NeighbourhoodRegistrar())
    for scan in scans(walk(10), RAYS):
        odometry.step(scan)
    tracker = odometry._tracker
    assert tracker is not None
    assert tracker._learned is not None
    numbers = [f.number for f in tracker._world.keyframes]
    assert len(numbers) > 3
    assert sorted({n for n, _ in tracker._learned._keyframes}) == numbers[-2:]


def test_the_heap_is_given_back_with_keyframes_that_the_network_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[int] = []
    monkeypatch.setattr(tracker, 'give_back', lambda: given.append(1))
    for model in (None, NeighbourhoodRegistrar()):
        odometry = HybridOdometry(
            replace(ASKING, keyframe=KeyframeConfig(max_age_s=0.15)), model=model
        )
        results = [odometry.step(scan) for scan in scans(walk(6), RAYS)]
        made = sum(r.is_keyframe for r in results[1:])  # the first scan is one as it is
        assert 0 < made < 5
        assert len(given) == (0 if model is None else made)


def test_switch_has_hysteresis_and_no_jump() -> None:
    poses = walk(14)
    registrar = NeighbourhoodRegistrar()
    odometry = HybridOdometry(ASKING, model=registrar)
    results = []
    dims = [1.0] * 4 + [0.1] * 3 + [0.55] * 3 + [1.0] * 4
    for dim, scan in zip(dims, scans(poses, RAYS), strict=True):
        registrar.dim = dim
        results.append(odometry.step(scan))
    sources = [r.source for r in results]
    assert sources[1:4] == [Source.HYBRIDREG] * 3
    assert sources[4:10] == [Source.KISS_ICP] * 6
    assert {r.reason for r in results[4:10]} == {Reason.LOW_CONFIDENCE}
    assert sources[10:] == [Source.HYBRIDREG] * 4
    assert worst_error_m(results, poses) < 0.02
    steps = np.diff([r.pose[:3, 3] for r in results], axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 0.08, atol=0.02)


def test_a_pose_that_the_network_doubts_is_taken_where_nothing_better_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refusing(*_: object) -> None:
        raise RegistrationError('no')

    monkeypatch.setattr(KissRegistration, 'align', refusing)
    poses = walk(10)
    registrar = NeighbourhoodRegistrar()
    odometry = HybridOdometry(ASKING, model=registrar)
    results = []
    for k, scan in enumerate(scans(poses, RAYS)):
        registrar.dim = {7: 0.6, 8: 0.1}.get(k, 1.0)
        results.append(odometry.step(scan))
    assert results[7].source is Source.HYBRIDREG
    assert 0.3 < results[7].confidence <= 0.6
    assert results[8].confidence == 0.0  # not even looked at
    assert worst_error_m(results, poses) < 0.02


def test_a_mask_that_leaves_nothing_is_no_evidence_against_a_pose() -> None:
    poses = walk(8)
    registrar = NeighbourhoodRegistrar()
    registrar.dim, registrar.doubt = 0.1, 1.0
    odometry = HybridOdometry(ASKING, model=registrar)
    results = [odometry.step(scan) for scan in scans(poses, RAYS)]
    assert registrar.matches > 0
    assert {r.source for r in results[1:]} == {Source.KISS_ICP}
    assert min(r.confidence for r in results) > 0.9
    assert worst_error_m(results, poses) < 0.02


def test_a_loosely_held_view_becomes_no_keyframe() -> None:
    config = OdometryConfig(
        keyframe=KeyframeConfig(max_age_s=0.1),  # every second scan would be one
        gate=GateConfig(accept=0.0),
    )
    odometry = HybridOdometry(config, model=None)
    views = list(scans(walk(8, step_m=0.06), lidar_rays(720, 48)))
    x, y, z = views[4].points.T
    bare = views[4].points[(np.abs(np.arctan2(y, x)) < np.deg2rad(10.0)) & (z > -0.9)]
    views[4] = Scan(bare, stamp=views[4].stamp, frame_id=views[4].frame_id)
    results = [odometry.step(scan) for scan in views]
    assert results[4].source is Source.KISS_ICP
    assert 0.0 < results[4].confidence < 0.5
    assert [k for k, r in enumerate(results) if r.is_keyframe] == [0, 2, 5, 7]


@pytest.mark.parametrize('shift_m', [0.8, 4.0])
def test_confident_but_wrong_network_is_overruled(shift_m: float) -> None:
    poses = walk(8)
    registrar = NeighbourhoodRegistrar()
    odometry = HybridOdometry(ASKING, model=registrar)
    results = []
    for k, scan in enumerate(scans(poses, RAYS)):
        registrar.shift_m = shift_m if k >= 4 else 0.0
        results.append(odometry.step(scan))
    if shift_m > 1.0:  # too far off to be pulled in
        assert {r.source for r in results[4:]} == {Source.KISS_ICP}
        wrong = {Reason.DISAGREES_WITH_MOTION, Reason.REFINEMENT_FAILED, Reason.NO_OVERLAP}
        assert {r.reason for r in results[4:]} <= wrong
    assert worst_error_m(results, poses) < 0.02


def test_network_finds_the_keyframe_after_a_loss() -> None:
    way = walk(8)
    turned = [pose(-0.6, -0.2, 100.0 + 2.0 * k) for k in range(4)]
    dark = [
        Scan(np.zeros((0, 3), np.float32), stamp=100.8 + 0.1 * k, frame_id='sensor')
        for k in range(4)
    ]
    clouds = scans(way, RAYS) + dark + scans(turned, RAYS, start_s=101.2)
    registrar = NeighbourhoodRegistrar(turns_deg=(0.0, 60.0, 90.0, 120.0, 180.0, -90.0))
    config = OdometryConfig(lost=LostConfig(reanchor_after_s=10.0))
    odometry = HybridOdometry(config, model=registrar)
    results = [odometry.step(scan) for scan in clouds]
    assert results[11].source is Source.LOST
    assert results[12].reason is Reason.RECOVERED
    start = se3.inverse(way[0])
    off = se3.inverse(start @ turned[-1]) @ results[-1].pose
    assert np.linalg.norm(off[:3, 3]) < 0.03
    assert se3.rotation_angle_deg(off[:3, :3]) < 0.5


def test_keyframes_follow_the_rule_and_their_number_is_bounded() -> None:
    rule = KeyframeConfig(max_angle_deg=5.0, memory=3)
    odometry = HybridOdometry(OdometryConfig(keyframe=rule), model=NeighbourhoodRegistrar())
    results = [odometry.step(scan) for scan in scans(walk(14), RAYS)]
    taken = [r.keyframe_id for r in results if r.is_keyframe]
    assert taken == list(range(len(taken)))
    assert len(taken) == 5
    assert results[-1].keyframe_id == taken[-1]


def test_scan_that_cannot_be_encoded_falls_back() -> None:
    class Refusing(NeighbourhoodRegistrar):
        def encode(self, points: np.ndarray) -> np.ndarray:
            from hybridreg_ros.core.errors import RegistrationError

            if self.encodes >= 2:
                raise RegistrationError('no extent')
            return super().encode(points)

    odometry = HybridOdometry(ASKING, model=Refusing())
    results = [odometry.step(scan) for scan in scans(walk(4), RAYS)]
    assert results[3].source is Source.KISS_ICP
    assert results[3].reason is Reason.LOW_CONFIDENCE


def test_registrar_kiss_icp_ignores_the_network() -> None:
    registrar = NeighbourhoodRegistrar()
    odometry = HybridOdometry(OdometryConfig(registrar='kiss-icp'), model=registrar)
    results = [odometry.step(scan) for scan in scans(walk(3), RAYS)]
    assert results[2].reason is Reason.REGISTRAR_KISS_ICP
    assert registrar.encodes == 0


def test_the_network_makes_every_pose_and_finds_a_turn_of_60_degrees() -> None:
    poses = walk(8)
    registrar = NeighbourhoodRegistrar(turns_deg=(0.0, 45.0, -45.0))
    odometry = HybridOdometry(model=registrar)
    results = [odometry.step(scan) for scan in scans(poses, RAYS)]
    assert {(r.source, r.reason) for r in results[1:]} == {(Source.HYBRIDREG, Reason.OK)}
    assert registrar.matches == 7
    away = pose(-0.4, -0.3, 60.0)
    result = odometry.step(scans([away], RAYS, start_s=101.0)[0])
    assert registrar.matches == 8
    off = se3.inverse(se3.inverse(poses[0]) @ away) @ result.pose
    assert np.linalg.norm(off[:3, 3]) < 0.02


def test_wrong_model_is_refused() -> None:
    with pytest.raises(ConfigError, match="model: expected 'auto', None or a registrar"):
        HybridOdometry(model=42)


def test_everything_moving_is_not_believed() -> None:
    clouds = scans(walk(4), RAYS)
    rng = np.random.default_rng(3)
    for k in range(3):
        # Every point goes its own way: no rigid motion explains two of these scans.
        rays = rng.normal(size=(5000, 3))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        points = (rays * rng.uniform(1.0, 8.0, (5000, 1))).astype(np.float32)
        clouds.append(
            replace(
                clouds[3],
                points=points,
                rows=np.arange(5000),
                size=5000,
                stamp=clouds[3].stamp + (k + 1) * 100_000_000,
            )
        )
    odometry = HybridOdometry(model=None)
    results = [odometry.step(scan) for scan in clouds]
    assert all(r.confidence == 0.0 for r in results[4:])
    assert results[-1].source is Source.LOST
