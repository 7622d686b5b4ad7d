# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""colcon build and colcon test in a workspace of their own; the installed executables run."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CONTENT = (
    'package.xml',
    'setup.py',
    'setup.cfg',
    'pyproject.toml',
    'README.md',
    'LICENSE',
    'hybridreg_ros',
    'resource',
    'config',
    'launch',
    'rviz',
)

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec('colcon_ros') is None,
        reason='colcon is not installed (pip install colcon-common-extensions==0.3.0)',
    ),
]


def run(command: list[str], folder: Path, expected: int = 0) -> str:
    """Output of a command that must end with the expected code."""
    environment = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
    )
    output = done.stdout + done.stderr
    assert done.returncode == expected, output
    return output


@pytest.fixture(scope='module')
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace with the package, built."""
    folder = tmp_path_factory.mktemp('ws')
    package = folder / 'src' / 'hybridreg_ros'
    package.mkdir(parents=True)
    skip = shutil.ignore_patterns('__pycache__', '*.pyc')
    for name in CONTENT:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, package / name, ignore=skip)
        else:
            shutil.copy2(source, package / name)
    for name in ('conftest.py', 'core', 'ros/test_messages.py'):
        target = package / 'tests' / name
        target.parent.mkdir(parents=True, exist_ok=True)
        source = ROOT / 'tests' / name
        if source.is_dir():
            shutil.copytree(source, target, ignore=skip)
        else:
            shutil.copy2(source, target)
    run([sys.executable, '-m', 'colcon', 'build'], folder)
    return folder


def test_files_are_where_ros_looks_for_them(workspace):
    base = workspace / 'install' / 'hybridreg_ros'
    for name in (
        'share/hybridreg_ros/package.xml',
        'share/hybridreg_ros/launch/odometry.launch.py',
        'share/hybridreg_ros/launch/replay.launch.py',
        'share/hybridreg_ros/rviz/odometry.rviz',
        'share/hybridreg_ros/config/odometry.yaml',
        'share/hybridreg_ros/config/node.yaml',
        'share/ament_index/resource_index/packages/hybridreg_ros',
        'lib/hybridreg_ros/odometry_node',
        'lib/hybridreg_ros/bag_player',
    ):
        assert (base / name).is_file(), name
    assert list(base.rglob('ros/fastdds_shm.xml'))


def test_installed_executables_run(workspace):
    lib = workspace / 'install' / 'hybridreg_ros' / 'lib' / 'hybridreg_ros'
    config = workspace / 'install' / 'hybridreg_ros' / 'share' / 'hybridreg_ros' / 'config'

    def sourced(command: str, expected: int) -> str:
        line = f'source install/setup.bash && {command}'
        return run(['bash', '-c', line], workspace, expected)

    assert 'rosbag2' in sourced(f'{lib}/bag_player --help', 0)
    files = f'--params-file {config}/odometry.yaml --params-file {config}/node.yaml'
    started = f'timeout -s INT 8 {lib}/odometry_node --ros-args {files} -p registrar:=kiss-icp'
    assert 'subscribed to /points' in sourced(started, 124)
    refused = sourced(f'{lib}/odometry_node --ros-args {files} -p queue_dept:=3', 2)
    assert 'unknown parameter queue_dept' in refused
    where = sourced('python3 -c "import hybridreg_ros; print(hybridreg_ros.__file__)"', 0)
    assert str(workspace / 'install') in where


def test_colcon_test_passes(workspace):
    run([sys.executable, '-m', 'colcon', 'test', '--return-code-on-test-failure'], workspace)
    result = run([sys.executable, '-m', 'colcon', 'test-result', '--all'], workspace)
    total = int(result.split('Summary: ')[1].split()[0])
    assert total > 50
    assert '0 errors, 0 failures' in result
