# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""After a warm-up nothing is left to compile in ordinary operation."""

from __future__ import annotations

import subprocess
import sys

CODE = """
import sys
from numba.core.dispatcher import Dispatcher
from hybridreg_ros import HybridOdometry
from hybridreg_ros.core import jit
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.map import local_map
from hybridreg_ros.odometry.network_branch import load
from hybridreg_ros.odometry.warm_up import warm_up
from tiny_world import ROOM, depth_rays, lidar_rays, scans, walk

def variants():
    return {
        (function.py_func.__name__, signature)
        for name, module in list(sys.modules.items()) if name.startswith('hybridreg_ros')
        for function in vars(module).values() if isinstance(function, Dispatcher)
        for signature in function.signatures
    }

model = load('auto')
steps = list(warm_up(OdometryConfig(), model))
assert jit.is_filled() and len(steps) == len(set(steps)) and len(steps) > 8, steps
known = variants()
local_map._START_VOXELS, local_map._START_POINTS = 64, 512  # so that the map outgrows its tables
way = walk(16)
jump = [*way[:5], *way[12:]]
for branch in (None, model):
    for rays in (lidar_rays(), depth_rays()):
        front_end = HybridOdometry(OdometryConfig(), model=branch)
        first = scans(jump, rays)[:3]
        for scan in (*first, *scans(jump, rays, (*ROOM[:1], *ROOM[2:]))[3:]):  # a box has gone
            front_end.step(scan)
print('more', sorted({name for name, _ in variants() - known}))
"""


def test_no_kernel_and_no_variant_of_one_is_new_after_the_warm_up(request):
    """Also where a map grows, a thing goes away, and the sensor is found elsewhere."""
    tests = str(request.path.parent)
    done = subprocess.run(
        [sys.executable, '-c', f'import sys; sys.path.insert(0, {tests!r})' + CODE],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == 'more []', done.stdout
