# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg warm-up`: compile all kernels once, after an installation or an update."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from hybridreg_ros.cli.common import write_result
from hybridreg_ros.core import jit
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.network_branch import load
from hybridreg_ros.odometry.warm_up import warm_up

if TYPE_CHECKING:
    import argparse


def run(args: argparse.Namespace) -> int:
    """Run every branch of the front end on a made-up room, and say how far it is."""
    start, filled = time.perf_counter(), jit.is_filled()
    if filled:
        print(f'compiled already: {jit.cache_folder()}')
    else:
        for step in warm_up(OdometryConfig(), load('auto')):
            print(f'compiling: {step}', file=sys.stderr, flush=True)
        print(f'compiled in {time.perf_counter() - start:.0f} s: {jit.cache_folder()}')
    write_result(args, {'folder': jit.cache_folder(), 'compiled_before': filled})
    return 0
