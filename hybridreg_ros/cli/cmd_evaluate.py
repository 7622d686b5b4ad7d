# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg evaluate`: RR, IR, FMR, RRE, RTE of the network or a baseline on folders of pairs."""

from __future__ import annotations

import datetime
import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.cli.common import budget_of, write_result
from hybridreg_ros.cli.runs.many import each
from hybridreg_ros.core import provenance
from hybridreg_ros.core.config import to_dict
from hybridreg_ros.core.errors import ConfigError, FileFormatError
from hybridreg_ros.core.progress import progress
from hybridreg_ros.data.loaders.labelled import open_labelled
from hybridreg_ros.data.loaders.openers import open_pairs
from hybridreg_ros.training import moving
from hybridreg_ros.training.baselines import METHODS
from hybridreg_ros.training.evaluate import evaluate, evaluate_method, recorded_pairs
from hybridreg_ros.training.kept_scores import KeptScores
from hybridreg_ros.training.report import EvalReport, PairScore, to_markdown
from hybridreg_ros.training.variants import load_variant

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator
    from pathlib import Path

    from hybridreg_ros.data.loaders.posed_frames import PairSource
    from hybridreg_ros.model.budget import Budget
    from hybridreg_ros.model.register import HybridReg

PAIRS_PER_TASK = 20
OURS = 'hybridreg'
BENCHED = ('open3d-cpu', 'kiss-matcher')


@dataclass(frozen=True)
class Task:
    """Some pairs of one folder.

    Attributes:
        folder: pairs.
        rows: numbers of the pairs.
        weights: checkpoint, None for the packaged one.
        method: one of our variants, or of the baselines.
        attempts: at most, at a pair; None: as the variant says.
        budget: by which the voxel is chosen; None: the full size.
    """

    folder: Path
    rows: tuple[int, ...]
    weights: Path | None
    method: str = OURS
    attempts: int | None = None
    budget: Budget | None = None


def run(args: argparse.Namespace) -> int:
    """Score every pair, print one table."""
    if args.moving:
        return run_moving(args)
    about: dict[str, Any] = {'method': args.method}
    if args.method not in METHODS:
        load_variant(
            args.method, args.weights, args.attempts
        )  # what is wrong is said before any scheduling
        about['weights'] = 'packaged' if args.weights is None else provenance.sha256(args.weights)
        budget = budget_of(args)
        if args.attempts is not None:
            about['attempts'] = args.attempts
        if budget is not None:
            about |= {'budget': to_dict(budget)}
    kept = KeptScores(args.keep, about)
    tasks = [task for folder in args.data for task in _missing(args, folder, kept)]
    done = each(scores_of, tasks, args.workers, args.scheduler)
    for part in progress(done, len(tasks), 'evaluate', 'task'):
        for score in part:
            kept.add(score)
    scores = [score for folder in args.data for score in _all(args, folder, kept)]
    about |= {
        'data': [folder.resolve().name for folder in args.data],
        'limit': args.limit,
        'versions': {name: provenance.version(name) for name in BENCHED},
        'git': provenance.git_hash(),
        'date': datetime.datetime.now(datetime.UTC).date().isoformat(),
    }
    report = EvalReport(args.method, tuple(scores), about)
    table = to_markdown([report])
    print(table, end='')
    if args.markdown is not None:
        args.markdown.parent.mkdir(parents=True, exist_ok=True)
        args.markdown.write_text(table, encoding='utf-8')
    write_result(args, {'about': about, 'rows': report.rows(), 'scores': list(scores)})
    return 0


def _pairs(folder: Path) -> PairSource:
    """Pairs of a folder of any format.

    Raises:
        FileFormatError: it is none.
    """
    return recorded_pairs(folder) if (folder / 'pairs.json').exists() else open_pairs(folder)


def _count(pairs: PairSource, folder: Path, limit: int | None) -> int:
    if not len(pairs):
        raise FileFormatError(f'{folder} holds no pairs: make some with `hybridreg generate`')
    return len(pairs) if limit is None else min(len(pairs), limit)


def _missing(args: argparse.Namespace, folder: Path, kept: KeptScores) -> Iterator[Task]:
    """Tasks for the pairs of a folder that have no score yet."""
    pairs = _pairs(folder)
    rows = [
        row
        for row in range(_count(pairs, folder, args.limit))
        if args.keep is None or kept.of(pairs[row]) is None
    ]
    size = 1 if args.workers == 1 and args.scheduler is None else PAIRS_PER_TASK
    for k in range(0, len(rows), size):
        chunk = tuple(rows[k : k + size])
        yield Task(folder, chunk, args.weights, args.method, args.attempts, budget_of(args))


def _all(args: argparse.Namespace, folder: Path, kept: KeptScores) -> Iterator[PairScore]:
    """Scores of the pairs of a folder."""
    pairs = _pairs(folder)
    for row in range(_count(pairs, folder, args.limit)):
        score = kept.of(pairs[row])
        assert score is not None, 'every pair has been scored'
        yield score


def scores_of(task: Task) -> tuple[PairScore, ...]:
    """Score the pairs of one task."""
    source = _pairs(task.folder)
    pairs = (source[row] for row in task.rows)
    if task.method in METHODS:
        return evaluate_method(task.method, METHODS[task.method], pairs).scores
    model = _model(task.method, task.weights, task.attempts)
    return evaluate(model, pairs, budget=task.budget).scores


@functools.cache
def _model(variant: str, weights: Path | None, attempts: int | None) -> HybridReg:
    """Model of this process, loaded once."""
    return load_variant(variant, weights, attempts)


def run_moving(args: argparse.Namespace) -> int:
    """Score the masks on every folder of labelled pairs, print one table."""
    if args.method != OURS:
        raise ConfigError(f'method: expected {OURS} with --moving, found {args.method}')
    sources = {folder: open_labelled(folder, args.gap_s) for folder in args.data}
    model, budget = load_variant(OURS, args.weights, attempts=1), budget_of(args)

    def scored(folder: Path) -> moving.MovingScore:
        pairs = sources[folder]
        rows = range(len(pairs))
        if args.limit is not None and args.limit < len(pairs):
            rows = np.linspace(0, len(pairs) - 1, args.limit).round().astype(int).tolist()
        name = folder.resolve().name
        shown = progress((pairs.labelled(row) for row in rows), len(rows), name, 'pair')
        return moving.score_moving(model, shown, name, budget)

    scores = [scored(folder) for folder in args.data]
    table = moving.to_markdown(scores)
    print(table, end='')
    if args.markdown is not None:
        args.markdown.parent.mkdir(parents=True, exist_ok=True)
        args.markdown.write_text(table, encoding='utf-8')
    about: dict[str, Any] = {
        'weights': 'packaged' if args.weights is None else provenance.sha256(args.weights),
        'gap_s': args.gap_s,
        'budget': None if budget is None else to_dict(budget),
        'git': provenance.git_hash(),
    }
    write_result(args, {'about': about, 'rows': [score.row() for score in scores]})
    return 0
