# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""docs/results/data.md: distributions and contact sheets of generated splits, and their table.

python scripts/dataset_report.py data/test
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from docs_tables import put

from hybridreg_ros.data.hybridmatch.overview import draw_overview, overview_table, read_overview
from hybridreg_ros.data.hybridmatch.preview import draw_sheet
from hybridreg_ros.data.hybridmatch.room_pairs import SCENES
from hybridreg_ros.data.hybridmatch.shards import open_split

RESULTS = Path(__file__).resolve().parents[1] / 'docs' / 'results'


def cost_table(costs: list[dict[str, Any]]) -> str:
    """What `hybridreg bench --data --json` measured, as Markdown."""
    heads = (
        'split',
        'pairs',
        'CPU ms a pair',
        'of which ray casting',
        'pairs/s on two cores',
        'MB per 1,000 pairs',
        'peak MB',
    )
    lines = ['| ' + ' | '.join(heads) + ' |', '|---' * len(heads) + '|']
    lines += [
        f'| {c["split"]} | {c["pairs"]} | {1e3 * c["cpu_s"]:.0f} '
        f'| {100 * c["cast_s"] / c["cpu_s"]:.0f} % | {2 / c["cpu_s"]:.1f} '
        f'| {c["disk_kb"]:.0f} | {c["peak_mb"]:.0f} |'
        for c in costs
    ]
    return '\n'.join(lines)


def main() -> None:
    """Read the splits of a folder and write pictures, table and JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('splits', type=Path, help='folder with one folder per split')
    parser.add_argument('--row', type=int, default=20, help='pair of each split to show')
    args = parser.parse_args()
    found = read_overview(args.splits)
    for scene in SCENES:
        mine = [s for s in found if s.split.startswith(scene)]
        if mine:
            draw_overview(mine, RESULTS / f'hybridmatch_{scene}_distributions.png')
            pairs = [open_split(args.splits / s.split) for s in mine]
            shown = [p[min(args.row, len(p) - 1)] for p in pairs]
            draw_sheet(shown, RESULTS / f'hybridmatch_{scene}s.png')
    RESULTS.mkdir(exist_ok=True)
    text = json.dumps([asdict(s) for s in found], indent=1) + '\n'
    (RESULTS / 'dataset.json').write_text(text, encoding='utf-8')
    put(RESULTS / 'data.md', 'splits', overview_table(found))
    cost = RESULTS / 'data_cost.json'
    if cost.exists():
        put(RESULTS / 'data.md', 'cost', cost_table(json.loads(cost.read_text('utf-8'))['costs']))


if __name__ == '__main__':
    main()
