# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""After a warm-up nothing is left to compile in ordinary operation."""

from __future__ import annotations

import subprocess
import sys

CODE = """
from numba.core import event
from hybridreg_ros import HybridOdometry, Scan
from hybridreg_ros.core import jit
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.network_branch import load
from hybridreg_ros.odometry.warm_up import warm_up
from tiny_world import lidar_rays, scans, walk
model = load('auto')
steps = list(warm_up(OdometryConfig(), model))
assert jit.is_filled() and len(steps) == len(set(steps)) and len(steps) > 8, steps
with event.install_recorder('numba:compile') as recorder:
    front_end = HybridOdometry(OdometryConfig(), model=load('auto'))
    for scan in scans(walk(5), lidar_rays()):
        front_end.step(scan)
print('compiled', len({e.data['dispatcher'].py_func.__name__ for _, e in recorder.buffer}))
"""


def test_nothing_is_compiled_after_the_warm_up(request):
    tests = str(request.path.parent)
    done = subprocess.run(
        [sys.executable, '-c', f'import sys; sys.path.insert(0, {tests!r})' + CODE],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-2:] == ['compiled', '0'], done.stdout
