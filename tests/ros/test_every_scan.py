# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A bag at its own rate: every scan has one answer or a counted reason, by the network mostly."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')
pytest.importorskip(
    'rosbags', reason='rosbags is not installed (pip install hybridreg_ros[replay])'
)
pytest.importorskip('embreex', reason='embreex is not installed (pip install hybridreg_ros[data])')

from diagnostic_msgs.msg import DiagnosticArray
from ros_harness import domain, running

from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.replay.bag_writer import BagWriter
from hybridreg_ros.replay.recording import simulated, write_recording
from hybridreg_ros.ros.conversions import to_ns
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.playback.node_process import LOCALHOST

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.ros

SCANS = 30
LIVE = NodeConfig(input_qos='reliable', diagnostics_period_s=0.1, publish_tf=False)


@pytest.mark.parametrize('scene', ['room', 'street'])
def test_every_scan_is_answered_or_counted(scene: str, tmp_path: Path) -> None:
    path = tmp_path / f'{scene}.mcap'
    with BagWriter(path) as bag:
        write_recording(simulated(scene, SCANS, 10.0, 7, '10-30'), bag)
    with running(scene, OdometryConfig(), LIVE) as probe:
        probe.listen('frame', DiagnosticArray)
        probe.wait(lambda: probe.publishers_matched('frame'), 'the match')
        space = probe.node.get_namespace()
        command = [sys.executable, '-m', 'hybridreg_ros.ros.playback.bag_player', str(path)]
        command += ['--wait', '--qos', 'reliable', '--ros-args', '-r', f'__ns:={space}']
        played = subprocess.run(
            [*command, '-r', '/points:=points'],
            check=False,
            env={**os.environ, **LOCALHOST, 'ROS_DOMAIN_ID': str(domain())},
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert played.returncode == 0, played.stdout + played.stderr

        def dropped() -> int:
            return sum(n for key, n in probe.counters() if key.startswith('dropped.'))

        probe.wait(lambda: len(probe.odometry) + dropped() >= SCANS, 'an end of every scan')
        probe.fresh()
        stamps = [to_ns(message.header.stamp) for message in probe.odometry]
        assert len(set(stamps)) == len(stamps), 'no scan is answered twice'
        assert len(stamps) + dropped() == SCANS
        told = [
            {v.key: v.value for s in message.status for v in s.values}
            for message in probe.received['frame']
        ]
        sources = [frame['source'] for frame in told[1:]]
        assert len(sources) >= 5
        assert sources.count('hybridreg') > 0.5 * len(sources)
