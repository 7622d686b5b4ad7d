# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg demo`: a simulated room, the real node over DDS, kiss-icp beside it, one report."""

from __future__ import annotations

import dataclasses
import sys
import time
from typing import TYPE_CHECKING

from hybridreg_ros.benchmark.baseline import Alone
from hybridreg_ros.cli.common import write_result
from hybridreg_ros.cli.runs.live import LiveOptions, replay_live
from hybridreg_ros.core.progress import progress
from hybridreg_ros.replay import session
from hybridreg_ros.replay.bag_writer import BagWriter
from hybridreg_ros.replay.page import report, tables
from hybridreg_ros.replay.recording import simulated, write_recording

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

MOVING = '10-30'
RATE_HZ = 10.0


def run(args: argparse.Namespace) -> int:
    """Simulate, play, score, compare, report."""
    start = time.perf_counter()
    args.out.mkdir(parents=True, exist_ok=True)
    bag = args.bag or _simulate(args)
    job = session.Job(bag=bag, out=args.out)
    options = LiveOptions(args.rate, args.domain_id, timeout_s=90.0)
    beside = session.Beside('kiss-icp alone', Alone())
    ours = dataclasses.replace(replay_live(job, options, beside), name='hybridreg node (live)')
    (alone,) = ours.beside
    page = args.out / 'report.html'
    frames = len(ours.log.frames)
    report.write_report(
        page,
        'hybridreg demo: a room with people in it',
        f'{frames} clouds played over DDS into the node; kiss-icp alone: offline on the same bag',
        [ours, alone],
    )
    rows = [(r.name, r.log, r.scores) for r in (ours, alone)]
    for note in ours.log.notes:
        print(note)
    print(tables.text_table(tables.score_rows(rows)))
    print(f'report: {page}   bag: {bag}   {time.perf_counter() - start:.0f} s')
    write_result(args, {'bag': bag, 'live': ours.metrics, 'kiss_icp_alone': alone.scores})
    if ours.log.useless:
        print(f'hybridreg: error: {bag}: {ours.log.useless}', file=sys.stderr)
        return 2
    return 130 if ours.log.interrupted else 0


def _simulate(args: argparse.Namespace) -> Path:
    path: Path = args.out / 'demo.mcap'
    frames = simulated('room', args.frames, RATE_HZ, args.seed, MOVING)
    with BagWriter(path, overwrite=True) as bag:
        write_recording(progress(frames, args.frames, 'simulate a room'), bag)
    return path
