# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Filling splits: seeds in blocks, made by any number of workers, written in order, same bytes."""

from __future__ import annotations

import json
import logging
import shutil
from dataclasses import asdict, dataclass
from itertools import chain, count, takewhile
from pathlib import Path
from typing import TYPE_CHECKING

from hybridreg_ros.core.errors import ConfigError, FileFormatError, HybridRegError
from hybridreg_ros.data.hybridmatch.room_pairs import GENERATOR_VERSION, SPLITS, scene_of
from hybridreg_ros.data.hybridmatch.splits_files import LAYOUTS, NOTES, Row, clean, write_text
from hybridreg_ros.data.hybridmatch.splits_summary import SplitSummary, read_summary, summarise
from hybridreg_ros.data.hybridmatch.splits_work import Block, results

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from hybridreg_ros.data.hybridmatch.splits_files import Layout

_LOG = logging.getLogger(__name__)

SEED_RANGES = {
    'train': (0, 3_000_000),
    'val': (3_000_000, 6_000_000),
    'test': (6_000_000, 9_000_000),
}
"""Scene seeds of each part; those from 9,000,000 upwards are left to outside checks."""

SEEDS_PER_SPLIT = 200_000
PAIRS = {'val': {'room': 100, 'street': 100}, 'test': {'room': 1000, 'street': 200}}
"""Pairs of each split of a part, per scene."""
BLOCK = 4
_MOST_EMPTY = 480


def first_seed(part: str, split: str) -> int:
    """First scene seed of a split in a part; no two splits of a part share a scene.

    Raises:
        ConfigError: the part or the split is unknown.
    """
    if part not in SEED_RANGES:
        raise ConfigError(f'part: expected one of {", ".join(SEED_RANGES)}, found {part!r}')
    scene_of(split)
    low = SEED_RANGES[part][0]
    return low + (SEEDS_PER_SPLIT * SPLITS.index(split) if split in SPLITS else 0)


def seed_range(seed: int) -> tuple[int, int]:
    """First and one past the last scene seed of the part that a seed belongs to.

    Raises:
        ConfigError: the seed is negative.
    """
    if seed < 0:
        raise ConfigError(f'seed: expected 0 or more, found {seed}')
    for low, high in SEED_RANGES.values():
        if low <= seed < high:
            return low, high
    return SEED_RANGES['test'][1], 2**62


@dataclass(frozen=True)
class _Job:
    """What a folder is filled with; noted in it so that nothing is ever mixed."""

    split: str
    seed: int
    layout: str
    version: int = GENERATOR_VERSION


def generate_split(
    split: str,
    pairs: int,
    seed: int,
    out: str | Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    layout: str = 'shards',
    progress: Callable[[int, int], None] | None = None,
) -> SplitSummary:
    """Fill a folder with exactly `pairs` pairs of a split; goes on where a killed run stopped.

    The bytes depend on the split, the seed, the layout and the number of pairs alone: not on
    the number of workers, and not on how often the run was killed.

    Args:
        split: one of the twelve split names, or `room-train` / `street-train`.
        pairs: number of pairs.
        seed: first scene seed.
        out: folder; new, empty, or left by the same call.
        workers: local processes; 1 works in this process.
        scheduler: address of a Dask scheduler, used instead of local processes.
        layout: 'shards', or 'official' for the authors' folder per pair.
        progress: called with the number of pairs done and the number wanted.

    Returns:
        What was made; also in `split.json`.

    Raises:
        ConfigError: an argument is outside its range, or the folder holds something else.
        DependencyError: Dask is asked for and not installed.
        HybridRegError: the scenes of these seeds do not give the pairs, or no scheduler answers.
    """
    scene_of(split)
    if layout not in LAYOUTS:
        raise ConfigError(f'layout: expected one of {", ".join(LAYOUTS)}, found {layout!r}')
    if pairs < 1 or workers < 1:
        raise ConfigError(f'expected at least 1 pair and 1 worker, found {pairs} and {workers}')
    report = progress or (lambda done, wanted: None)
    folder, job, store = Path(out), _Job(split, seed, layout), LAYOUTS[layout]
    summary = _reserve(folder, job, pairs)
    if summary is None:
        rows: list[Row] = []
        scenes = 0
        for block, found in _blocks(folder, store, job, workers, scheduler):
            rows += found[: pairs - len(rows)]
            scenes += block.count
            report(len(rows), pairs)
            if len(rows) == pairs or (not rows and scenes >= _MOST_EMPTY):
                break
        if len(rows) < pairs:
            raise HybridRegError(
                f'{split}: {scenes} scenes from seed {seed} gave {len(rows)} of {pairs} pairs; '
                'choose another seed or fewer pairs'
            )
        store.trim(folder, rows)
        summary = summarise(split, seed, layout, scenes, rows)
        write_text(folder / 'split.json', json.dumps(asdict(summary), indent=1) + '\n')
    report(pairs, pairs)
    shutil.rmtree(folder / NOTES, ignore_errors=True)
    clean(folder)
    return summary


