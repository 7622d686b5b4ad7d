# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Angular rates over DDS: they turn the prediction and the deskew, and their end is said."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from diagnostic_msgs.msg import DiagnosticStatus
from ros_harness import FRAME, STEP_NS, Probe, cloud, domain, room, running
from sensor_msgs.msg import Imu

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import Scan
from hybridreg_ros.ros.conversions import from_pose, to_time
from hybridreg_ros.ros.extrinsic import Extrinsic
from hybridreg_ros.ros.guides.guides import Guides
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.qos import profile

pytestmark = pytest.mark.ros

PERIOD_NS = 5_000_000


def turn(yaw: float) -> np.ndarray:
    """(3, 3) about z."""
    return se3.so3_exp(np.array([0.0, 0.0, yaw]))


def rate_message(stamp: int, rate: np.ndarray, frame: str = FRAME) -> Imu:
    """An Imu message with nothing but its angular rate."""
    msg = Imu()
    msg.header.stamp, msg.header.frame_id = to_time(stamp), frame
    w = msg.angular_velocity
    w.x, w.y, w.z = map(float, rate)
    return msg


def test_rates_turn_the_prediction_and_their_end_is_said():
    with running('imu', use_imu=True) as probe:
        imu = probe.node.create_publisher(Imu, 'imu', profile(True, 500))
        probe.wait(imu.get_subscription_count, 'the match')
        yaws = [0.0, 0.0, 0.5, 1.0, 1.0, 0.4]
        stamps = [(10 + k) * STEP_NS for k in range(len(yaws))]
        probe.answer(cloud(room(), stamps[0]))
        for (since, until), (before, yaw) in zip(pairwise(stamps), pairwise(yaws), strict=True):
            rate = np.array([0.0, 0.0, (yaw - before) * 1e9 / STEP_NS])
            for stamp in range(since + PERIOD_NS // 2, until + PERIOD_NS, PERIOD_NS):
                imu.publish(rate_message(stamp, rate))
            probe.fresh()
            pose = from_pose(probe.answer(cloud(room() @ turn(yaw), until)).pose.pose)
            np.testing.assert_allclose(pose[:3, :3], turn(yaw), atol=0.02)
        probe.wait(lambda: probe.values['imu'] == 'used', 'the rates')
        probe.answer(cloud(room() @ turn(0.4), stamps[-1] + STEP_NS))
        text = 'without imu: no angular rates on imu at the time'
        probe.wait(lambda: text in probe.text, 'the warning')
        assert probe.level == DiagnosticStatus.WARN


@pytest.fixture
def client():
    """A node of the test, to hear what it sends itself."""
    probe = Probe(f'/imu_parts_{domain()}')
    yield probe
    probe.close()


def guides_of(client, **changes) -> Guides:
    """Guides of a node of the test."""
    config = NodeConfig(use_imu=True, **changes)
    return Guides(client.node, config, Extrinsic(client.node, config))


def heard(client, guides: Guides, rates: dict[int, np.ndarray], frame: str = FRAME) -> None:
    """Publish rates until the guides have heard the last one."""
    imu = client.node.create_publisher(Imu, 'imu', profile(True, 500))
    client.wait(imu.get_subscription_count, 'the match')
    for stamp, rate in rates.items():
        imu.publish(rate_message(stamp, rate, frame))
    gyro = guides._gyro
    assert gyro is not None
    client.wait(lambda: gyro._samples and gyro._samples[-1].stamp == max(rates), 'the rates')


def test_turn_of_a_rate_that_grows_and_mean_rate_of_a_scan(client):
    guides = guides_of(client)
    motion = guides.motion()
    rates = {k * PERIOD_NS: np.array([0.0, 0.0, 0.01 * k]) for k in range(1, 101)}
    heard(client, guides, rates)
    scan = Scan(np.ones((3, 3)), np.array([0.0, 0.05, 0.1]), stamp=200_000_000, frame_id=FRAME)
    guides.begin(scan)
    np.testing.assert_allclose(motion.twist, [0, 0, 0, 0, 0, 0.5], atol=1e-9)
    motion.stop(100_000_000)
    grown = (0.4**2 - 0.1**2) / 2 * 0.01 / 0.005  # integral of 2 t from 0.1 to 0.4 s
    np.testing.assert_allclose(motion.predict(400_000_000)[:3, :3], turn(grown), atol=1e-9)
    assert guides.states['imu'] == 'used'


@pytest.mark.parametrize(
    ('frame', 'rates', 'text'),
    [
        ('elsewhere', range(1, 101), f'no transform from {FRAME} to elsewhere on /tf_static'),
        (FRAME, range(1, 30), 'no angular rates on imu at the time'),
        (FRAME, (*range(1, 40), *range(60, 101)), 'no angular rates on imu at the time'),
    ],
    ids=['no transform', 'ended', 'gap'],
)
def test_what_is_not_known_leaves_constant_velocity(client, frame, rates, text):
    guides = guides_of(client)
    motion = guides.motion()
    heard(client, guides, {k * PERIOD_NS: np.ones(3) for k in rates}, frame)
    guides.begin(Scan(np.ones((3, 3)), stamp=200_000_000, frame_id=FRAME))
    motion.stop(100_000_000)
    np.testing.assert_array_equal(motion.predict(400_000_000), np.eye(4))
    assert guides.states['imu'] == text
