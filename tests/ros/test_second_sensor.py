# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Clouds of two sensors joined over DDS, and what happens when one of them stops."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')
pytest.importorskip('tf2_msgs.msg', reason='no tf2_msgs (scripts/build_tf2_msgs.py builds it)')

from diagnostic_msgs.msg import DiagnosticStatus
from ros_harness import FRAME, STEP_NS, cloud, room, running
from sensor_msgs.msg import PointCloud2
from test_guess import edge
from tf2_msgs.msg import TFMessage

from hybridreg_ros.core import se3
from hybridreg_ros.core.pointcloud2 import field_values
from hybridreg_ros.core.scan import Scan
from hybridreg_ros.ros.clouds.second_sensor import joined
from hybridreg_ros.ros.conversions import from_pose
from hybridreg_ros.ros.qos import profile

pytestmark = pytest.mark.ros

T_FIRST_SECOND = se3.exp(np.array([-0.4, 0.1, 0.2, 0.0, 0.1, 3.0]))


def views(x: float) -> tuple[np.ndarray, np.ndarray]:
    """What two sensors that look ahead and back see of the room from x; each in its frame."""
    points = room(x).astype(float)
    ahead = points[:, 0] > 0.0
    back = se3.apply(se3.inverse(T_FIRST_SECOND), points[~ahead])
    return points[ahead].astype(np.float32), back.astype(np.float32)


@pytest.fixture(scope='module')
def probe():
    """A node with two inputs and the pose of the second sensor."""
    settings: dict[str, Any] = {'use_points_2': True, 'odom_frame': 'odom_2'}
    with running('second', **settings) as p:
        static = p.node.create_publisher(TFMessage, '/tf_static', profile(True, 1, latched=True))
        static.publish(TFMessage(transforms=[edge(FRAME, 'second', T_FIRST_SECOND)]))
        p.other = p.node.create_publisher(PointCloud2, 'points_2', profile(True, 50))
        p.listen('static_points', PointCloud2)
        p.wait(
            lambda: p.other.get_subscription_count() and static.get_subscription_count(), 'both'
        )
        p.wait(lambda: p.publishers_matched('static_points'), 'the outputs')
        yield p


def test_both_are_used_and_the_end_of_one_is_said(probe):
    later = STEP_NS // 5  # the second one measures a little later
    for k in range(1, 7):
        x = 0.1 * k
        ahead, _ = views(x)
        _, back = views(x + 0.1 / 5)
        stamp = k * STEP_NS
        probe.other.publish(cloud(back, stamp + later, 'second'))
        probe.fresh()
        pose = from_pose(probe.answer(cloud(ahead, stamp)).pose.pose)
        if k == 1:
            start = x
        np.testing.assert_allclose(pose[:3, 3], [x - start, 0.0, 0.0], atol=0.03)
        np.testing.assert_allclose(pose[:3, :3], np.eye(3), atol=0.01)
        msg = probe.wait(lambda s=stamp: probe.at(s, 'static_points'), 'the points')
        assert (msg.width > 0) == (k > 3)  # before, nothing is known to stand still
        if k <= 3:
            continue
        assert set(field_values(msg, 'sensor')) == {1, 2}
        assert msg.header.frame_id == FRAME
        assert len(ahead) < msg.width <= len(ahead) + len(back)
        np.testing.assert_allclose(np.unique(field_values(msg, 'time')), [0.0, 0.02])
    probe.wait(lambda: probe.values['points_2'] == 'used', 'the diagnostics')
    for k in (7, 8):
        pose = from_pose(probe.answer(cloud(views(0.1 * k)[0], k * STEP_NS)).pose.pose)
        np.testing.assert_allclose(pose[:3, 3], [0.1 * k - start, 0.0, 0.0], atol=0.05)
    text = 'without points_2: no cloud on points_2 within 0.05 s'
    probe.wait(lambda: text in probe.text, 'the warning')
    assert probe.level == DiagnosticStatus.WARN
    before = len(probe.odometry)
    probe.other.publish(cloud(views(0.9)[1], 9 * STEP_NS, 'second'))  # the first one has stopped
    probe.wait(lambda: 'no cloud for' in probe.text, 'the warning')
    assert len(probe.odometry) == before
    probe.answer(cloud(views(0.9)[0], 9 * STEP_NS))
    probe.wait(lambda: probe.values['points_2'] == 'used', 'both again')


@pytest.mark.parametrize(
    ('broken', 'text'),
    [
        ('elsewhere', f'no transform from {FRAME} to elsewhere on /tf_static'),
        ('', 'no usable cloud'),
    ],
)
def test_what_cannot_be_joined_is_said_and_the_first_taken_alone(probe, broken, text):
    stamp = (10 if broken else 11) * STEP_NS
    msg = cloud(views(0.9)[1], stamp, broken or 'second')
    if not broken:
        msg.fields = msg.fields[:2]
    probe.other.publish(msg)
    probe.fresh()
    probe.answer(cloud(views(0.9)[0], stamp))
    probe.wait(lambda: probe.values['points_2'].startswith(text), 'the diagnostics')
    points = probe.wait(lambda: probe.at(stamp, 'static_points'), 'the points')
    assert not any(f.name == 'sensor' for f in points.fields)


def test_times_are_those_of_the_first_stamp():
    points = np.ones((2, 3))
    T = se3.transform(np.eye(3), np.array([1.0, 2.0, 3.0]))
    alike = joined(Scan(points, stamp=10), Scan(points, stamp=10), T)
    assert alike.times is None
    np.testing.assert_allclose(alike.points[2:], points + T[:3, 3])
    of_one = Scan(points, [0.0, 0.1], stamp=STEP_NS, times_from='t (s)')
    both = joined(of_one, Scan(points, stamp=2 * STEP_NS), T)
    assert both.times is not None
    np.testing.assert_allclose(both.times, [0.0, 0.1, 0.1, 0.1])
    assert both.times_from == 't (s)'
    assert both.stamp == STEP_NS
