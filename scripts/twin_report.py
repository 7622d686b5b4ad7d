# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""docs/results/difficulty.md: what motion alone does to methods without a network.

Every pair of a 30-50 split is registered twice: as it is, and against the same target in which all
stands as in the source. Scene, views, crop and background are the same; both poses are judged on
the same points.

    python scripts/twin_report.py --pairs 50 --keep out/twins
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from docs_tables import put

from hybridreg_ros.core import provenance
from hybridreg_ros.data.hybridmatch.room_pairs import GENERATOR_VERSION, make_samples
from hybridreg_ros.data.hybridmatch.splits import first_seed
from hybridreg_ros.metrics import registration
from hybridreg_ros.training.baselines import METHODS
from hybridreg_ros.training.validation import overlap_points, threshold_m

if TYPE_CHECKING:
    from hybridreg_ros.data.hybridmatch.take import Sample
    from hybridreg_ros.data.pair import PointPair

ROOT = Path(__file__).resolve().parents[1]
SPLITS = ('room-match-30-50', 'room-lomatch-30-50', 'street-match-30-50')


def still_twin(sample: Sample) -> PointPair:
    """The pair with the target that was taken while all stood as in the source."""
    assert sample.still is not None
    n, m = len(sample.pair.source), len(sample.still)
    return replace(
        sample.pair,
        target=sample.still,
        dynamic_share=0.0,
        source_label=np.zeros(n, np.uint8),
        target_label=np.zeros(m, np.uint8),
        source_instance=np.zeros(n, np.uint16),
        target_instance=np.zeros(m, np.uint16),
    )


def judged(sample: Sample) -> dict[str, Any]:
    """Whether each method registers a pair, and its twin."""
    pair, points = sample.pair, overlap_points(sample.pair)
    row: dict[str, Any] = {'name': pair.name}
    for name, method in METHODS.items():
        for key, asked in (('moving', pair), ('still', still_twin(sample))):
            off = registration.rmse_m(pair.T_target_source, method(asked), points)
            row[f'{name} {key}'] = bool(off < threshold_m(pair.voxel_size_m))
    return row


def measure(split: str, pairs: int, keep: Path) -> list[dict[str, Any]]:
    """The first pairs of a test split; what `keep` holds is not measured again."""
    keep.mkdir(parents=True, exist_ok=True)
    path = keep / f'twins_{split}.jsonl'
    text = path.read_text('utf-8') if path.exists() else ''
    known = {row['name']: row for row in map(json.loads, text.splitlines())}
    found: list[dict[str, Any]] = []
    seed = first_seed('test', split)
    while len(found) < pairs:
        names = [name for name in known if f'-{seed:07d}-' in name]
        if not names:
            rows = [judged(s) for s in make_samples(split, seed, still=True)]
            with path.open('a', encoding='utf-8') as stream:
                stream.writelines(json.dumps(row) + '\n' for row in rows)
            known |= {row['name']: row for row in rows}
            names = [row['name'] for row in rows]
        found += [known[name] for name in names]
        seed += 1
    return found[:pairs]


def summary(split: str, found: list[dict[str, Any]], method: str) -> dict[str, Any]:
    """Recall of both, and how many pairs only one of the two could be registered."""
    moving, still = (
        np.array([row[f'{method} {k}'] for row in found]) for k in ('moving', 'still')
    )
    return {
        'split': split,
        'method': method,
        'pairs': len(found),
        'still': float(still.mean()),
        'moving': float(moving.mean()),
        'only_still': int((still & ~moving).sum()),
        'only_moving': int((moving & ~still).sum()),
    }


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown."""
    heads = (
        'split',
        'method',
        'pairs',
        'all stands %',
        'as it is %',
        'lost by motion',
        'won by motion',
    )
    lines = ['| ' + ' | '.join(heads) + ' |', '|---' * len(heads) + '|']
    lines += [
        f'| {r["split"]} | {r["method"]} | {r["pairs"]} | {100 * r["still"]:.0f} '
        f'| {100 * r["moving"]:.0f} | {r["only_still"]} | {r["only_moving"]} |'
        for r in rows
    ]
    return '\n'.join(lines)


def main() -> None:
    """Measure, write docs/results/data_twins.json, and the table in docs/results/difficulty.md."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--pairs', type=int, default=50, help='of each split (default 50)')
    parser.add_argument('--keep', type=Path, default=Path('out/twins'), help='measured so far')
    args = parser.parse_args()
    found = {split: measure(split, args.pairs, args.keep) for split in SPLITS}
    rows = [summary(split, found[split], method) for split in SPLITS for method in METHODS]
    about = {'generator': GENERATOR_VERSION, **provenance.collect().to_dict()}
    about['command'] = f'scripts/twin_report.py --pairs {args.pairs}'
    text = json.dumps({'rows': rows, 'provenance': about}, indent=1) + '\n'
    (ROOT / 'docs' / 'results' / 'data_twins.json').write_text(text, encoding='utf-8')
    put(ROOT / 'docs' / 'results' / 'difficulty.md', 'data-twins', table(rows))


if __name__ == '__main__':
    main()
