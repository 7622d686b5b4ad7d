# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""QoS over real DDS: the automatic choice, the warning on a mismatch, counted losses."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from ros_harness import STEP_NS, Probe, cloud, room
from sensor_msgs.msg import PointCloud2

from hybridreg_ros.ros.clouds.subscription import CloudSubscription
from hybridreg_ros.ros.qos import all_reliable, profile

pytestmark = pytest.mark.ros


@pytest.fixture(scope='module')
def probe():
    """A node to put subscriptions and publishers into; its own publisher is removed."""
    p = Probe(f'/qos_{os.getpid()}')
    p.node.destroy_publisher(p.points)
    p.wait(lambda: not p.node.count_publishers(f'/qos_{os.getpid()}/points'), 'an empty topic')
    yield p
    p.close()


def test_auto_follows_the_publishers(probe):
    node = probe.node
    got: list[Any] = []
    subscription = CloudSubscription(node, ('points', 'auto', 10), got.append, lambda _: None)
    assert subscription.state == 'waiting for a publisher'
    assert all_reliable(node, subscription.topic) is None
    first = node.create_publisher(PointCloud2, 'points', profile(True, 10))
    probe.wait(lambda: subscription.state == 'reliable', 'reliable')
    second = node.create_publisher(PointCloud2, 'points', profile(False, 10))
    probe.wait(lambda: subscription.state == 'best_effort', 'best effort')
    probe.wait(lambda: first.get_subscription_count() and second.get_subscription_count(), 'match')
    probe.wait(lambda: second.publish(cloud(room(), STEP_NS)) or got, 'a cloud')
    node.destroy_publisher(second)
    probe.wait(lambda: subscription.state == 'reliable', 'reliable again')
    node.destroy_publisher(first)
    subscription.close()


def test_a_mismatch_is_one_clear_warning(probe, capfd):
    node = probe.node
    publisher = node.create_publisher(PointCloud2, 'points', profile(False, 10))
    subscription = CloudSubscription(
        node, ('points', 'reliable', 10), lambda _: None, lambda _: None
    )
    text = []

    def warned() -> bool:
        text.append(capfd.readouterr().err)
        return 'a publisher of' in ''.join(text)

    probe.wait(warned, 'the warning')
    probe.node.destroy_publisher(publisher)
    lines = [n for n in ''.join(text).splitlines() if 'a publisher of' in n]
    assert len(lines) == 1, lines
    assert '/points offers an incompatible RELIABILITY' in lines[0]
    assert 'set input_qos to sensor_data or auto' in lines[0]
    subscription.close()


def test_what_a_full_history_overwrites_is_counted(probe):
    node = probe.node
    got: list[Any] = []
    lost: list[Any] = []

    def slow(msg: PointCloud2) -> None:
        got.append(msg.header.stamp.sec)
        time.sleep(0.3 if len(got) == 1 else 0.0)

    subscription = CloudSubscription(node, ('points', 'sensor_data', 2), slow, lost.append)
    publisher = node.create_publisher(PointCloud2, 'points', profile(False, 100))
    probe.wait(publisher.get_subscription_count, 'the match')
    for k in range(1, 21):
        publisher.publish(cloud(room(count=20), k * 10**9))
        time.sleep(0.005)
    probe.wait(lambda: got and got[-1] == 20, 'the last cloud')
    assert len(got) < 20
    assert len(got) + sum(lost) == 20
    node.destroy_publisher(publisher)
    subscription.close()


@pytest.mark.slow
def test_full_size_clouds_reach_the_node_without_a_loss():
    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.ros.playback.transport_check import check_transport

    report = check_transport(300, 10.0, 120_000, OdometryConfig(registrar='kiss-icp'))
    assert report.cloud_bytes >= 120_000 * 32
    # A machine too busy to keep 10 Hz itself measures its scheduler, not the transport.
    if report.late > 30:
        pytest.skip(f'{report.late} of 300 clouds could not even be published in time')
    assert report.lost == 0
    assert 'lost_in_transport' not in report.dropped
    assert report.odometry + sum(report.dropped.values()) == 300


@pytest.mark.slow
def test_losses_of_the_default_transport_are_counted():
    environment = {k: v for k, v in os.environ.items() if 'PROFILES_FILE' not in k}
    command = [
        sys.executable,
        '-m',
        'hybridreg_ros.ros.playback.transport_check',
        '--frames',
        '40',
    ]
    done = subprocess.run(
        [*command, '--registrar', 'kiss-icp'],
        env={**environment, 'HYBRIDREG_FASTDDS': 'off'},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    assert "'lost_in_transport': " in done.stderr


def test_many_small_clouds_reach_the_node():
    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.ros.playback.transport_check import check_transport, hall

    assert np.isfinite(hall(100)).all()
    report = check_transport(20, 40.0, 30_000, OdometryConfig(registrar='kiss-icp'))
    assert report.lost == 0
    assert report.odometry + sum(report.dropped.values()) == 20
