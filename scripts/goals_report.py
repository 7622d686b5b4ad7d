# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""docs/results/registration.md: registration against its floors and goals.

    python scripts/goals_report.py out/hybridreg.json out/fpfh.json ... --bench out/bench.json

takes what `hybridreg evaluate --method ... --json` and `hybridreg bench --peers --json` wrote.
`make goals` runs all of them and this.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from docs_tables import put

from hybridreg_ros.metrics import calibration
from hybridreg_ros.metrics.registration import bootstrap_interval, wilson_interval
from hybridreg_ros.model.checkpoint import load_checkpoint, packaged_weights
from hybridreg_ros.training.evaluate import GATE
from hybridreg_ros.training.report import PairScore, score_from_plain

if TYPE_CHECKING:
    from collections.abc import Mapping

RESULTS = Path(__file__).resolve().parents[1] / 'docs' / 'results'
REAL = ('pairs_3dmatch', 'pairs_7scenes_fragments')
OURS = 'hybridreg'
CLASSICAL = ('fpfh', 'kiss-matcher')
KINDS = ('rigid', '10-30', '30-50')
RECALL = {
    'match': ((95, 90, 85), (99.2, 97.4, 96.6)),
    'lomatch': ((70, 50, 45), (93.9, 75.6, 73.6)),
}

Scores = dict[str, dict[str, PairScore]]
Limits = tuple[float, ...]


@dataclass(frozen=True)
class Row:
    """One line of the table; `least` says whether the value must be at least the floor."""

    name: str
    value: float
    floor: float
    goal: float
    note: str = ''
    least: bool = True
    digits: int = 1

    @property
    def verdict(self) -> str:
        """Where the value stands."""
        if math.isnan(self.value):
            return 'not measured'
        better = (
            (lambda limit: self.value >= limit)
            if self.least
            else (lambda limit: self.value <= limit)
        )
        return 'goal' if better(self.goal) else 'floor' if better(self.floor) else '**below**'


def read(files: list[Path]) -> tuple[Scores, list[dict[str, Any]]]:
    """Scores by method and pair, and where they come from."""
    scores: Scores = {}
    sources = []
    for file in files:
        report = json.loads(file.read_text(encoding='utf-8'))
        sources.append(report['about'])
        found = scores.setdefault(report['about']['method'], {})
        found.update({s.name: s for s in map(score_from_plain, report['scores'])})
    return scores, sources


def of_split(scores: Scores, method: str, *splits: str) -> list[PairScore]:
    """Scores of a method on some splits."""
    return [s for s in scores.get(method, {}).values() if s.split in splits]


def recall(found: list[PairScore]) -> tuple[float, str]:
    """RR in percent, and its interval as text."""
    if not found:
        return math.nan, ''
    right = sum(s.right for s in found)
    low, high = wilson_interval(right, len(found))
    return 100 * right / len(found), f'{100 * low:.0f} to {100 * high:.0f}, n = {len(found)}'


def recall_rows(
    scores: Scores, rooms: Mapping[str, tuple[Limits, Limits]], streets_goal: float
) -> list[Row]:
    """RR of every generated split; `rooms`: floors and goals, in percent, of each of `KINDS`."""
    rows = []
    for kind, (floors, goals) in rooms.items():
        for part, floor, goal in zip(KINDS, floors, goals, strict=True):
            value, note = recall(of_split(scores, OURS, f'room-{kind}-{part}'))
            rows.append(Row(f'RR % room-{kind}-{part}', value, floor, goal, note))
    streets = [f'street-{k}-{p}' for k in rooms for p in KINDS]
    each = [recall(of_split(scores, OURS, s))[0] for s in streets]
    known = [v for v in each if not math.isnan(v)]
    note = ', '.join(f'{s[7:]} {v:.0f}' for s, v in zip(streets, each, strict=True))
    mean = float(np.mean(known)) if known else math.nan
    return [*rows, Row('RR % streets, mean', mean, 90, streets_goal, note)]


def real_rows(scores: Scores) -> list[Row]:
    """Recorded pairs of rooms."""
    value, note = recall(of_split(scores, OURS, *REAL))
    done = [s.rte_m for s in of_split(scores, OURS, *REAL) if s.right]
    middle = 100 * float(np.median(done)) if done else math.nan
    return [
        Row('RR % real pairs', value, 86, 100, note),
        Row('median RTE cm, real pairs', middle, 6, 2, least=False),
    ]


def difference(
    scores: Scores, ours: str, theirs: str, split: str
) -> tuple[float, float, float, int]:
    """Mean difference of RR in points on the same pairs, its 95 % interval, number of pairs."""
    a, b = ({s.name: s for s in of_split(scores, m, split)} for m in (ours, theirs))
    both = sorted(a.keys() & b.keys())
    gain = 100.0 * np.array([float(a[n].right) - float(b[n].right) for n in both])
    return (float(gain.mean()) if both else math.nan, *bootstrap_interval(gain), len(both))


