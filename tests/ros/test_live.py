# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""run_live: the bag through the real node gives what the front end gives offline."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')
pytest.importorskip(
    'rosbags', reason='rosbags is not installed (pip install hybridreg_ros[replay])'
)

import numpy as np
from ros_harness import KISS, domain, room

from hybridreg_ros.core.errors import BagError, ConfigError, HybridRegError
from hybridreg_ros.core.pointcloud2 import from_arrays, to_scan
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.replay.bag_reader import open_bag
from hybridreg_ros.replay.bag_writer import BagWriter
from hybridreg_ros.ros.conversions import from_pose, to_ns
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.playback.live import run_live

pytestmark = pytest.mark.ros


def offline(path, topic=None):
    """Results of the front end on a bag, without ROS."""
    front_end = HybridOdometry(KISS, model=None)
    with open_bag(path) as bag:
        return [front_end.step(scan) for scan in bag.scans(topic)]


def test_every_frame_comes_back_and_equals_the_offline_run(bag):
    odom: list[Any] = []
    dynamic: list[Any] = []
    static: list[Any] = []
    frames: list[Any] = []
    report = run_live(
        bag,
        '/lidar/points',
        KISS,
        odom.append,
        dynamic.append,
        static.append,
        frames.append,
        domain_id=domain(),
    )
    expected = offline(bag)
    assert report.sent == report.received_odom == len(odom) == len(expected) == 12
    assert report.received_dynamic == report.received_static == 12
    assert report.missing == 0
    assert not report.dropped
    assert [r.mask_known for r in expected] == [False] * 3 + [True] * 9
    for msg, result, d, s in zip(odom, expected, dynamic, static, strict=True):
        assert to_ns(msg.header.stamp) == result.stamp == to_ns(d.header.stamp)
        np.testing.assert_allclose(from_pose(msg.pose.pose), result.pose, atol=1e-6)
        np.testing.assert_allclose(
            np.array(msg.pose.covariance).reshape(6, 6), result.covariance, atol=1e-9
        )
        moving = result.dynamic_probability >= KISS.dynamics.threshold
        np.testing.assert_array_equal(to_scan(d).points, result.scan.points[moving])
        still = ~moving & result.mask_known  # of the first three nothing can tell what moves
        np.testing.assert_array_equal(to_scan(s).points, result.scan.points[still])
    assert report.received_frames == 12
    for msg, result in zip(frames, expected, strict=True):
        assert to_ns(msg.header.stamp) == result.stamp
        said = {item.key: item.value for item in msg.status[0].values}
        assert (said['source'], said['reason']) == (result.source.value, result.reason.value)
        assert float(said['confidence']) == pytest.approx(result.confidence, abs=1e-6)
        assert float(said['total_ms']) > 0.0


def test_drops_are_reported_and_the_rest_still_equals(tmp_path):
    path = tmp_path / 'odd.mcap'
    with BagWriter(path) as writer:
        for k in range(8):
            data = from_arrays(room(0.05 * k))
            if k == 3:
                data = from_arrays(room(0.05 * k), {})
                data = type(data)(**{**vars(data), 'point_step': 4})
            stamp = 10**12 + (k - (k == 6)) * 10**8
            writer.write_cloud('/points', stamp, 'lidar', data)
    odom: list[Any] = []
    report = run_live(path, None, KISS, odom.append, domain_id=domain())
    assert report.dropped == {'bad_cloud': 1, 'stamp_repeated': 1}
    assert (report.sent, report.received_odom, report.missing) == (8, 6, 0)
    expected = [r for r in offline(path) if r.accepted]
    for msg, result in zip(odom, expected, strict=True):
        np.testing.assert_allclose(from_pose(msg.pose.pose), result.pose, atol=1e-6)


def test_wrong_topic_is_an_error(bag):
    with pytest.raises(BagError, match='has no topic /nothing'):
        run_live(bag, '/nothing', KISS)


def test_wrong_rate_is_an_error(bag):
    with pytest.raises(ConfigError, match='rate: expected >= 0'):
        run_live(bag, None, KISS, rate=float('nan'))


def test_a_node_that_cannot_start_says_why(bag):
    settings = NodeConfig(weights='/nowhere/weights.safetensors')
    with pytest.raises(HybridRegError, match=r'odometry_node exited with code 2: .*nowhere'):
        run_live(bag, None, node_config=settings, domain_id=domain())
