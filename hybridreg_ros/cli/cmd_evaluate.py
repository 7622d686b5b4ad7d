# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg evaluate`: RR, IR, FMR, RRE, RTE of the network on folders of pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hybridreg_ros.cli.common import progress, write_result
from hybridreg_ros.cli.many import each
from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.shards import open_split
from hybridreg_ros.model.register import HybridReg
from hybridreg_ros.training.evaluate import evaluate, recorded_pairs
from hybridreg_ros.training.report import EvalReport, PairScore, to_markdown

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence
    from pathlib import Path

    from hybridreg_ros.data.pair import PointPair

PAIRS_PER_TASK = 20


@dataclass(frozen=True)
class Task:
    """Some pairs of one folder.

    Attributes:
        folder: shards, or recorded pairs.
        rows: numbers of the pairs.
        weights: checkpoint, None for the packaged one.
    """

    folder: Path
    rows: tuple[int, ...]
    weights: Path | None


def run(args: argparse.Namespace) -> int:
    """Score every pair, print one table."""
    HybridReg.from_pretrained(args.weights)  # bad weights are said before anything is scheduled
    size = 1 if args.workers == 1 and args.scheduler is None else PAIRS_PER_TASK
    tasks = [
        Task(folder, tuple(rows[k : k + size]), args.weights)
        for folder in args.data
        for rows in [range(_count(folder, args.limit))]
        for k in range(0, len(rows), size)
    ]
    done = each(scores_of, tasks, args.workers, args.scheduler)
    scores = [s for part in progress(done, len(tasks), 'evaluate', 'task') for s in part]
    about = {
        'data': [str(folder) for folder in args.data],
        'weights': str(args.weights or 'packaged'),
    }
    report = EvalReport('hybridreg', tuple(scores), about)
    table = to_markdown([report])
    print(table, end='')
    if args.markdown is not None:
        args.markdown.parent.mkdir(parents=True, exist_ok=True)
        args.markdown.write_text(table, encoding='utf-8')
    write_result(args, {'about': about, 'rows': report.rows(), 'scores': list(scores)})
    return 0


def _pairs(folder: Path) -> Sequence[PointPair]:
    """Pairs of a folder of shards or of recorded pairs.

    Raises:
        FileFormatError: it is neither of both.
    """
    if not folder.is_dir():
        raise FileFormatError(f'no folder of pairs at {folder}')
    return recorded_pairs(folder) if (folder / 'pairs.json').exists() else open_split(folder)


def _count(folder: Path, limit: int | None) -> int:
    count = len(_pairs(folder))
    if not count:
        raise FileFormatError(f'{folder} holds no pairs: make some with `hybridreg generate`')
    return count if limit is None else min(count, limit)


def scores_of(task: Task) -> tuple[PairScore, ...]:
    """Score the pairs of one task."""
    model = _model(task.weights)
    pairs = _pairs(task.folder)
    return evaluate(model, (pairs[row] for row in task.rows)).scores


_LOADED: dict[Path | None, HybridReg] = {}


def _model(weights: Path | None) -> HybridReg:
    """Model of this process, loaded once."""
    if weights not in _LOADED:
        _LOADED[weights] = HybridReg.from_pretrained(weights)
    return _LOADED[weights]
