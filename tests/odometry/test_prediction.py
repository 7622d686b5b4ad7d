# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the motion so far says of the next pose, and where it outweighs the points."""

from __future__ import annotations

import numpy as np
import pytest
from tiny_world import Box, cast, depth_rays, pose

import hybridreg_ros.odometry.preprocess as preprocessing
from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.odometry.config import GateConfig, OdometryConfig
from hybridreg_ros.odometry.map.local_map import LocalMap
from hybridreg_ros.odometry.motion.prediction import Expected, Motion
from hybridreg_ros.odometry.preprocess import preprocess, recognise_sensor
from hybridreg_ros.odometry.registration.alignment import Fit, align
from hybridreg_ros.odometry.registration.gauss_newton import believed
from hybridreg_ros.odometry.result import Reason, Source
from hybridreg_ros.odometry.selection.candidates import Candidate
from hybridreg_ros.odometry.selection.pose_confidence import PoseEvidence, worst_axis

FRAME = NS_PER_S // 10
WALL = (Box((2.0, -30.0, -30.0), (3.0, 30.0, 30.0)),)


def test_velocity_passes_over_poses_that_were_only_predicted() -> None:
    step = se3.exp(np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.02]))
    motion = Motion(stamp=0)
    motion.advance(step, FRAME)
    motion.hold(step @ se3.exp(np.array([0.9, 0.0, 0.0, 0.0, 0.0, 0.5])), 2 * FRAME)
    motion.advance(step @ step @ step, 3 * FRAME)
    np.testing.assert_allclose(motion.twist, se3.log(step) / 0.1, atol=1e-9)
    assert motion.last_step_s == pytest.approx(0.2)


def test_spread_follows_the_errors_of_predictions_and_grows_while_coasting() -> None:
    rng = np.random.default_rng(3)
    motion, T = Motion(stamp=0), np.eye(4)
    unknown = motion.expect(FRAME)
    for k in range(1, 30):
        T = T @ se3.exp(np.concatenate([[0.1, 0.0, 0.0], rng.normal(0.0, 0.01, 3)]))
        motion.advance(T, k * FRAME)
    usual = motion.expect(30 * FRAME)
    assert usual.turn_rad < 0.2 * unknown.turn_rad
    assert 0.007 < usual.turn_rad < 0.03  # differences of two draws: 0.014
    assert np.all((usual.turn_rate > 0.07) & (usual.turn_rate < 0.3))
    motion.hold(motion.predict(30 * FRAME), 30 * FRAME)
    assert motion.expect(31 * FRAME).turn_rad == pytest.approx(3.0 * usual.turn_rad)
    motion.stop(31 * FRAME)
    assert motion.expect(32 * FRAME).turn_rad == unknown.turn_rad


def test_two_opinions_are_fused_by_what_each_is_worth() -> None:
    turned = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3]))
    expected, other = Expected(pose(1.0, 0.0, 0.0) @ turned, 0.3, 0.1, 0.1), pose(2.0, 0.0, 0.0)
    best = expected.fused(other, 0.1, 0.1)
    assert best.pose[0, 3] == pytest.approx(1.9)  # variances of 9 to 1
    assert se3.rotation_angle_deg(best.pose[:3, :3]) == pytest.approx(np.rad2deg(0.15))
    assert best.shift_m == pytest.approx((0.3**-2 + 0.1**-2) ** -0.5)
    assert best.turn_rad == pytest.approx(0.1 / 2**0.5)
    vague = expected.fused(other, 1e6, 1e6)
    np.testing.assert_allclose(vague.pose, expected.pose, atol=1e-9)


def test_spread_of_the_turning_is_told_axis_by_axis() -> None:
    motion, T = Motion(stamp=0), np.eye(4)
    for k in range(1, 30):  # nods to and fro, hardly rolls
        nod = 0.02 * (-1.0) ** k
        T = T @ se3.exp(np.array([0.1, 0.0, 0.0, 0.002 * (k % 3), nod, 0.001]))
        motion.advance(T, k * FRAME)
    rolls, nods, turns = motion.expect(30 * FRAME).turn_rate
    assert nods == pytest.approx(0.04 / 0.1 / 0.6745, rel=0.1)
    assert rolls < 0.5 * nods
    assert turns == rolls, 'the least share of the mean'


