# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Many logs: checked first, one row each, and what one breaks does not stop the others."""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybridreg_ros.cli.common import write_result
from hybridreg_ros.cli.runs.many import each
from hybridreg_ros.core.errors import ConfigError, HybridRegError
from hybridreg_ros.core.progress import progress
from hybridreg_ros.replay import session
from hybridreg_ros.replay.outputs import plain
from hybridreg_ros.replay.page import index, tables
from hybridreg_ros.replay.page.index import DONE, FAILED, KEPT, SHORT, Outcome

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from hybridreg_ros.replay.page.report import ReportRun

    Work = Callable[[session.Job], ReportRun]

INTERRUPTED = 'interrupted (Ctrl-C)'


def earlier(job: session.Job) -> dict[str, Any] | None:
    """The metrics of a job that was finished before, as it is asked for now; else None."""
    try:
        found: dict[str, Any] = json.loads((job.out / 'metrics.json').read_text('utf-8'))
    except (OSError, ValueError):
        return None
    same = found.get('asked') == plain(session.asked(job))
    return found if same and not found.get('interrupted') else None


def refuse(jobs: Sequence[session.Job], overwrite: bool, resume: bool) -> None:
    """Refuse to replace results, unless told.

    Raises:
        ConfigError: names a folder and the options.
    """
    taken = [job.out for job in jobs if (job.out / 'metrics.json').exists()]
    if taken and not overwrite and not resume:
        more = f' (and {len(taken) - 1} more)' if len(taken) > 1 else ''
        raise ConfigError(
            f'{taken[0]}{more} holds results: replace them with --overwrite, keep finished ones '
            'with --resume, or name another folder with --out'
        )


def attempt(work: Work, job: session.Job) -> Outcome:
    """Do one job; what goes wrong is its outcome."""
    try:
        done = work(job)
    except (HybridRegError, OSError, MemoryError) as error:
        text = ' '.join(str(error).split()) or type(error).__name__
        return Outcome(job.bag.stem, job.out, FAILED, text)
    log = done.log
    status = FAILED if log.useless and not log.interrupted else SHORT if log.interrupted else DONE
    metrics = {**plain(done.metrics), 'per_frame': None}
    return Outcome(job.bag.stem, job.out, status, log.interrupted or log.useless, metrics)


def check(job: session.Job) -> str:
    """Why a job cannot be done, '' when nothing is known against it."""
    try:
        plan = session.plan_of(job)
    except (HybridRegError, OSError) as error:
        return ' '.join(str(error).split())
    return '' if plan.clouds else f'{job.bag} holds no cloud on {plan.topic}'


def run(args: argparse.Namespace, jobs: Sequence[session.Job], work: Work) -> int:
    """Do all jobs, print one table, write an index; 0 when every log is done."""
    known: dict[Path, Outcome] = {}
    for job in jobs:
        if reason := check(job):
            known[job.out] = Outcome(job.bag.stem, job.out, FAILED, reason)
        elif args.resume and (metrics := earlier(job)):
            known[job.out] = Outcome(job.bag.stem, job.out, KEPT, '', metrics)
    for o in known.values():
        print(f'{o.name}: {o.status}{": " if o.reason else ""}{o.reason}', file=sys.stderr)
    left = [job for job in jobs if job.out not in known]
    done = each(partial(attempt, work), left, args.workers, args.scheduler)
    for outcome in progress(done, len(left), 'logs', 'log'):
        known[outcome.folder] = outcome
        if outcome.reason == INTERRUPTED:
            break
    outcomes = [known[job.out] for job in jobs if job.out in known]
    page = (args.out or Path('out')) / 'index.html'
    index.write_index(page, outcomes)
    print(tables.text_table(index.rows(index.worst_first(outcomes))))
    print(f'written: {page}, and of each log report.html metrics.json odometry.tum dynamic.mcap')
    by_bag = {str(j.bag): known[j.out] for j in jobs if j.out in known}
    told = {b: {**o.metrics, 'status': o.status, 'reason': o.reason} for b, o in by_bag.items()}
    write_result(args, told)
    if any(o.reason == INTERRUPTED for o in outcomes):
        return 130
    return 0 if all(o.status in (DONE, KEPT) for o in outcomes) else 2
