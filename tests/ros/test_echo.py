# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg echo` prints what a node publishes, and says when nothing comes."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from nav_msgs.msg import Odometry
from ros_harness import STEP_NS, cloud, domain, room, running

from hybridreg_ros.odometry.result import LOST_VARIANCE
from hybridreg_ros.ros.playback.echo import line
from hybridreg_ros.ros.playback.node_process import LOCALHOST

pytestmark = pytest.mark.ros


def start(*arguments: str) -> subprocess.Popen[str]:
    """The command in its own process."""
    return subprocess.Popen(
        [sys.executable, '-m', 'hybridreg_ros.cli.main', 'echo', *arguments],
        env={**os.environ, **LOCALHOST, 'ROS_DOMAIN_ID': str(domain())},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def test_a_lost_pose_is_marked():
    msg = Odometry()
    msg.header.stamp.sec, msg.header.stamp.nanosec = 3, 250_000_000
    msg.pose.pose.orientation.w = 1.0
    msg.pose.covariance = np.diag(np.full(6, 1e-4)).ravel()
    assert line(msg) == ('3.250 s  x 0.000  y 0.000  z 0.000 m  yaw 0.0 deg  0.00 m/s  +-10.0 mm')
    msg.pose.covariance = np.diag(np.full(6, LOST_VARIANCE)).ravel()
    assert line(msg).endswith('lost: not to be used')


def test_prints_messages_and_findings(tmp_path):
    with running('echo') as probe:
        name = f'{probe.node.get_namespace()}/hybridreg'.lstrip('/')
        path = tmp_path / 'result.json'
        process = start('--node', name, '--count', '3', '--json', str(path))
        topic = f'/{name}/odom'
        probe.wait(lambda: probe.node.count_subscribers(topic) >= 2, 'the command')
        probe.fresh()
        end = time.monotonic() + 60.0
        for k in itertools.count(1):  # the command may find the node later than this test does
            if process.poll() is not None or time.monotonic() > end:
                break
            probe.answer(cloud(room(0.05 * (k % 8)), k * STEP_NS))
        output, errors = process.communicate(timeout=60)
        lines = output.splitlines()
        assert process.returncode == 0, errors
        assert len(lines) == 3
        assert all(' s  x ' in text and ' m/s  +-' in text for text in lines)
        assert json.loads(path.read_text())['messages'] == 3
        process = start('--node', name)
        probe.wait(lambda: probe.level != b'\x00', 'silence')
        assert process.stderr is not None
        assert 'no cloud for' in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
        assert process.returncode == 0


def test_nothing_is_one_line_and_code_2():
    process = start('--wait', '0.5', '--node', '/nowhere/hybridreg')
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert errors == (
        'hybridreg: error: nothing on /nowhere/hybridreg/odom for 0.5 s: no node publishes it\n'
    )
