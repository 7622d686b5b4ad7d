# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Conversions between results and messages, by identities; no node is started."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from hybridreg_ros.core import se3
from hybridreg_ros.core.pointcloud2 import field_values, from_arrays, to_scan
from hybridreg_ros.core.quaternion import to_quaternion
from hybridreg_ros.core.scan import Scan
from hybridreg_ros.odometry.result import OdometryResult, Reason, Source
from hybridreg_ros.ros import conversions as c

pytestmark = pytest.mark.ros


def random_transform(rng: np.random.Generator) -> np.ndarray:
    return se3.exp(rng.normal(0.0, 1.0, 6))


def random_covariance(rng: np.random.Generator) -> np.ndarray:
    A = rng.normal(0.0, 0.1, (6, 6))
    return A @ A.T + 0.01 * np.eye(6)


def result_of(pose: np.ndarray, covariance: np.ndarray, source: Source) -> OdometryResult:
    scan = Scan(np.zeros((3, 3), np.float32), stamp=1_234_567_890_123_456_789, frame_id='lidar')
    return OdometryResult(
        scan=scan,
        pose=pose,
        covariance=covariance,
        twist=np.arange(6.0) / 10.0,
        twist_covariance=2.0 * covariance,
        source=source,
        reason=Reason.OK,
        confidence=0.9,
        dynamic_probability=np.zeros(3, np.float32),
    )


def test_stamps_keep_every_nanosecond():
    stamp = 1_234_567_890_123_456_789
    assert c.to_ns(c.to_time(stamp)) == stamp
    assert c.to_time(stamp).nanosec == 123_456_789


@pytest.mark.parametrize('angle', [0.0, 1e-9, 0.3, 3.0, np.pi - 1e-9, np.pi])
def test_quaternions_agree_with_scipy(rng, angle):
    for axis in (*np.eye(3), rng.normal(size=3)):
        R = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        q = np.array(to_quaternion(R))
        assert q[3] >= 0.0
        np.testing.assert_allclose(c.rotation(q), R, atol=1e-12)
        expected = Rotation.from_matrix(R).as_quat()
        assert abs(float(q @ expected)) == pytest.approx(1.0, abs=1e-12)


def test_pose_round_trip(rng):
    T = random_transform(rng)
    np.testing.assert_allclose(c.from_pose(c.to_pose(T)), T, atol=1e-12)


def test_base_pose_starts_at_the_identity_and_composes(rng):
    T_bs, A, B = (random_transform(rng) for _ in range(3))
    np.testing.assert_allclose(c.base_pose(np.eye(4), T_bs), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(
        c.base_pose(A @ B, T_bs), c.base_pose(A, T_bs) @ c.base_pose(B, T_bs), atol=1e-12
    )


def test_base_covariance_agrees_with_numeric_derivatives(rng):
    T_bs, pose, covariance = random_transform(rng), random_transform(rng), random_covariance(rng)
    expected = c.base_pose(pose, T_bs)
    h, columns = 1e-6, []
    for d in h * np.eye(6):
        moved = se3.transform(se3.so3_exp(d[3:]) @ pose[:3, :3], pose[:3, 3] + d[:3])
        base = c.base_pose(moved, T_bs)
        turn = se3.so3_log(base[:3, :3] @ expected[:3, :3].T)
        columns.append(np.concatenate([base[:3, 3] - expected[:3, 3], turn]) / h)
    J = np.array(columns).T
    np.testing.assert_allclose(
        c.base_covariance(covariance, pose, T_bs), J @ covariance @ J.T, atol=1e-5
    )


def test_base_twist_is_the_derivative_of_the_base_pose(rng):
    T_bs, pose, twist = random_transform(rng), random_transform(rng), rng.normal(size=6)
    h = 1e-6
    before, after = c.base_pose(pose, T_bs), c.base_pose(pose @ se3.exp(h * twist), T_bs)
    expected = se3.log(se3.inverse(before) @ after) / h
    found, covariance = c.base_twist(twist, np.eye(6), T_bs)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()


def test_odometry_message_of_a_result(rng):
    pose, covariance = random_transform(rng), random_covariance(rng)
    msg = c.to_odometry(result_of(pose, covariance, Source.HYBRIDREG), ('odom', 'lidar'))
    assert c.to_ns(msg.header.stamp) == 1_234_567_890_123_456_789
    assert (msg.header.frame_id, msg.child_frame_id) == ('odom', 'lidar')
    np.testing.assert_allclose(c.from_pose(msg.pose.pose), pose, atol=1e-12)
    np.testing.assert_array_equal(np.reshape(msg.pose.covariance, (6, 6)), covariance)
    np.testing.assert_array_equal(np.reshape(msg.twist.covariance, (6, 6)), 2.0 * covariance)
    v, w = msg.twist.twist.linear, msg.twist.twist.angular
    assert [v.x, v.y, v.z, w.x, w.y, w.z] == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]


@pytest.mark.parametrize('extrinsic', [False, True])
def test_lost_is_9999_whatever_the_frame(rng, extrinsic):
    T_bs = random_transform(rng) if extrinsic else None
    result = result_of(np.eye(4), np.eye(6), Source.LOST)
    msg = c.to_odometry(result, ('odom', 'base'), T_bs)
    assert np.diag(np.reshape(msg.pose.covariance, (6, 6))).min() >= 9999.0


def test_transform_message_and_its_inverse(rng):
    pose = random_transform(rng)
    odometry = c.to_odometry(result_of(pose, np.eye(6), Source.HYBRIDREG), ('odom', 'base'))
    plain, inverted = c.to_transform(odometry), c.to_transform(odometry, invert=True)
    assert (plain.header.frame_id, plain.child_frame_id) == ('odom', 'base')
    assert (inverted.header.frame_id, inverted.child_frame_id) == ('base', 'odom')
    t = inverted.transform.translation
    np.testing.assert_allclose([t.x, t.y, t.z], se3.inverse(pose)[:3, 3], atol=1e-12)


def test_cloud_round_trip(rng):
    points = rng.normal(size=(50, 3)).astype(np.float32)
    label = rng.integers(0, 5, 50).astype(np.uint8)
    header = Header(stamp=c.to_time(5), frame_id='lidar')
    msg = c.to_pointcloud2(from_arrays(points, {'label': label}, shape=(5, 10)), header)
    scan = to_scan(msg)
    np.testing.assert_array_equal(scan.points, points)
    np.testing.assert_array_equal(field_values(msg, 'label'), label)
    assert (scan.stamp, scan.frame_id, scan.shape) == (5, 'lidar', (5, 10))
