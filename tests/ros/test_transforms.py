# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""/tf and the sensor's pose in the base frame, over real DDS with a real tf2_msgs."""

from __future__ import annotations

import time
from itertools import count
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')
pytest.importorskip('tf2_msgs.msg', reason='no tf2_msgs (scripts/build_tf2_msgs.py builds it)')

from geometry_msgs.msg import TransformStamped
from ros_harness import FRAME, STEP_NS, cloud, room, running
from tf2_msgs.msg import TFMessage

from hybridreg_ros.core import se3
from hybridreg_ros.core.quaternion import to_quaternion
from hybridreg_ros.ros.conversions import from_pose, rotation, to_ns
from hybridreg_ros.ros.qos import profile

pytestmark = pytest.mark.ros

_stamps = count(10 * STEP_NS, STEP_NS)
T_BASE_MOUNT = se3.exp(np.array([0.3, -0.1, 0.5, 0.0, 0.0, 0.7]))
T_MOUNT_LIDAR = se3.exp(np.array([0.0, 0.2, 0.1, 0.1, -0.2, 0.3]))


def stamp() -> int:
    """The next stamp, ns."""
    return next(_stamps)


def matrix(transform: TransformStamped) -> np.ndarray:
    """(4, 4) of a transform message."""
    t, q = transform.transform.translation, transform.transform.rotation
    return se3.transform(rotation(np.array([q.x, q.y, q.z, q.w])), np.array([t.x, t.y, t.z]))


def edge(parent: str, child: str, T: np.ndarray) -> TransformStamped:
    """Transform message without a stamp."""
    msg = TransformStamped(child_frame_id=child)
    msg.header.frame_id = parent
    t, q = msg.transform.translation, msg.transform.rotation
    t.x, t.y, t.z = map(float, T[:3, 3])
    q.x, q.y, q.z, q.w = map(float, to_quaternion(T[:3, :3]))
    return msg


def listen(probe) -> list[TransformStamped]:
    """Transforms on /tf that belong to this probe's frames."""
    kept: list[TransformStamped] = []
    probe.node.create_subscription(
        TFMessage, '/tf', lambda m: kept.extend(m.transforms), profile(True, 100)
    )
    probe.wait(lambda: probe.node.count_publishers('/tf'), '/tf')
    probe.fresh()
    return kept


@pytest.fixture(scope='module')
def probe():
    """One node for the module, its base frame known from /tf_static."""
    frames: dict[str, Any] = {'odom_frame': 'odom_tf_test', 'base_frame': 'base_tf_test'}
    with running('tf', **frames) as p:
        p.other = listen(p)
        yield p


def test_waits_for_the_extrinsic_then_follows_it(probe):
    probe.send(cloud(room(), stamp()))
    probe.wait(lambda: 'odometry held back: /tf_static' in probe.text, 'the warning')
    assert not probe.odometry
    static = probe.node.create_publisher(TFMessage, '/tf_static', profile(True, 1, latched=True))
    loop = edge('a_tf_test', 'a_tf_test', np.eye(4))
    static.publish(
        TFMessage(
            transforms=[
                edge('base_tf_test', 'mount', T_BASE_MOUNT),
                edge('mount', FRAME, T_MOUNT_LIDAR),
                loop,
            ]
        )
    )
    probe.send(cloud(room(), stamp()))
    probe.wait(lambda: probe.send(cloud(room(), stamp())) or probe.odometry, 'odometry')
    probe.call('reset')
    poses = {}
    for k in range(4):
        s = stamp()
        poses[s] = from_pose(probe.answer(cloud(room(0.1 * k), s)).pose.pose)
    T_base_lidar = T_BASE_MOUNT @ T_MOUNT_LIDAR
    moved = se3.transform(np.eye(3), np.array([0.3, 0.0, 0.0]))
    expected = T_base_lidar @ moved @ se3.inverse(T_base_lidar)
    np.testing.assert_allclose(list(poses.values())[-1], expected, atol=0.03)
    assert probe.odometry[-1].child_frame_id == 'base_tf_test'
    for s, pose in poses.items():
        sent = probe.wait(
            lambda s=s: [t for t in probe.other if to_ns(t.header.stamp) == s], f'/tf of {s}'
        )
        assert [(t.header.frame_id, t.child_frame_id) for t in sent] == [
            ('odom_tf_test', 'base_tf_test')
        ]
        np.testing.assert_allclose(matrix(sent[0]), pose, atol=1e-9)