def wall_map(noise_m: float) -> tuple[LocalMap, np.ndarray, np.ndarray]:
    """Map of one bare wall, a scan of it from the same place, and that place."""
    here, local = pose(0.0, 0.0, 0.0), LocalMap(0.05, 10.0)
    for k in range(3):
        points = cast(WALL, here, depth_rays(), seed=k, noise_m=noise_m)[0]
        local.update(se3.apply(here, points.astype(np.float64)), here[:3, 3])
    return local, cast(WALL, here, depth_rays(), seed=9, noise_m=noise_m)[0], here


def test_motion_holds_what_a_bare_wall_leaves_loose() -> None:
    local, points, here = wall_map(0.004)
    slid = here @ se3.exp(np.array([0.0, 0.06, 0.0, 0.03, 0.0, 0.0]))
    expected = Expected(here, 0.03, 0.01, 0.1)
    free = align(points, slid, local, basin='fine').T_odom_sensor
    held = align(points, slid, local, basin='fine', prior=expected).T_odom_sensor
    off = [np.linalg.norm((se3.inverse(here) @ T)[:3, 3]) for T in (free, held)]
    turned = [se3.rotation_angle_deg((se3.inverse(here) @ T)[:3, :3]) for T in (free, held)]
    assert off[0] > 0.03
    assert off[1] < 0.01
    assert turned[1] < 0.5 * turned[0]


def test_noise_of_normals_is_not_taken_for_information() -> None:
    any_way = np.diag([1e6, 1e6, 1e6, 1e5, 1e5, 1e5])
    wall = np.diag([1e6, 1e3, 1e3, 1e2, 1e5, 1e5])  # along the wall: normals off by 2 degrees
    b = np.array([0.0, 50.0, 0.0, 0.0, 3.0, 0.0])
    H, gradient = believed(wall, b, any_way)
    assert H[0, 0] == pytest.approx(1e6, rel=0.01)
    assert H[1, 1] < 0.06 * wall[1, 1]
    np.testing.assert_allclose(np.linalg.solve(H, gradient), np.linalg.solve(wall, b), rtol=1e-4)


def test_few_pairs_of_points_and_no_plane_hold_a_pose_without_an_error() -> None:
    rng = np.random.default_rng(5)
    arm = rng.normal(0.0, 3.0, 3)  # one point alone: three of six directions are free
    J = np.hstack([np.eye(3), -np.cross(np.eye(3), arm)])
    for weight in (1e-3, 1.0, 1e9):
        H, b = weight * J.T @ J, weight * J.T @ rng.normal(0.0, 0.01, 3)
        held, pull = believed(H, b, np.zeros((6, 6)))
        assert np.isfinite(held).all()
        assert np.isfinite(pull).all()
        assert np.linalg.eigvalsh(held).max() > 0.0


def test_few_cubes_are_made_finer_for_the_registration(monkeypatch: pytest.MonkeyPatch) -> None:
    points = cast(WALL, pose(1.2, 0.0, 0.0), depth_rays(320, 240))[0]
    config = OdometryConfig(voxel_size_m=0.06)
    sensor = recognise_sensor(points, config)
    scan = Scan(points, stamp=1.0, frame_id='s')
    cloud = preprocess(scan, sensor, config.preprocess, np.zeros(6))
    monkeypatch.setitem(preprocessing._ENOUGH, 'depth', 1)
    few = len(preprocess(scan, sensor, config.preprocess, np.zeros(6)).icp_rows)
    assert few < 300
    assert len(cloud.icp_rows) > 3 * few
    assert set(cloud.icp_rows) <= set(cloud.map_rows)


@pytest.mark.parametrize(
    ('confidence', 'held_m', 'overlap', 'tentative', 'written'),
    [
        (0.5, 0.005, 0.95, False, False),
        (0.5, 0.005, 0.5, False, True),
        (0.2, 0.005, 0.5, True, False),
        (0.95, 0.005, 0.95, False, True),
        (0.95, 0.02, 0.95, False, False),
        (0.95, 0.02, 0.5, False, True),
    ],
)
def test_a_doubtful_or_loose_scan_is_written_only_where_the_map_is_empty(
    confidence: float, held_m: float, overlap: float, tentative: bool, written: bool
) -> None:
    fit = Fit(np.eye(4), np.eye(6), overlap, 1e-6 * np.eye(6))
    evidence = PoseEvidence(overlap, 1.0, 1.0, worst_axis=worst_axis(held_m))
    found = Candidate(
        fit,
        Source.HYBRIDREG,
        Reason.OK,
        evidence,
        fit.T_odom_sensor,
        vouched=confidence,
        tentative=tentative,
    )
    assert found.confidence == confidence
    assert found.adds_to_map(GateConfig().sure, 0.05) is written