def _reserve(folder: Path, job: _Job, pairs: int) -> SplitSummary | None:
    """Make sure that a folder is for this job; its summary when it is already complete.

    Raises:
        ConfigError: the folder holds something else.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if (folder / 'split.json').exists():
        known = read_summary(folder)
        there = _Job(known.split, known.seed, known.layout, known.generator_version)
        if there == job and known.pairs == pairs:
            return known
        raise ConfigError(
            f'{folder} holds {known.pairs} pairs of {_said(there)}, requested were {pairs} of '
            f'{_said(job)}: choose another folder'
        )
    note = folder / NOTES / 'job.json'
    if note.exists():
        there = _Job(**json.loads(note.read_text(encoding='utf-8')))
        if there != job:
            raise ConfigError(
                f'{folder} was started with {_said(there)}, but {_said(job)} was requested: '
                'choose another folder'
            )
        return None
    if any(p.name != NOTES for p in folder.iterdir()):
        raise ConfigError(
            f'{folder} is neither empty nor an unfinished split: choose another folder'
        )
    note.parent.mkdir(exist_ok=True)
    write_text(note, json.dumps(asdict(job)) + '\n')
    return None


def _said(job: _Job) -> str:
    return f'{job.split} (seed {job.seed}, {job.layout}, generator {job.version})'


def _blocks(
    folder: Path, store: Layout, job: _Job, workers: int, scheduler: str | None
) -> Iterator[tuple[Block, list[Row]]]:
    """Blocks of seeds in order, with the rows of their pairs, which are on disk by then.

    A run writes its blocks in order, so what an earlier one left is a beginning.
    """
    last = seed_range(job.seed)[1]
    still = job.layout == 'official'
    blocks = (
        Block(job.split, s, min(BLOCK, last - s), job.layout, still)
        for s in takewhile(lambda s: s < last, count(job.seed, BLOCK))
    )
    for block in blocks:
        rows = _noted(folder, store, block)
        if rows is None:
            break
        yield block, rows
    else:
        return
    for made_block, made in results(chain([block], blocks), workers, scheduler):
        store.write(folder, made_block.first_seed, made)
        note = folder / NOTES / f'{made_block.first_seed:07d}.json'
        write_text(note, json.dumps([asdict(row) for row in made.rows]) + '\n')
        yield made_block, list(made.rows)


def _noted(folder: Path, store: Layout, block: Block) -> list[Row] | None:
    """Rows of a block that an earlier run wrote completely; None when there is no such."""
    note = folder / NOTES / f'{block.first_seed:07d}.json'
    try:
        rows = [Row(**row) for row in json.loads(note.read_text(encoding='utf-8'))]
        return rows if store.complete(folder, block.first_seed, rows) else None
    except FileNotFoundError:
        return None
    except (FileFormatError, ValueError, TypeError) as error:
        _LOG.warning('block %s is generated again: %s', note.stem, error)
        return None
