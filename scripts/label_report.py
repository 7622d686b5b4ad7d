# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""docs/results/data.md: are the labels right? The first test pairs of each split tell."""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from docs_tables import put

from hybridreg_ros.core import provenance
from hybridreg_ros.data.hybridmatch.room_pairs import GENERATOR_VERSION, SPLITS, make_samples
from hybridreg_ros.data.hybridmatch.splits import first_seed

ROOT = Path(__file__).resolve().parents[1]
HEADS = (
    'split',
    'pairs that can tell',
    'static: median, worst',
    'above 3',
    'beyond 10 sigma %',
    'movers: pairs that can tell %',
    'moving, carried by its motion',
    'moving, left in place',
    'of these above 3 sigma %',
)


def measure(split: str, pairs: int, keep: Path) -> list[dict[str, Any]]:
    """Checks of the first pairs of a split; what `keep` holds is not measured again."""
    sys.path.insert(0, str(ROOT / 'tests' / 'data'))
    from label_truth import check_labels

    keep.mkdir(parents=True, exist_ok=True)
    path = keep / f'labels_{split}.jsonl'
    text = path.read_text('utf-8') if path.exists() else ''
    found: list[dict[str, Any]] = [json.loads(line) for line in text.splitlines()]
    seed = first_seed('test', split)
    if found:  # whole scenes are kept, in order; names end in scene and pair
        seed = int(found[-1]['name'].split('-')[-2]) + 1
    while len(found) < pairs:
        new = [
            {'name': sample.pair.name, **asdict(check_labels(sample))}
            for sample in make_samples(split, seed)
        ]
        with path.open('a', encoding='utf-8') as stream:
            stream.write(''.join(json.dumps(row) + '\n' for row in new))
        found += new
        seed += 1
    return found[:pairs]


def summary(split: str, found: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians over pairs."""
    value = {k: np.array([f[k] for f in found], float) for k in found[0] if k != 'name'}
    tell = ~np.isnan(value['left'])
    told = value['static'][~np.isnan(value['static'])]
    row: dict[str, Any] = {
        'split': split,
        'pairs': len(found),
        'static_told': len(told),
        'static_median': float(np.median(told)),
        'static_worst': float(told.max()),
        'static_above_3': int((told >= 3.0).sum()),
        'stray': float(np.median(value['stray'])),
        'tell': float(tell.mean()),
    }
    if tell.any():
        row |= {
            'carried': float(np.median(value['carried'][tell])),
            'left': float(np.median(value['left'][tell])),
            'left_above_3': float((value['left'][tell] > 3.0).mean()),
        }
    return row


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown; distances in sigmas."""
    lines = ['| ' + ' | '.join(HEADS) + ' |', '|---' * len(HEADS) + '|']
    for r in rows:
        moving = ['-'] * 4
        if r.get('left', math.nan) == r.get('left'):
            moving = [
                f'{100 * r["tell"]:.0f}',
                f'{r["carried"]:.1f}',
                f'{r["left"]:.0f}',
                f'{100 * r["left_above_3"]:.0f}',
            ]
        still = [
            r['split'],
            f'{r["static_told"]} of {r["pairs"]}',
            f'{r["static_median"]:.2f}, {r["static_worst"]:.2f}',
            str(r['static_above_3']),
            f'{100 * r["stray"]:.1f}',
        ]
        lines.append('| ' + ' | '.join(still + moving) + ' |')
    return '\n'.join(lines)


def main() -> None:
    """Measure, write docs/results/data_labels.json, and the table in docs/results/data.md."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--pairs', type=int, default=50, help='of each split (default 50)')
    parser.add_argument('--keep', type=Path, default=Path('out/labels'), help='measured so far')
    args = parser.parse_args()
    rows = [summary(split, measure(split, args.pairs, args.keep)) for split in SPLITS]
    about = {'generator': GENERATOR_VERSION, **provenance.collect().to_dict()}
    about['command'] = f'scripts/label_report.py --pairs {args.pairs}'
    folder = ROOT / 'docs' / 'results'
    folder.mkdir(exist_ok=True)
    text = json.dumps({'rows': rows, 'provenance': about}, indent=1) + '\n'
    (folder / 'data_labels.json').write_text(text, encoding='utf-8')
    put(folder / 'data.md', 'labels', table(rows))


if __name__ == '__main__':
    main()