def mask_rows(scores: Scores) -> list[Row]:
    """What the mask gives, and how well it tells static from the rest."""
    rows = []
    for kind, goal in (('match', 3.0), ('lomatch', 12.6)):
        split = f'room-{kind}-30-50'
        for full, off in ((OURS, 'no-mask'), ('lgr', 'lgr-no-mask')):
            gain, low, high, n = difference(scores, full, off, split)
            note = f'mean {gain:+.1f}, {low:+.1f} to {high:+.1f}, n = {n}' if n else ''
            name = f'gain of the mask, {split}, {full} - {off}: lower end of the 95 % interval'
            rows.append(Row(name, low, 0.01, goal, note))
    moving = of_split(scores, OURS, 'room-match-30-50', 'room-lomatch-30-50')
    for name, values in (
        ('mask AUC, network, superpoints', [s.mask_auc for s in moving]),
        ('mask AUC, result of register(), points', [s.point_mask_auc for s in moving]),
    ):
        value = float(np.nanmean(values)) if values else math.nan
        rows.append(Row(f'{name}, 30-50', value, 0.85, 0.98, f'n = {len(values)}', digits=3))
    return rows


def baseline_rows(scores: Scores) -> list[Row]:
    """Against the better classical method, per split with moving things."""
    rows = []
    for scene in ('room', 'street'):
        for kind in RECALL:
            for part in KINDS[1:]:
                split = f'{scene}-{kind}-{part}'
                found = [(difference(scores, OURS, m, split), m) for m in CLASSICAL]
                found = [f for f in found if f[0][3]]
                if found:
                    (gain, low, high, n), baseline = min(found)
                    note = f'{low:+.0f} to {high:+.0f}, n = {n}; {baseline}'
                    rows.append(
                        Row(f'RR points above the better classical, {split}', gain, 10, 25, note)
                    )
    return rows


def confidence_rows(
    scores: Scores, error_limits: tuple[float, float], wrong_limits: tuple[float, float]
) -> list[Row]:
    """Calibration over all pairs of all splits, with floor and goal of ECE and of wrong ones."""
    found = list(scores.get(OURS, {}).values())
    if not found:
        return []
    confidence = np.array([s.confidence for s in found])
    right = np.array([s.right for s in found])
    sure = confidence >= GATE
    wrong = 100 * float((~right[sure]).mean()) if sure.any() else math.nan
    note = f'{int((~right[sure]).sum())} of {int(sure.sum())} above {GATE}; n = {len(found)}'
    error = calibration.expected_calibration_error(confidence, right)
    return [
        Row('ECE of the confidence', error, *error_limits, f'n = {len(found)}', False, 3),
        Row('wrong above the gate %', wrong, *wrong_limits, note, False),
    ]


def cost_rows(bench: dict[str, Any] | None) -> list[Row]:
    """Time, memory, size."""
    path = packaged_weights()
    count = sum(p.size for p in load_checkpoint(path).parameters.values())
    rows = [
        Row('parameters, million', count / 1e6, 4, 2, '', False, 2),
        Row('weights file, MB', path.stat().st_size / 1e6, 12, 4, '', False),
    ]
    if bench:
        rounds = len(bench['wall_s']['register'])
        note = f'{bench["threads"]} thread(s), turn by turn, median of {rounds}'
        rows.append(
            Row(
                'time over KISS-Matcher', bench['ratio']['kiss-matcher'], 0.4, 0.15, note, False, 2
            )
        )
        rows.append(Row('memory of register(), MB', bench['memory_mb'], 300, 150, '', False, 0))
    return rows


def table(rows: list[Row]) -> str:
    """Markdown."""
    lines = ['| | measured | floor | goal | stands at | |', '|---|---|---|---|---|---|']
    for r in rows:
        value = '-' if math.isnan(r.value) else f'{r.value:.{r.digits}f}'
        lines.append(f'| {r.name} | {value} | {r.floor:g} | {r.goal:g} | {r.verdict} | {r.note} |')
    return '\n'.join(lines)


def methods_table(scores: Scores) -> str:
    """RR of every method and split."""
    splits = sorted({s.split for found in scores.values() for s in found.values()})
    lines = ['| RR % (n) | ' + ' | '.join(splits) + ' |', '|---' * (1 + len(splits)) + '|']
    for method in scores:
        cells = [of_split(scores, method, split) for split in splits]
        text = [f'{recall(c)[0]:.0f} ({len(c)})' if c else '-' for c in cells]
        lines.append(f'| {method} | ' + ' | '.join(text) + ' |')
    return '\n'.join(lines)


def main() -> None:
    """Merge the files, write JSON and tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('files', type=Path, nargs='+', help='JSON files of hybridreg evaluate')
    parser.add_argument('--bench', type=Path, help='JSON of hybridreg bench --peers')
    args = parser.parse_args()
    scores, sources = read(args.files)
    bench = json.loads(args.bench.read_text(encoding='utf-8')) if args.bench else None
    rows = [
        *recall_rows(scores, RECALL, 99),
        *real_rows(scores),
        *mask_rows(scores),
        *baseline_rows(scores),
        *confidence_rows(scores, (0.05, 0.02), (2, 0.1)),
        *cost_rows(bench),
    ]
    plain = [
        {**vars(r), 'value': None if math.isnan(r.value) else r.value, 'verdict': r.verdict}
        for r in rows
    ]
    text = json.dumps({'rows': plain, 'sources': sources}, indent=1) + '\n'
    (RESULTS / 'registration.json').write_text(text, encoding='utf-8')
    put(RESULTS / 'registration.md', 'registration-goals', table(rows))
    put(RESULTS / 'registration.md', 'registration-methods', methods_table(scores))
    print(table(rows))


if __name__ == '__main__':
    main()
