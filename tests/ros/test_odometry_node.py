# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The node over real DDS: clouds in; odometry, stamps, frames, services and diagnostics out."""

from __future__ import annotations

import time
from itertools import count
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Path
from ros_harness import FRAME, STEP_NS, cloud, room, running
from scipy.spatial import cKDTree
from sensor_msgs.msg import PointCloud2

from hybridreg_ros.core import se3
from hybridreg_ros.core.pointcloud2 import field_values, to_scan
from hybridreg_ros.data.loaders.clouds import read_cloud
from hybridreg_ros.ros.conversions import from_pose, to_ns, to_pose
from hybridreg_ros.ros.qos import profile
from hybridreg_ros.ros.transforms import pose_matrix

pytestmark = pytest.mark.ros

_stamps = count(10 * STEP_NS, STEP_NS)


@pytest.fixture(scope='module')
def probe():
    """One node for the module."""
    with running('node') as p:
        yield p


def stamp() -> int:
    """The next stamp, ns."""
    return next(_stamps)


def test_odometry_follows_the_motion(probe):
    probe.call('reset')
    msgs = [probe.answer(cloud(room(0.05 * k), stamp())).pose for k in range(6)]
    first = np.reshape(msgs[0].covariance, (6, 6))
    assert (np.linalg.eigvalsh(first) > 0).all()  # zeros would say that nothing is known of it
    poses = [m.pose.position for m in msgs]
    x = np.array([p.x for p in poses])
    assert np.abs(x - 0.05 * np.arange(6)).max() < 0.02
    assert max(abs(p.y) + abs(p.z) for p in poses) < 0.03


def test_stamp_frames_and_covariance(probe):
    s = stamp()
    msg = probe.answer(cloud(room(), s))
    assert msg.header.stamp.sec * 10**9 + msg.header.stamp.nanosec == s
    assert (msg.header.frame_id, msg.child_frame_id) == ('odom', FRAME)
    pose = np.array(msg.pose.covariance).reshape(6, 6)
    assert (np.linalg.eigvalsh(pose) > 0).all()
    assert (np.diag(np.array(msg.twist.covariance).reshape(6, 6)) > 0).all()


def test_lever_arm_free_twist_is_in_the_child_frame(probe):
    probe.call('reset')
    msgs = [probe.answer(cloud(room(0.05 * k), stamp())) for k in range(5)]
    v = msgs[-1].twist.twist.linear
    assert v.x == pytest.approx(0.5, abs=0.15)  # 5 cm in 0.1 s
    assert abs(v.y) + abs(v.z) < 0.15


def test_no_return_is_in_no_output(probe):
    """2,000 points at the sensor and 50 on its housing are counted; none of them goes out."""
    listen_to_clouds(probe)
    before = (probe.count('near_points'), probe.count('invalid_points'))
    points = np.concatenate([np.zeros((2000, 3)), room(0.05), np.full((50, 3), 0.2)])
    msg = cloud(points.astype(np.float32), stamp())
    probe.answer(msg)
    s = to_ns(msg.header.stamp)
    clouds = [
        probe.wait(lambda topic=topic: probe.at(s, topic), topic)
        for topic in ('static_points', 'dynamic_points')
    ]
    out = np.concatenate([to_scan(m).points for m in clouds])
    assert sum(m.width for m in clouds) == len(out) == len(room(0.05))
    assert np.linalg.norm(out, axis=1).min() > 0.5
    probe.wait(lambda: probe.count('near_points') == before[0] + 2050, 'the count')
    assert probe.count('invalid_points') == before[1]


def listen_to_clouds(probe):
    if 'static_points' not in probe.received:
        probe.listen('static_points', PointCloud2)
        probe.listen('dynamic_points', PointCloud2)
    probe.wait(lambda: probe.publishers_matched('static_points', 'dynamic_points'), 'the match')


