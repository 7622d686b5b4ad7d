# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""docs/results/difficulty.md: the splits and recorded pairs by methods without a network.

    python scripts/difficulty_report.py out/fpfh-*.json out/kiss-matcher-*.json

takes what `hybridreg evaluate --method ... --json` wrote. Of a split that stands in several files
the one with most pairs counts. The second table compares our static room pairs with the real ones
at equal overlap, since recall hangs on the overlap more than on anything else.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from docs_tables import put

from hybridreg_ros.data.hybridmatch.room_pairs import SPLITS
from hybridreg_ros.metrics.registration import wilson_interval

RESULTS = Path(__file__).resolve().parents[1] / 'docs' / 'results'
KEYS = ('pairs', 'RR', 'RR_95', 'RRE_deg', 'RTE_m')
OURS = ('room-match-rigid', 'room-lomatch-rigid')
BINS = (0.1, 0.2, 0.3, 0.4, 0.6, 1.0)
SPANS = ((0.3, 1.0), (0.1, 0.3), *pairwise(BINS))
DRAWS = 2000

Score = dict[str, Any]


def collect(files: list[Path]) -> dict[str, Any]:
    """Results by split and method, scores of static pairs, and where they come from."""
    splits: dict[str, dict[str, Any]] = {}
    static: dict[str, dict[str, list[Score]]] = defaultdict(dict)
    sources = []
    for file in files:
        report = json.loads(file.read_text(encoding='utf-8'))
        about = report['about']
        sources.append(about)
        for row in report['rows']:
            split, method = row['split'], about['method']
            cells = splits.setdefault(split, {})
            if split == 'all' or row['pairs'] <= cells.get(method, {'pairs': 0})['pairs']:
                continue
            cells[method] = {key: row[key] for key in KEYS}
            if split in OURS or split not in SPLITS:
                mine = [s for s in report['scores'] if s['split'] == split]
                static[method][split] = mine
    splits.pop('all', None)
    equal = {m: compare(by_split) for m, by_split in static.items()}
    return {'splits': splits, 'equal_overlap': equal, 'sources': sources}


def compare(by_split: dict[str, list[Score]]) -> dict[str, Any]:
    """Recall of our static room pairs and of the real ones, at the same overlaps."""
    ours = [s for split in OURS for s in by_split.get(split, [])]
    real = [s for split, scores in by_split.items() if split not in SPLITS for s in scores]
    spans = [
        {'overlap': span, 'ours': recall(_within(ours, span)), 'real': recall(_within(real, span))}
        for span in SPANS
    ]
    return {'spans': spans, 'real': recall(real), 'ours_as_real': reweighted(ours, real)}


def recall(scores: list[Score]) -> dict[str, Any] | None:
    """Share of registered pairs with its interval by Wilson; None without pairs."""
    if not scores:
        return None
    right = sum(map(_right, scores))
    return {
        'pairs': len(scores),
        'RR': right / len(scores),
        'RR_95': wilson_interval(right, len(scores)),
    }


def reweighted(ours: list[Score], real: list[Score]) -> dict[str, Any] | None:
    """Recall that ours would have with the overlaps of the real pairs.

    The interval is that of 2,000 draws of whole scenes, whose pairs are not independent. None
    where a bin of real pairs holds none of ours.
    """
    weight = np.bincount([_bin(s) for s in real], minlength=len(BINS) - 1) / max(len(real), 1)
    by_scene: dict[str, list[Score]] = defaultdict(list)
    for score in ours:
        by_scene[score['name'].rsplit('-', 1)[0]].append(score)
    counts = np.array([_counts(scores) for scores in by_scene.values()])  # (scenes, 2, bins)
    if not real or not ours or (counts[:, 1].sum(0)[weight > 0] == 0).any():
        return None
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(counts), size=(DRAWS, len(counts)))
    draws = [_expected(counts[rows].sum(0), weight) for rows in drawn]
    low, high = np.nanpercentile(draws, [2.5, 97.5])
    value = _expected(counts.sum(0), weight)
    return {
        'pairs': len(ours),
        'scenes': len(counts),
        'RR': value,
        'RR_95': (float(low), float(high)),
    }


def _expected(counts: Any, weight: Any) -> float:
    """Recall by bin (right, all) in the mean over the weights of the bins."""
    some = weight > 0
    return float((weight[some] * counts[0][some] / np.maximum(counts[1][some], 1)).sum())


def _counts(scores: list[Score]) -> list[Any]:
    bins = np.array([_bin(s) for s in scores])
    right = np.array([_right(s) for s in scores], dtype=float)
    size = len(BINS) - 1
    return [np.bincount(bins, right, size), np.bincount(bins, minlength=size)]


def _bin(score: Score) -> int:
    return int(np.clip(np.searchsorted(BINS, score['overlap'], 'right') - 1, 0, len(BINS) - 2))


def _right(score: Score) -> bool:
    return score['rmse_m'] is not None and score['rmse_m'] < score['threshold_m']


def _within(scores: list[Score], span: tuple[float, float]) -> list[Score]:
    low, high = span
    return [s for s in scores if low <= s['overlap'] < high]


def table(found: dict[str, Any]) -> str:
    """Recall in percent with its 95 % interval, pairs in brackets."""
    splits = found['splits']
    methods = sorted({m for cells in splits.values() for m in cells})
    order = [s for s in SPLITS if s in splits] + sorted(set(splits) - set(SPLITS))
    lines = _head(['pairs of', *methods])
    for split in order:
        lines.append(_line(split, [splits[split].get(method) for method in methods]))
    real = [found['equal_overlap'].get(m, {}).get('real') for m in methods]
    return '\n'.join([*lines, _line('all real pairs', real)])


def equal_table(found: dict[str, Any]) -> str:
    """Static room pairs, ours beside real ones, by overlap."""
    equal = found['equal_overlap']
    methods = sorted(equal)
    lines = _head(['overlap', *(f'{m}, {whose}' for m in methods for whose in ('ours', 'real'))])
    for k, (low, high) in enumerate(SPANS):
        rows = [equal[m]['spans'][k][whose] for m in methods for whose in ('ours', 'real')]
        lines.append(_line(f'{low:.1f} to {high:.1f}', rows))
    rows = [equal[m][key] for m in methods for key in ('ours_as_real', 'real')]
    return '\n'.join([*lines, _line('all real; ours weighted to their overlaps', rows)])


def _head(names: list[str]) -> list[str]:
    return ['| ' + ' | '.join(names) + ' |', '|---' * len(names) + '|']


def _line(name: str, rows: list[dict[str, Any] | None]) -> str:
    return f'| {name} | ' + ' | '.join(map(_cell, rows)) + ' |'


def _cell(row: dict[str, Any] | None) -> str:
    if row is None:
        return '-'
    low, high = row['RR_95']
    return f'{100 * row["RR"]:.0f} ({100 * low:.0f} to {100 * high:.0f}; n = {row["pairs"]})'


def main() -> None:
    """Merge the files, write JSON and tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('files', type=Path, nargs='+', help='JSON files of hybridreg evaluate')
    found = collect(sorted(parser.parse_args().files))
    RESULTS.mkdir(exist_ok=True)
    text = json.dumps(found, indent=1) + '\n'
    (RESULTS / 'data_difficulty.json').write_text(text, encoding='utf-8')
    put(RESULTS / 'difficulty.md', 'data-difficulty', table(found))
    put(RESULTS / 'difficulty.md', 'data-difficulty-equal', equal_table(found))


if __name__ == '__main__':
    main()
