# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The commands of the README's first run, as they stand there, in two shells."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')
pytest.importorskip(
    'rosbags', reason='rosbags is not installed (pip install hybridreg_ros[replay])'
)

from ros_harness import domain

from hybridreg_ros.ros.playback.node_process import LOCALHOST

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(
        not (Path(sys.executable).parent / 'odometry_node').exists(),
        reason='the executables are not installed beside this Python',
    ),
]

ROOT = Path(__file__).resolve().parents[2]


def shell(text: str, folder: Path, environment: dict[str, str]) -> subprocess.Popen[str]:
    """A terminal with the environment's executables, in its own group."""
    return subprocess.Popen(
        [shutil.which('bash') or 'sh', '-c', text],
        cwd=folder,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )


def test_the_page_leads_to_odometry(tmp_path):
    page = (ROOT / 'README.md').read_text(encoding='utf-8')
    section = page[page.index('## First run') : page.index('## Use it')]
    node, player = re.findall(r'```\n(.*?)```', section, re.DOTALL)
    environment = {
        **os.environ,
        **LOCALHOST,
        'ROS_DOMAIN_ID': str(domain()),
        'PYTHONPATH': str(ROOT),
        'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}',
    }
    shells = [shell(node, tmp_path, environment), shell(player, tmp_path, environment)]
    try:
        assert shells[1].stdout is not None
        lines: list[str] = []
        while sum(' m  yaw ' in text for text in lines) < 3:
            lines.append(shells[1].stdout.readline())
            assert lines[-1], ''.join(lines)
    finally:
        for process in shells:
            os.killpg(process.pid, signal.SIGTERM)
    for process in shells:
        output, _ = process.communicate(timeout=60)
        assert 'Traceback' not in output
