# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""All splits side by side: distributions with the paper's limits drawn in, and a table."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.hybridmatch.preview import figure, limits_of, save
from hybridreg_ros.data.hybridmatch.room_pairs import SPLITS
from hybridreg_ros.data.hybridmatch.splits import BLOCK
from hybridreg_ros.data.hybridmatch.splits_files import NOTES, Row
from hybridreg_ros.data.hybridmatch.splits_summary import read_summary, summarise

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from hybridreg_ros.data.hybridmatch.splits_summary import Distribution, SplitSummary

_QUANTITIES = {
    'overlap': 'overlap',
    'dynamic_share': 'share of moving points',
    'points': 'points per cloud',
    'displacement_m': 'displacement, m',
}


def read_overview(folder: Path) -> list[SplitSummary]:
    """Summaries of all splits in a folder, in the order of the paper; begun ones as they are.

    Raises:
        FileFormatError: the folder holds none.
    """
    found = [s for name in SPLITS if (s := _summary(folder / name, name)) is not None]
    if not found:
        raise FileFormatError(f'{folder} holds no splits: make them with `hybridreg generate all`')
    return found


def _summary(folder: Path, split: str) -> SplitSummary | None:
    """`split.json`, or of a split that is still being made, what is there so far."""
    if (folder / 'split.json').exists():
        return read_summary(folder)
    notes = sorted((folder / NOTES).glob('[0-9]*.json'))
    rows = [Row(**row) for note in notes for row in json.loads(note.read_text(encoding='utf-8'))]
    if not rows:
        return None
    first = int(notes[0].stem)
    return summarise(split, first, 'shards', int(notes[-1].stem) - first + BLOCK, rows)


def overview_table(summaries: Sequence[SplitSummary]) -> str:
    """One line per split: counts, and least / median / most of each quantity (Markdown)."""
    heads = ['split', 'pairs', 'scenes', 'first scene', *_QUANTITIES.values()]
    lines = [' | '.join(['', *heads, '']).strip(), '|' + '---|' * len(heads)]
    for s in summaries:
        cells = [s.split, str(s.pairs), str(s.scenes), str(s.seed)]
        cells += [_said(s.distributions[name]) for name in _QUANTITIES]
        lines.append(' | '.join(['', *cells, '']).strip())
    return '\n'.join(lines) + '\n'


def _said(spread: Distribution) -> str:
    digits = 0 if spread.maximum > 100 else 2
    values = (spread.minimum, spread.median, spread.maximum)
    return ' / '.join(f'{v:.{digits}f}' for v in values)


def draw_overview(summaries: Sequence[SplitSummary], path: Path) -> None:
    """One row of histograms per split; limits of the paper dashed.

    Raises:
        DependencyError: matplotlib is not installed.
    """
    sheet = figure(9.2, 0.95 * len(summaries) + 0.3)
    axes = sheet.subplots(len(summaries), len(_QUANTITIES), squeeze=False, sharex='col')
    for row, summary in zip(axes, summaries, strict=True):
        limits = limits_of(summary.split)
        row[0].set_ylabel(summary.split.split('-', 1)[1].replace('-', '\n', 1), fontsize=7)
        for axis, name in zip(row, _QUANTITIES, strict=True):
            spread = summary.distributions[name]
            edges = np.array(spread.edges)
            axis.bar(edges[:-1], spread.counts, np.diff(edges), align='edge', color='#4477aa')
            for limit in limits.get(name, ()):
                axis.axvline(limit, color='#cc3311', linestyle='--', linewidth=1.0)
            axis.set_yticks([])
            axis.tick_params(labelsize=6)
    for axis, text in zip(axes[-1], _QUANTITIES.values(), strict=True):
        axis.set_xlabel(text, fontsize=8)
    save(sheet, path)