def test_a_sensor_that_is_moved_on_tf_static_makes_no_jump(probe):
    before = from_pose(probe.answer(cloud(room(0.3), stamp())).pose.pose)
    static = probe.node.create_publisher(TFMessage, '/tf_static', profile(True, 1, latched=True))
    there = T_MOUNT_LIDAR @ se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    moved = TFMessage(transforms=[edge('mount', FRAME, there)])
    static.publish(moved)
    text = f'/tf_static has moved {FRAME} in base_tf_test'
    end = time.monotonic() + 60.0
    while text not in probe.process.log.read_text():  # it is looked up with each cloud
        assert time.monotonic() < end, 'no warning of the moved sensor'
        after = from_pose(probe.answer(cloud(room(0.3), stamp())).pose.pose)
        np.testing.assert_allclose(after, before, atol=0.02)
    after = from_pose(probe.answer(cloud(room(0.3), stamp())).pose.pose)
    np.testing.assert_allclose(after, before, atol=0.02)
    probe.call('reset')
    probe.answer(cloud(room(), stamp()))
    pose = from_pose(probe.answer(cloud(room(0.1), stamp())).pose.pose)
    T = T_BASE_MOUNT @ there
    shift = se3.transform(np.eye(3), np.array([0.1, 0.0, 0.0]))
    np.testing.assert_allclose(pose, T @ shift @ se3.inverse(T), atol=0.03)


def test_inverted_and_switched_off(probe):
    assert probe.set('invert_tf', True).successful
    s = stamp()
    pose = from_pose(probe.answer(cloud(room(0.1), s)).pose.pose)
    sent = probe.wait(lambda: [t for t in probe.other if to_ns(t.header.stamp) == s], '/tf')[0]
    assert (sent.header.frame_id, sent.child_frame_id) == ('base_tf_test', 'odom_tf_test')
    np.testing.assert_allclose(matrix(sent), se3.inverse(pose), atol=1e-9)
    assert probe.set('invert_tf', False).successful
    assert probe.set('publish_tf', False).successful
    before = len(probe.other)
    probe.answer(cloud(room(), stamp()))
    probe.fresh()
    assert len(probe.other) == before
    assert probe.values['tf'] == 'off'
    assert probe.set('publish_tf', True).successful


def test_no_tf_while_lost(probe):
    for _ in range(3):
        probe.answer(cloud(np.zeros((0, 3), np.float32), stamp()))
    before = len(probe.other)
    probe.answer(cloud(np.zeros((0, 3), np.float32), stamp()))
    probe.fresh()
    assert len(probe.other) == before
    probe.call('reset')


def test_base_frame_by_parameter():
    T = T_BASE_MOUNT
    numbers = (*map(float, T[:3, 3]), *map(float, to_quaternion(T[:3, :3])))
    settings: dict[str, Any] = {
        'base_frame': 'base_p',
        'odom_frame': 'odom_p',
        'extrinsic_source': 'parameter',
        'extrinsic': numbers,
    }
    with running('tf_parameter', **settings) as probe:
        for k in range(4):
            pose = from_pose(probe.answer(cloud(room(0.1 * k), stamp())).pose.pose)
        moved = se3.transform(np.eye(3), np.array([0.3, 0.0, 0.0]))
        np.testing.assert_allclose(pose, T @ moved @ se3.inverse(T), atol=0.03)
        for name, value in (('extrinsic', [0.1, *numbers[1:]]), ('base_frame', 'base_q')):
            result = probe.set(name, value)
            assert not result.successful
            assert f'read-only parameter: {name}' in result.reason
        again = from_pose(probe.answer(cloud(room(0.3), stamp())).pose.pose)
        np.testing.assert_allclose(again, pose, atol=0.01)
