# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""bag_player as users start it: topics, rate, /clock, QoS, waiting, errors."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')
pytest.importorskip(
    'rosbags', reason='rosbags is not installed (pip install hybridreg_ros[replay])'
)

from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from ros_harness import QUICK, Probe, domain, running
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2

from hybridreg_ros.ros.conversions import to_ns
from hybridreg_ros.ros.playback.bag_player import main
from hybridreg_ros.ros.playback.node_process import LOCALHOST
from hybridreg_ros.ros.qos import profile

pytestmark = pytest.mark.ros

START_NS, STEP_NS = 1_000_000_000_000, 100_000_000


def start(bag, *arguments: str, ros: tuple[str, ...] = ()) -> subprocess.Popen[str]:
    """The player in its own process."""
    command = [sys.executable, '-m', 'hybridreg_ros.ros.playback.bag_player', str(bag), *arguments]
    environment = {**os.environ, **LOCALHOST, 'ROS_DOMAIN_ID': str(domain())}
    return subprocess.Popen(
        [*command, '--ros-args', *ros],
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )


def finish(process: subprocess.Popen[str], timeout_s: float = 120.0) -> tuple[int, str]:
    """Exit code and output."""
    output, _ = process.communicate(timeout=timeout_s)
    return process.returncode, output


@pytest.fixture
def listener():
    """A probe in a namespace without any odometry node."""
    probe = Probe(f'/player_{os.getpid()}_{time.monotonic_ns() % 100_000}')
    yield probe
    probe.close()


def collect(probe, topic: str, kind: type, reliable: bool = True) -> list:
    """Messages of a topic of the player."""
    kept: list = []
    probe.node.create_subscription(kind, topic, kept.append, profile(reliable, 100))
    return kept


def test_plays_every_message_in_order_with_clock(bag, listener):
    space = listener.node.get_namespace()
    clouds = collect(listener, 'cloud', PointCloud2)
    truth = collect(listener, 'ground_truth/odom', Odometry)
    clock = collect(listener, '/clock', Clock)
    began = time.monotonic()
    process = start(
        bag,
        '--wait',
        '--clock',
        '50',
        '--rate',
        '2',
        ros=('-r', f'__ns:={space}', '-r', 'lidar/points:=cloud'),
    )
    code, output = finish(process)
    assert code == 0, output
    assert '/lidar/points 12' in output
    listener.wait(lambda: len(clouds) == 12 and len(truth) == 12, 'all messages')
    assert [to_ns(m.header.stamp) for m in clouds] == [START_NS + k * STEP_NS for k in range(12)]
    assert time.monotonic() - began > 1.1 / 2
    times = [to_ns(c.clock) for c in clock]
    assert times == sorted(times)
    assert len(times) > 10
    assert times[0] <= START_NS + STEP_NS
    assert times[-1] <= START_NS + 11 * STEP_NS


def test_sensor_data_qos_is_offered(bag, listener):
    space = listener.node.get_namespace()
    clouds = collect(listener, 'lidar/points', PointCloud2, reliable=False)
    process = start(
        bag,
        '--wait',
        '--qos',
        'sensor_data',
        '--topics',
        '/lidar/points',
        '--duration',
        '0.55',
        ros=('-r', f'__ns:={space}'),
    )
    topic = f'{space}/lidar/points'
    infos = listener.wait(lambda: listener.node.get_publishers_info_by_topic(topic), 'the player')
    assert infos[0].qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    code, output = finish(process)
    assert code == 0, output
    assert '/lidar/points 6' in output
    assert len(clouds) == 6


def test_lossless_into_the_node_with_a_short_queue(bag):
    with running('lossless', node_config=QUICK, queue_depth=2) as probe:
        space = probe.node.get_namespace()
        process = start(
            bag,
            '--rate',
            '0',
            '--lossless',
            ros=('-r', f'__ns:={space}', '-r', 'lidar/points:=points'),
        )
        code, output = finish(process)
        assert code == 0, output
        probe.wait(lambda: len(probe.odometry) == 12, 'all odometry')
        probe.fresh()
        assert probe.count('dropped') == 0


@pytest.mark.parametrize(
    ('arguments', 'text'),
    [
        (('--topics', '/nothing'), 'has no topic /nothing; found: /ground_truth/odom'),
        (('--rate', '-1'), '--rate: expected >= 0, found -1.0'),
        (('--rate', '0'), '--rate 0 needs --lossless'),
        (('--lossless', '--qos', 'sensor_data'), '--lossless needs --qos reliable'),
        (('--wait', '0.3'), 'nobody subscribed to /lidar/points within 0.3 s'),
    ],
)
def test_errors_are_one_line_and_code_2(bag, arguments, text, capfd, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain()))
    assert main([str(bag), *arguments]) == 2
    lines = [n for n in capfd.readouterr().err.splitlines() if n.startswith('bag_player: ')]
    assert len(lines) == 1
    assert text in lines[0]


def test_nobody_listening_is_said_and_is_an_error(bag, listener):
    waiting = collect(listener, 'elsewhere', PointCloud2)
    space = listener.node.get_namespace()
    code, output = finish(start(bag, '--rate', '5', ros=('-r', f'__ns:={space}')))
    topic = f'{space}/lidar/points'
    assert code == 2, output
    assert f'nobody listens to {topic} yet; --wait waits' in output
    assert f'bag_player: nobody listened to {topic} while it was played' in output
    rule = f'{topic}:={space}/elsewhere'
    assert f'{space}/elsewhere waits for clouds: add --ros-args -r {rule}' in output
    ros = ('-r', f'__ns:={space}', '-r', rule)
    code, output = finish(start(bag, '--rate', '5', '--wait', ros=ros))
    assert code == 0, output
    assert '0 clouds unheard' in output
    assert len(waiting) == 12


def test_no_bag_is_an_error_in_a_process_of_its_own(tmp_path):
    code, output = finish(start(tmp_path / 'none.mcap'))
    assert (code, 'no bag at' in output) == (2, True)
    assert 'Traceback' not in output


def test_interrupt_ends_a_loop_quietly(bag, listener):
    space = listener.node.get_namespace()
    clouds = collect(listener, 'lidar/points', PointCloud2)
    process = start(bag, '--loop', '--wait', '--rate', '5', ros=('-r', f'__ns:={space}'))
    listener.wait(lambda: len(clouds) > 15, 'the second round')
    latched = listener.node.get_publishers_info_by_topic(f'{space}/tf_static')
    if importlib.util.find_spec('tf2_msgs'):
        assert latched[0].qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    process.send_signal(signal.SIGINT)
    code, output = finish(process)
    assert code == 0, output
    assert 'Traceback' not in output