def test_dynamic_and_static_points_partition_the_input(probe):
    listen_to_clouds(probe)
    points = room()
    points[::10] = np.nan
    s = stamp()
    marks = np.arange(len(points), dtype=np.uint32)
    msg = cloud(points, s, number=marks)
    probe.answer(msg)
    parts = [
        probe.wait(lambda t=topic: probe.at(s, t), topic)
        for topic in ('static_points', 'dynamic_points')
    ]
    numbers = np.concatenate([field_values(p, 'number') for p in parts])
    valid = marks[np.isfinite(points).all(axis=1)]
    np.testing.assert_array_equal(np.sort(numbers), valid)
    for part in parts:
        assert part.header.frame_id == FRAME
        assert [f.name for f in part.fields] == ['x', 'y', 'z', 'number', 'dynamic_probability']
    static = to_scan(parts[0])
    np.testing.assert_array_equal(static.points, points[field_values(parts[0], 'number')])
    assert (field_values(parts[0], 'dynamic_probability') < 0.5).all()
    assert (field_values(parts[1], 'dynamic_probability') >= 0.5).all()


def test_best_effort_publishers_are_heard(probe):
    publisher = probe.node.create_publisher(PointCloud2, 'points', profile(False, 50))
    probe.wait(publisher.get_subscription_count, 'the match')
    sent: list[Any] = []

    def heard() -> bool:
        """One cloud a second until one is answered: what comes before both ends match is lost."""
        if not sent or time.monotonic() - sent[-1][0] > 1.0:
            sent.append((time.monotonic(), stamp()))
            publisher.publish(cloud(room(), sent[-1][1]))
        return any(probe.at(s) for _, s in sent)

    probe.wait(heard, 'odometry')
    probe.node.destroy_publisher(publisher)


def test_diagnostics_are_ok_and_count(probe):
    before = probe.count('processed')
    for _ in range(3):
        probe.answer(cloud(room(), stamp()))
    probe.wait(lambda: probe.count('processed') >= before + 3, 'the count')
    probe.wait(lambda: probe.level == DiagnosticStatus.OK, 'level OK')
    assert probe.text == 'ok'
    assert probe.values['source'] == 'kiss_icp'
    assert probe.values['reason'] == 'registrar_kiss_icp'
    assert probe.values['weights'] == 'not used: registrar kiss-icp'
    assert float(probe.values['latency_ms']) > 0.0
    assert 0.0 < float(probe.values['confidence']) <= 1.0
    assert 'shared memory' in probe.values['transport']


def test_silence_is_a_warning(probe):
    probe.answer(cloud(room(), stamp()))
    probe.wait(lambda: probe.level == DiagnosticStatus.WARN, 'a warning', 5.0)
    assert 'no cloud for' in probe.text
    assert probe.values['source'] == 'kiss_icp'


def test_pause_counts_and_resume_goes_on(probe):
    paused = probe.count('dropped.paused')
    assert probe.call('pause').success
    probe.send(cloud(room(), stamp()))
    probe.wait(lambda: probe.count('dropped.paused') == paused + 1, 'the drop')
    assert 'paused' in probe.text
    assert probe.level == DiagnosticStatus.WARN
    assert probe.call('resume').success
    probe.answer(cloud(room(), stamp()))


def test_reset_starts_at_the_origin(probe):
    for k in range(4):
        probe.answer(cloud(room(0.1 * k), stamp()))
    assert probe.call('reset').message == 'pose and map cleared'
    p = probe.answer(cloud(room(1.0), stamp())).pose.pose.position
    assert (p.x, p.y, p.z) == (0.0, 0.0, 0.0)


def test_keyframe_and_path_on_request(probe):
    probe.listen('keyframe', PointCloud2)
    probe.listen('path', Path)
    assert probe.set('publish_keyframe', True).successful
    assert probe.set('publish_path', True).successful
    probe.wait(lambda: probe.publishers_matched('keyframe', 'path'), 'the match')
    probe.call('reset')
    first, second = stamp(), stamp()
    probe.answer(cloud(room(), first))
    probe.answer(cloud(room(0.05), second))
    probe.wait(lambda: probe.at(first, 'keyframe'), 'the keyframe')
    path = probe.wait(lambda: probe.at(second, 'path'), 'the path')
    assert [to_ns(p.header.stamp) for p in path.poses] == [first, second]
    assert path.header.frame_id == 'odom'
    assert probe.set('publish_path', False).successful


