# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The guess frame over DDS: used, passed over when its transforms stop, used again."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')
pytest.importorskip('tf2_msgs.msg', reason='no tf2_msgs (scripts/build_tf2_msgs.py builds it)')

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TransformStamped
from ros_harness import FRAME, STEP_NS, cloud, room, running
from tf2_msgs.msg import TFMessage

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.core.quaternion import to_quaternion
from hybridreg_ros.ros.conversions import from_pose, to_time
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.qos import profile

pytestmark = pytest.mark.ros

T_BASE_LIDAR = se3.exp(np.array([0.3, 0.0, 0.5, 0.0, 0.0, 0.4]))
T_WHEEL_START = se3.exp(np.array([7.0, -3.0, 0.0, 0.0, 0.0, 2.0]))


def edge(parent: str, child: str, T: np.ndarray, stamp: int = 0) -> TransformStamped:
    """Transform message."""
    msg = TransformStamped(child_frame_id=child)
    msg.header.frame_id, msg.header.stamp = parent, to_time(stamp)
    t, q = msg.transform.translation, msg.transform.rotation
    t.x, t.y, t.z = map(float, T[:3, 3])
    q.x, q.y, q.z, q.w = map(float, to_quaternion(T[:3, :3]))
    return msg


@pytest.fixture(scope='module')
def probe():
    """A node with a guess frame, and publishers of /tf and /tf_static."""
    frames: dict[str, Any] = {
        'guess_frame': 'wheel_g',
        'base_frame': 'base_g',
        'odom_frame': 'odom_g',
    }
    with running('guess', publish_tf=False, **frames) as p:
        static = p.node.create_publisher(TFMessage, '/tf_static', profile(True, 1, latched=True))
        static.publish(TFMessage(transforms=[edge('base_g', FRAME, T_BASE_LIDAR)]))
        p.other = p.node.create_publisher(TFMessage, '/tf', profile(True, 100))
        p.wait(lambda: p.other.get_subscription_count() and static.get_subscription_count(), '/tf')
        p.fresh()
        yield p


def wheels(probe, stamp: int, x: float) -> None:
    """Say on /tf where the base is when the lidar is x ahead of its start, along its own x."""
    ahead = se3.transform(np.eye(3), np.array([x, 0.0, 0.0]))
    T = T_WHEEL_START @ T_BASE_LIDAR @ ahead @ se3.inverse(T_BASE_LIDAR)
    probe.other.publish(TFMessage(transforms=[edge('wheel_g', 'base_g', T, stamp)]))


def test_guess_is_used_and_its_end_is_said(probe):
    way = [0.0, 0.0, 0.8, 1.4, 1.4, 0.9]
    for k, x in enumerate(way):
        stamp = (10 + k) * STEP_NS
        wheels(probe, stamp - STEP_NS // 20, x)  # the node interpolates between the two
        wheels(probe, stamp + STEP_NS // 20, x)
        probe.fresh()
        pose = from_pose(probe.answer(cloud(room(x), stamp)).pose.pose)
        ahead = se3.transform(np.eye(3), np.array([x, 0.0, 0.0]))
        expected = T_BASE_LIDAR @ ahead @ se3.inverse(T_BASE_LIDAR)
        np.testing.assert_allclose(pose, expected, atol=0.03)
    probe.wait(lambda: probe.values['guess'] == 'used', 'the guess')
    probe.answer(cloud(room(0.9), 17 * STEP_NS))
    probe.wait(lambda: 'without guess: no transform' in probe.text, 'the warning')
    assert probe.level == DiagnosticStatus.WARN
    assert probe.values['guess'] == f'no transform from wheel_g to {FRAME} at the time'
    for k in (18, 19):
        wheels(probe, k * STEP_NS, 0.9)
        probe.fresh()
        probe.answer(cloud(room(0.9), k * STEP_NS))
    probe.wait(lambda: probe.values['guess'] == 'used', 'the guess')


def test_own_frames_are_no_guess():
    with pytest.raises(ConfigError, match='guess_frame: expected neither odom_frame nor base'):
        NodeConfig(guess_frame='odom')
