# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""docs/results/odometry.md: how the resident memory of the front end grows over a looped sequence.

The scans of a sequence are played forth and back, network and all. The times of their points do
not hold on the way back: the motion during each scan is undone by the true poses beforehand. One
process measures one sequence; the table holds all measured so far. In the folder of the suite they
become a row of the table of goals (`hybridreg replay --suite all --table-only`).

    python scripts/memory_report.py dev-room-933 --steps 10000    # half an hour
    python scripts/memory_report.py dev-street-6205 --steps 2000  # half an hour
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from docs_tables import put

from hybridreg_ros.benchmark import suite_data
from hybridreg_ros.benchmark.suite_list import SEQUENCES
from hybridreg_ros.benchmark.suite_memory import NAME, WARM_STEPS, growth_mb, read
from hybridreg_ros.core import provenance
from hybridreg_ros.core.pages import resident_mb
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.result import Source
from hybridreg_ros.replay.session import open_front_end

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hybridreg_ros.benchmark.suite_list import Sequence as SuiteSequence

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / 'docs' / 'results' / NAME
FRAMES = 100
"""Of a sequence; more are not looped over."""


def looped(count: int, step: int) -> int:
    """Number of the frame of a step when `count` frames are played forth and back."""
    place = step % max(1, 2 * count - 2)
    return place if place < count else 2 * count - 2 - place


def loop_of(sequence: SuiteSequence, data: Path, cache: Path) -> list[Scan]:
    """The scans of a sequence that are looped over, none of them bent by motion.

    Args:
        sequence: which one.
        data: folder of the real recordings.
        cache: folder in which simulated frames are kept.
    """
    frames = suite_data.load(sequence, data, cache)
    if frames[0].scan.times is not None:
        frames = suite_data.load(replace(sequence, deskewed=True), data, cache)
    return [f.scan for f in frames[:FRAMES]]


def measure(clouds: Sequence[Scan], period_s: float, steps: int) -> dict[str, Any]:
    """Run the front end on the looped clouds.

    Args:
        clouds: scans in order, sensor frame, metres.
        period_s: seconds from one to the next.
        steps: scans to give it, more than `5 * WARM_STEPS`.

    Returns:
        Resident memory in MB by step, and how many poses were the network's.
    """
    marks = {
        WARM_STEPS,
        5 * WARM_STEPS,
        *range(10 * WARM_STEPS, steps, 10 * WARM_STEPS),
        steps - 1,
    }
    odometry, found, by_network = open_front_end(OdometryConfig(), None), {}, 0
    for k in range(steps):
        points = clouds[looped(len(clouds), k)].points
        stamp = (1 + round(k * period_s * 1e3)) * (NS_PER_S // 1000)
        result = odometry.step(Scan(points, stamp=stamp, frame_id='sensor'))
        by_network += result.source is Source.HYBRIDREG
        if k in marks:
            found[str(k)] = resident_mb()
            print(f'{k} of {steps} steps: {found[str(k)]:.1f} MB', file=sys.stderr)
    return {'resident_mb': found, 'by_network': by_network}


def table(rows: dict[str, dict[str, Any]]) -> str:
    """Markdown of rows by sequence: what `measure` gives, `points` of a scan and `steps`."""
    lines = [
        f'| sequence | points | steps | by network | MB after {WARM_STEPS} steps | after '
        f'{5 * WARM_STEPS} | at the end | grown by |',
        '|---|---|---|---|---|---|---|---|',
    ]
    for name, row in sorted(rows.items()):
        at = row['resident_mb']
        first, middle, last = (
            at[str(WARM_STEPS)],
            at[str(5 * WARM_STEPS)],
            at[str(row['steps'] - 1)],
        )
        lines.append(
            f'| {name} | {row["points"]:,} | {row["steps"]:,} | {row["by_network"]:,} '
            f'| {first:.1f} | {middle:.1f} | {last:.1f} | {growth_mb(row):.1f} |'
        )
    return '\n'.join(lines)


def main() -> None:
    """Measure, write docs/results/memory.json, and the table in docs/results/odometry.md."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('sequence', help='of the benchmark or the development suite')
    parser.add_argument('--steps', type=int, default=10_000, help='above 500 (default 10,000)')
    parser.add_argument('--data', type=Path, default=Path('../shared/data'), help='recordings')
    parser.add_argument('--out', type=Path, default=Path('out/suite'), help='of the suite')
    parser.add_argument('--cache', type=Path, default=Path('out/suite/cache'), help='simulated')
    args = parser.parse_args()
    if args.sequence not in SEQUENCES:
        parser.error(f'sequence: {args.sequence!r} is none of {", ".join(SEQUENCES)}')
    if args.steps <= 5 * WARM_STEPS:
        parser.error(f'--steps: expected more than {5 * WARM_STEPS}, found {args.steps}')
    sequence = SEQUENCES[args.sequence]
    clouds = loop_of(sequence, args.data, args.cache)
    row = measure(clouds, sequence.period_s, args.steps)
    row |= {'points': max(len(c.points) for c in clouds), 'steps': args.steps}
    row['provenance'] = provenance.collect().to_dict()
    rows = {**read(RESULTS.parent), args.sequence: row}
    args.out.mkdir(parents=True, exist_ok=True)
    for path in (RESULTS, args.out / NAME):
        path.write_text(json.dumps(rows, indent=1) + '\n', encoding='utf-8')
    put(ROOT / 'docs' / 'results' / 'odometry.md', 'memory', table(rows))


if __name__ == '__main__':
    main()
