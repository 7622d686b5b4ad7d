# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""docs/results.md: how hard the splits are for methods without a network, beside real pairs.

    python scripts/difficulty_report.py out/fpfh-*.json out/kiss-matcher-*.json

takes what `hybridreg evaluate --method ... --json` wrote. Of a split that stands in several files
the one with most pairs counts.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from docs_tables import put

from hybridreg_ros.data.hybridmatch import SPLITS

DOCS = Path(__file__).resolve().parents[1] / 'docs'
KEYS = ('pairs', 'RR', 'RR_95', 'RRE_deg', 'RTE_m')


def collect(files: list[Path]) -> dict[str, Any]:
    """Results by split and method, and where they come from."""
    splits: dict[str, dict[str, Any]] = {}
    sources = []
    for file in files:
        report = json.loads(file.read_text(encoding='utf-8'))
        about = report['about']
        sources.append(about)
        for row in report['rows']:
            cells = splits.setdefault(row['split'], {})
            known = cells.get(about['method'], {'pairs': 0})
            if row['split'] != 'all' and row['pairs'] > known['pairs']:
                cells[about['method']] = {key: row[key] for key in KEYS}
    splits.pop('all', None)
    return {'splits': splits, 'sources': sources}


def table(found: dict[str, Any]) -> str:
    """Recall in percent with its 95 % interval, pairs in brackets."""
    splits = found['splits']
    methods = sorted({m for cells in splits.values() for m in cells})
    order = [s for s in SPLITS if s in splits] + sorted(set(splits) - set(SPLITS))
    lines = ['| pairs of | ' + ' | '.join(methods) + ' |', '|---' * (1 + len(methods)) + '|']
    for split in order:
        cells = [_cell(splits[split].get(method)) for method in methods]
        lines.append(f'| {split} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines)


def _cell(row: dict[str, Any] | None) -> str:
    if row is None:
        return '-'
    low, high = row['RR_95']
    return f'{100 * row["RR"]:.0f} ({100 * low:.0f} to {100 * high:.0f}; n = {row["pairs"]})'


def main() -> None:
    """Merge the files, write JSON and table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('files', type=Path, nargs='+', help='JSON files of hybridreg evaluate')
    found = collect(sorted(parser.parse_args().files))
    (DOCS / 'results').mkdir(exist_ok=True)
    text = json.dumps(found, indent=1) + '\n'
    (DOCS / 'results' / 'data_difficulty.json').write_text(text, encoding='utf-8')
    put(DOCS / 'results.md', 'data-difficulty', table(found))


if __name__ == '__main__':
    main()
