# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg replay`: bags through the front end, offline or live, one or many."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from hybridreg_ros.benchmark.baseline import Alone
from hybridreg_ros.cli.common import write_result
from hybridreg_ros.cli.runs import fleet
from hybridreg_ros.cli.runs.many import require_dask
from hybridreg_ros.core.errors import BagError, ConfigError, require
from hybridreg_ros.core.progress import bar
from hybridreg_ros.data.loaders.clouds import SUFFIXES
from hybridreg_ros.replay import session
from hybridreg_ros.replay.page import tables
from hybridreg_ros.replay.page.report import check_packages
from hybridreg_ros.replay.rerun_sink import LIVE
from hybridreg_ros.replay.session import odometry_config

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from hybridreg_ros.replay.clean_map import MapReport
    from hybridreg_ros.replay.page.report import ReportRun
    from hybridreg_ros.replay.runner import FrameLog

EXIT_ERROR, EXIT_INTERRUPTED = 2, 130
PASSED = ('weights', 'topic', 'truth_topic', 'time_unit', 'time_field', 'stride', 'max_frames')
"""Arguments that a job has by the same names."""


def run(args: argparse.Namespace) -> int:
    """Replay one bag or many, print one table, say where the results are."""
    if args.suite is not None:
        from hybridreg_ros.cli import cmd_suite

        return cmd_suite.run(args)
    if not args.bags:
        raise BagError(
            'no bag given: name one or more, or a benchmark with --suite '
            '(see hybridreg replay --help)'
        )
    jobs = _jobs(args)
    fleet.refuse(jobs, args.overwrite, args.resume)
    check_packages()
    if args.rerun is not None:
        require('--rerun', 'view', 'rerun')
    if args.video is not None and args.video.suffix.lower() == '.mp4':
        require('an .mp4', 'view', 'imageio_ffmpeg')
    if args.workers > 1 or args.scheduler is not None:
        require_dask()
    if args.live:
        from hybridreg_ros.cli.runs.live import LiveOptions, check_options, replay_live

        check_options(args)
        options = LiveOptions(args.rate, args.domain_id, args.timeout)

        def work(job: session.Job) -> ReportRun:
            return replay_live(job, options, beside(job))

    else:
        work = _offline if args.workers == 1 and args.scheduler is None else _one
    if len(jobs) > 1 or args.scheduler is not None:
        return fleet.run(args, jobs, work)
    if args.resume and fleet.earlier(jobs[0]) is not None:
        print(f'{jobs[0].out}: kept, it is finished')
        return 0
    return tell(args, jobs[0], work(jobs[0]))


def _jobs(args: argparse.Namespace) -> list[session.Job]:
    """One job per bag."""
    config = odometry_config(args.config, args.registrar)
    if args.weights is not None and config.registrar == 'kiss-icp':
        raise ConfigError('--weights has no effect with registrar kiss-icp: leave one of them out')
    jobs = [
        session.Job(
            bag=bag,
            out=_folder(args, bag),
            config=config,
            extrinsic=args.extrinsic and tuple(args.extrinsic),
            start_s=args.start,
            duration_s=args.duration,
            clouds=not args.no_clouds,
            compare=not args.no_compare,
            map=_own(args, args.map, bag),
            moving=_own(args, args.moving, bag),
            video=_own(args, args.video, bag, ('.gif', '.webp', '.mp4')),
            rerun=_viewer(args, bag),
            **{name: getattr(args, name) for name in PASSED},
        )
        for bag in args.bags
    ]
    if args.live and (args.workers > 1 or args.scheduler is not None):
        raise ConfigError('--workers and --scheduler cannot be combined with --live')
    folders = [job.out.resolve() for job in jobs]
    if len(set(folders)) < len(folders):
        raise BagError('two bags of the same name would write into one folder: rename one')
    return jobs


def _folder(args: argparse.Namespace, bag: Path) -> Path:
    """Folder of one bag's results."""
    if args.out is None:
        return Path('out') / bag.stem
    out: Path = args.out
    return out if len(args.bags) == 1 else out / bag.stem


def _own(
    args: argparse.Namespace, path: Path | None, bag: Path, kinds: tuple[str, ...] = SUFFIXES
) -> Path | None:
    """A file of one bag: as named, or of that name in the folder of each of several bags."""
    if path is not None and path.suffix.lower() not in kinds:
        raise ConfigError(f'{path}: expected a file ending in {", ".join(kinds)}')
    return path if path is None or len(args.bags) == 1 else _folder(args, bag) / path.name


def _viewer(args: argparse.Namespace, bag: Path) -> str:
    """Where Rerun is to show a bag: live, at an address, or later from a file of its own."""
    target: str = args.rerun or ''
    if target in ('', LIVE) or '://' in target:
        return target
    path = _own(args, Path(target), bag, ('.rrd',))
    return str(path)


def _offline(job: session.Job) -> ReportRun:
    plan = session.plan_of(job)
    print(f'{job.bag}: {plan.clouds} clouds of {plan.topic}', file=sys.stderr)
    with bar(plan.clouds, job.bag.name) as shown:
        return _one(job, lambda _: shown.update())


def _one(job: session.Job, tick: Callable[[FrameLog | None], None] | None = None) -> ReportRun:
    return session.replay(job, tick, beside(job))


def beside(job: session.Job) -> session.Beside | None:
    """kiss-icp alone on the same clouds, unless it is switched off or leads anyway."""
    if not job.compare or job.config.registrar == 'kiss-icp':
        return None
    return session.Beside('kiss-icp alone', Alone())


def tell(args: argparse.Namespace, job: session.Job, done: ReportRun) -> int:
    """Print one run as a table; the exit code says whether it is complete."""
    runs = (done, *done.beside)
    log, code = done.log, 0
    if 'map' in done.metrics:
        print(_said(done.metrics['map']))
    for note in log.notes:
        print(f'{job.bag}: {note}', file=sys.stderr)
    if log.interrupted:
        print(f'hybridreg: {job.bag}: {log.interrupted}', file=sys.stderr)
        code = EXIT_INTERRUPTED if log.interrupted == fleet.INTERRUPTED else EXIT_ERROR
    elif log.useless:
        print(f'hybridreg: error: {job.bag}: {log.useless}', file=sys.stderr)
        code = EXIT_ERROR
    if done.scores.warning:
        print(f'{job.bag}: {done.scores.warning}', file=sys.stderr)
    if done.scores.note:
        print(f'{job.bag}: no trajectory score: {done.scores.note}', file=sys.stderr)
    print(tables.text_table(tables.score_rows([(r.name, r.log, r.scores) for r in runs])))
    if log.drops:
        print(f'{len(log.drops)} clouds were not used; metrics.json and report.html say why')
    print(f'written: report.html metrics.json odometry.tum dynamic.mcap in {job.out}')
    write_result(args, done.metrics)
    return code


def _said(made: MapReport) -> str:
    """A map in one line."""
    text = (
        f'map of {made.written} points; of {made.points} seen, {made.moving} moved and '
        f'{made.ghosts} more were seen through by other scans'
    )
    if made.static_accuracy is None or made.dynamic_accuracy is None:
        return text
    return (
        f'{text}; kept {100 * made.static_accuracy:.1f} % of what stands still, took out '
        f'{100 * made.dynamic_accuracy:.1f} % of what moves'
    )
