# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg demo`: a simulated room, the real node over DDS, kiss-icp beside it, one report."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from hybridreg_ros.cli.cmd_replay import beside, tell
from hybridreg_ros.cli.runs.live import LiveOptions, check_ros, replay_live
from hybridreg_ros.core.errors import require
from hybridreg_ros.core.progress import progress
from hybridreg_ros.replay import session
from hybridreg_ros.replay.bag_writer import BagWriter
from hybridreg_ros.replay.page.report import check_packages
from hybridreg_ros.replay.recording import simulated, write_recording

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

MOVING = '10-30'
RATE_HZ = 10.0


def run(args: argparse.Namespace) -> int:
    """Simulate, play, score, compare, report."""
    start = time.perf_counter()
    check_packages()
    check_ros()
    if args.bag is None:
        require('a simulated scene', 'data', 'embreex')
    args.out.mkdir(parents=True, exist_ok=True)
    bag = args.bag or _simulate(args)
    job = session.Job(bag=bag, out=args.out)
    options = LiveOptions(args.rate, args.domain_id, timeout_s=90.0)
    code = tell(args, job, replay_live(job, options, beside(job)))
    print(f'report: {args.out / "report.html"}   bag: {bag}   {time.perf_counter() - start:.0f} s')
    return code


def _simulate(args: argparse.Namespace) -> Path:
    path: Path = args.out / 'demo.mcap'
    frames = simulated('room', args.frames, RATE_HZ, args.seed, MOVING)
    with BagWriter(path, overwrite=True) as bag:
        write_recording(progress(frames, args.frames, 'simulate a room'), bag)
    return path
