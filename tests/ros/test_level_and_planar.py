# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The first pose by gravity, and motion in a plane, over DDS."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from ros_harness import FRAME, STEP_NS, cloud, room, running
from sensor_msgs.msg import Imu

from hybridreg_ros.core import se3
from hybridreg_ros.core.quaternion import to_quaternion
from hybridreg_ros.odometry.registration.planar import VARIANCE
from hybridreg_ros.ros.conversions import from_pose, to_time
from hybridreg_ros.ros.qos import profile
from hybridreg_ros.ros.transforms import levelled

pytestmark = pytest.mark.ros

T_BASE_LIDAR = se3.exp(np.array([0.3, 0.1, 0.5, 0.15, -0.2, 0.6]))
MOUNT: dict[str, Any] = {
    'base_frame': 'base_l',
    'extrinsic_source': 'parameter',
    'extrinsic': (
        *map(float, T_BASE_LIDAR[:3, 3]),
        *map(float, to_quaternion(T_BASE_LIDAR[:3, :3])),
    ),
}
ROLL, PITCH, YAW = 0.1, -0.2, 0.7


def turn(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """(3, 3) about x, then y, then z, fixed axes."""
    axes = zip(np.eye(3), (roll, pitch, yaw), strict=True)
    R = np.eye(3)
    for axis, angle in axes:
        R = se3.so3_exp(axis * angle) @ R
    return R


def at_rest(imu, probe, until: int, shake: float = 0.0, gravity: float = 9.81) -> None:
    """Publish two seconds of what an IMU in the lidar measures, the base being tilted.

    In 0.4 s: the node may see the publisher a little later than the publisher sees the node.
    """
    rng = np.random.default_rng(0)
    up = T_BASE_LIDAR[:3, :3].T @ turn(ROLL, PITCH, 0.0).T @ [0.0, 0.0, 1.0]
    for stamp in range(until - 2_000_000_000, until + 1, 10_000_000):
        msg = Imu()
        msg.header.stamp, msg.header.frame_id = to_time(stamp), FRAME
        force = gravity * (up + rng.normal(0.0, 0.01 + shake, 3))
        a = msg.linear_acceleration
        a.x, a.y, a.z = map(float, force)
        imu.publish(msg)
        time.sleep(0.002)
    probe.fresh()


def test_the_first_pose_is_levelled_at_rest_and_only_then():
    start = (1.0, 2.0, 3.0, *map(float, to_quaternion(turn(0.3, 0.0, YAW))))
    with running('level', use_imu=True, initial_pose=start, **MOUNT) as probe:
        imu = probe.node.create_publisher(Imu, 'imu', profile(True, 500))
        probe.wait(imu.get_subscription_count, 'the match')
        stamp = 100 * STEP_NS
        for gravity in (9.81, 1.0):  # m/s^2, and g
            at_rest(imu, probe, stamp, gravity=gravity)
            pose = from_pose(probe.answer(cloud(room(), stamp)).pose.pose)
            np.testing.assert_allclose(pose[:3, :3], turn(ROLL, PITCH, YAW), atol=5e-3)
            np.testing.assert_allclose(pose[:3, 3], start[:3])
            probe.wait(lambda: probe.values['level'] == 'levelled', 'the diagnostics')
            stamp += 30 * STEP_NS
            assert probe.call('reset_to_pose').success
        at_rest(imu, probe, stamp, shake=0.2)
        pose = from_pose(probe.answer(cloud(room(), stamp)).pose.pose)
        np.testing.assert_allclose(pose[:3, :3], turn(0.3, 0.0, YAW), atol=1e-6)
        text = 'not levelled: not at rest at the first cloud'
        probe.wait(lambda: probe.values['level'] == text, 'the diagnostics')
        assert text in probe.process.log.read_text()
        assert probe.call('reset_to_pose').success
        stamp += 100 * STEP_NS  # no accelerations for a long time
        probe.answer(cloud(room(), stamp))
        probe.wait(lambda: 'no accelerations on imu' in probe.values['level'], 'the diagnostics')


@pytest.mark.parametrize('yaw', [0.0, -2.5])
def test_levelled_keeps_yaw_whatever_the_base_axes(yaw):
    T = se3.transform(turn(0.4, 0.3, yaw), np.array([1.0, 2.0, 3.0]))
    for roll, pitch in ((0.2, -0.4), (np.pi / 2, 0.0), (0.0, np.pi / 2)):
        R = turn(roll, pitch, 0.0)
        pose = levelled(T, 9.81 * R[2])
        np.testing.assert_allclose(pose[:3, :3].T @ [0.0, 0.0, 1.0], R[2], atol=1e-12)
        np.testing.assert_allclose(pose[:3, 3], T[:3, 3])
        if abs(pitch) < 1.0:
            np.testing.assert_allclose(pose[:3, :3], turn(roll, pitch, yaw), atol=1e-12)


def test_planar_poses_stay_in_the_plane():
    with running('planar', planar=True, **MOUNT) as probe:
        rng = np.random.default_rng(1)
        T_lidar_base = se3.inverse(T_BASE_LIDAR)
        for k in range(8):
            yaw, x, y = 0.06 * k, 0.08 * k, -0.04 * k
            T_odom_base = se3.transform(turn(0.0, 0.0, yaw), np.array([x, y, 0.0]))
            bump = np.zeros(6) if k == 0 else rng.normal(0.0, 0.01, 6)  # floors are never flat
            T = T_BASE_LIDAR @ se3.exp(bump) @ T_lidar_base
            T_start_lidar = T_lidar_base @ T_odom_base @ T @ T_BASE_LIDAR
            points = se3.apply(se3.inverse(T_start_lidar), room().astype(float))
            msg = probe.answer(cloud(points.astype(np.float32), (k + 1) * STEP_NS))
            pose = from_pose(msg.pose.pose)
            np.testing.assert_allclose(pose, T_odom_base, atol=0.05)
            assert pose[2, 3] == 0.0
            np.testing.assert_allclose(pose[2, :3], [0.0, 0.0, 1.0], atol=1e-15)
        for covariance in (msg.pose.covariance, msg.twist.covariance):
            spread = np.reshape(covariance, (6, 6))
            np.testing.assert_allclose(np.diag(spread)[2:5], VARIANCE)
            assert not spread[2:5, [0, 1, 5]].any()
            assert np.all(np.diag(spread)[[0, 1, 5]] > 0.0)
        v, w = msg.twist.twist.linear, msg.twist.twist.angular
        assert (v.z, w.x, w.y) == (0.0, 0.0, 0.0)
        ahead = turn(0.0, 0.0, yaw).T @ [0.8, -0.4, 0.0]
        np.testing.assert_allclose([v.x, v.y, w.z], [*ahead[:2], 0.6], atol=0.35)