def test_a_change_is_applied_to_the_next_cloud(probe):
    assert probe.set('odom_frame', 'odom_2').successful
    assert probe.answer(cloud(room(), stamp())).header.frame_id == 'odom_2'
    assert probe.set('odom_frame', 'odom').successful


START = (1.0, -2.0, 0.5, 0.0, 0.0, np.sin(0.5), np.cos(0.5))


def stand_and_step(probe) -> list[np.ndarray]:
    """Poses (4, 4) of a scan and of one from 0.1 m ahead."""
    return [from_pose(probe.answer(cloud(room(x), stamp())).pose.pose) for x in (0.0, 0.1)]


def test_reset_to_pose_begins_at_the_parameter(probe):
    assert probe.set('initial_pose', list(START)).successful
    assert 'pose is 1 -2 0.5' in probe.call('reset_to_pose').message
    first, second = stand_and_step(probe)
    T = pose_matrix(START)
    np.testing.assert_allclose(first, T, atol=1e-9)
    ahead = se3.transform(np.eye(3), np.array([0.1, 0.0, 0.0]))
    np.testing.assert_allclose(second, T @ ahead, atol=0.02)
    probe.call('reset')
    np.testing.assert_allclose(stand_and_step(probe)[0], np.eye(4), atol=1e-9)
    result = probe.set('initial_pose', [0.0] * 7)
    assert 'initial_pose: expected a unit quaternion' in result.reason


def test_initial_pose_by_topic(probe):
    stand_and_step(probe)
    publisher = probe.node.create_publisher(
        PoseWithCovarianceStamped, 'hybridreg/initial_pose', profile(True, 10)
    )
    probe.wait(publisher.get_subscription_count, 'the match')
    msg = PoseWithCovarianceStamped()
    msg.header.frame_id = 'map'
    publisher.publish(msg)  # another frame and no rotation: warned of and not taken
    msg.header.frame_id, msg.pose.pose = 'odom', to_pose(pose_matrix(START))
    before = from_pose(probe.answer(cloud(room(0.1), stamp())).pose.pose)
    np.testing.assert_allclose(before[:3, 3], [0.1, 0.0, 0.0], atol=0.02)
    publisher.publish(msg)

    def taken() -> bool:
        pose = from_pose(probe.answer(cloud(room(), stamp())).pose.pose)
        return np.allclose(pose, pose_matrix(START), atol=0.02)

    probe.wait(taken, 'the pose')
    assert 'initial_pose: ' in probe.process.log.read_text()


def test_map_is_published_and_saved_in_the_odom_frame(probe, tmp_path):
    assert probe.set('initial_pose', list(START)).successful
    assert probe.set('local_map_period_s', 0.05).successful
    probe.call('reset_to_pose')
    probe.listen('local_map', PointCloud2)
    probe.wait(lambda: probe.publishers_matched('local_map'), 'the match')
    for k in range(3):
        time.sleep(0.06)  # the period: a map sooner after the last one is left out
        s = stamp()
        probe.answer(cloud(room(0.05 * k), s))
        probe.wait(lambda s=s: probe.at(s, 'local_map'), 'the map')
    message = probe.at(s, 'local_map')
    assert message.header.frame_id == 'odom'
    shown = to_scan(message).points
    wall = room()[::10]
    there = se3.apply(pose_matrix(START), wall)
    near = cKDTree(shown).query(there)[0]
    assert np.median(near) < 0.1
    for name in ('map.ply', 'map.pcd'):
        path = tmp_path / name
        assert probe.set('map_file', str(path)).successful
        answer = probe.call('save_map')
        assert (answer.success, answer.message) == (True, f'{len(shown)} points in {path}')
        np.testing.assert_allclose(read_cloud(path), shown, atol=1e-5)
    assert probe.set('map_file', '/nowhere/map.ply').successful
    refused = probe.call('save_map')
    assert not refused.success
    assert 'cannot write /nowhere/map.ply' in refused.message
