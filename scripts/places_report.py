# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the odometry says of itself where little holds it: degenerate places, blackouts, NEES.

Degenerate places (`hybridreg_ros/benchmark/places.py`): scans, wrong poses (more than 0.2 m or 2
degrees off the true pose since the start) with confidence above the gate, share of errors within
three standard deviations along every axis, position error at the end. Blackouts of 0.2 to 5 s in
walks, two of each long sequence: back on the old map within five good scans (right as the suite
has it, since the last scan before); wrong afterwards above the gate, and of these how many are
right in the same walk without the blackout.
NEES of the position (three degrees of freedom, so 2.4 is the median of consistent covariances).

    python scripts/places_report.py                          # the ten places, minutes
    python scripts/places_report.py --only tunnel field
    python scripts/places_report.py --blackouts dev-room-502 depth_7scenes
    python scripts/places_report.py --nees room-00 street-1 depth_7scenes --frames 100
"""

from __future__ import annotations

import argparse
import sys
from itertools import chain, cycle
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hybridreg_ros.benchmark import suite_data
from hybridreg_ros.benchmark.places import GATE, WRONG_DEG, WRONG_M, Score, all_places
from hybridreg_ros.benchmark.suite_list import SEQUENCES
from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.replay.page.tables import text_table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hybridreg_ros.benchmark.suite_data import SuiteFrame

ROOT = Path(__file__).resolve().parents[1]
DARK_S = (0.2, 0.5, 1.0, 2.0, 5.0)
"""Lengths of blackouts."""
BEFORE, SOON, AFTER = 8, 5, 12
"""Good scans before a blackout, those after which the pose must be back, and all afterwards."""
NEXT, WALKS = 100, 2
"""Of a long sequence, so many frames later another walk begins, and so many walks are taken."""


def places(names: Sequence[str]) -> list[list[str]]:
    """Rows of the table of places."""
    rows = [['place', 'scans', 'wrong', 'wrong above gate', 'within 3 sigma', 'end error m']]
    scores = []
    for place in all_places():
        if names and place.name not in names:
            continue
        odometry, score = HybridOdometry(), Score()
        for scan, truth in place.clouds():
            score.add(odometry.step(scan), truth)
        scores.append(score)
        rows.append([place.name, *_cells(score)])
    total = Score(*(list(chain(*(getattr(s, f) for s in scores))) for f in Score.__annotations__))
    return [*rows, ['all', *_cells(total)[:-1], '']]


def _cells(score: Score) -> list[str]:
    return [
        str(len(score.errors)),
        str(sum(score.wrong)),
        str(score.wrong_above_gate),
        f'{score.within_3_sigma:.3f}',
        f'{score.errors[-1]:.2f}',
    ]


def blackouts(names: Sequence[str], data: Path, cache: Path) -> list[list[str]]:
    """Rows of the table of blackouts: empty clouds in walks, of each length in turn."""
    rows = [['sequence', 'from', 'dark s', 'back after', 'wrong above gate', 'by the blackout']]
    counts = np.zeros(4, int)
    lengths = cycle(DARK_S)
    for name in names:
        frames = suite_data.load(SEQUENCES[name], data, cache)
        for first in range(0, len(frames), NEXT)[:WALKS]:
            dark_s, limits = next(lengths), SEQUENCES[name].limits
            walk = frames[first:]
            until = walk[BEFORE - 1].scan.stamp + round(dark_s * NS_PER_S)
            after = sum(f.scan.stamp <= until for f in walk) + AFTER
            through = _offs(walk[:after], until)
            ordinary = _offs(walk[:after], 0)
            back = next((k for k, off in enumerate(through, 1) if off.within(*limits)), np.inf)
            wrong = [off.sure and not off.within(WRONG_M, WRONG_DEG) for off in through]
            ours = [o.within(WRONG_M, WRONG_DEG) for o in ordinary[len(ordinary) - len(through) :]]
            blamed = sum(w and o for w, o in zip(wrong, ours, strict=True))
            counts += (back <= SOON, sum(wrong), blamed, len(through))
            cells = [f'{dark_s:g}', f'{back:g}', f'{sum(wrong)} of {len(through)}', str(blamed)]
            rows.append([name, str(first), *cells])
    total = [f'{counts[0]} of {len(rows) - 1}', f'{counts[1]} of {counts[3]}', str(counts[2])]
    return [*rows, ['all', '', '', *total]]


class Off(NamedTuple):
    """How far off a pose is since the last one before a blackout, and whether it is sure."""

    far_m: float
    far_deg: float
    sure: bool

    def within(self, limit_m: float, limit_deg: float) -> bool:
        """Whether the pose is right."""
        return self.far_m <= limit_m and self.far_deg <= limit_deg


def _offs(frames: list[SuiteFrame], until: int) -> list[Off]:
    """Errors of the poses after a blackout that ends at a stamp, ns (0: of all; there is none)."""
    odometry, moved, offs = HybridOdometry(), np.eye(4), []
    for k, frame in enumerate(frames):
        scan = frame.scan
        if k >= BEFORE and scan.stamp <= until:
            nothing = np.zeros((0, 3), np.float32)
            odometry.step(Scan(nothing, stamp=scan.stamp, frame_id=scan.frame_id))
            continue
        result = odometry.step(scan)
        if k < BEFORE:
            moved = result.pose @ se3.inverse(frame.T_world_sensor)
            continue
        off = se3.inverse(moved @ frame.T_world_sensor) @ result.pose
        far_m, far_deg = float(np.linalg.norm(off[:3, 3])), se3.rotation_angle_deg(off[:3, :3])
        offs.append(Off(far_m, far_deg, result.confidence >= GATE))
    return offs


def nees(names: Sequence[str], most: int | None, data: Path, cache: Path) -> list[list[str]]:
    """Rows of the table of consistency: position errors since the first scan, above the gate."""
    rows = [['sequence', 'scans', 'median NEES', '95 %', 'end error m', 'end sigma m']]
    medians = []
    for name in names:
        frames = suite_data.load(SEQUENCES[name], data, cache)[:most]
        odometry, start = HybridOdometry(), se3.inverse(frames[0].T_world_sensor)
        values, error, sigma = [], 0.0, 0.0
        for k, frame in enumerate(frames):
            result = odometry.step(frame.scan)
            off = (result.pose - start @ frame.T_world_sensor)[:3, 3]
            part = result.covariance[:3, :3]
            error, sigma = float(np.linalg.norm(off)), float(np.sqrt(np.trace(part)))
            if k and result.confidence >= GATE:
                values.append(float(off @ np.linalg.solve(part, off)))
        medians.append(float(np.median(values)))
        high = float(np.quantile(values, 0.95))
        cells = [str(len(values)), f'{medians[-1]:.2f}', f'{high:.1f}']
        rows.append([name, *cells, f'{error:.3f}', f'{sigma:.3f}'])
    return [*rows, ['median', '', f'{np.median(medians):.2f}', '', '', '']]


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables that were asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n', maxsplit=1)[0])
    parser.add_argument('--only', nargs='+', default=[], metavar='PLACE', help='these places')
    parser.add_argument('--blackouts', nargs='+', metavar='SEQUENCE', help='blackouts instead')
    parser.add_argument('--nees', nargs='+', metavar='SEQUENCE', help='consistency instead')
    parser.add_argument('--frames', type=int, metavar='N', help='with --nees: the first N of each')
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    parser.add_argument('--cache', type=Path, default=ROOT / 'out' / 'suite' / 'frames')
    args = parser.parse_args(argv)
    if args.nees:
        rows = nees(args.nees, args.frames, args.data, args.cache)
    elif args.blackouts:
        rows = blackouts(args.blackouts, args.data, args.cache)
    else:
        rows = places(args.only)
    print(text_table(rows))
    return 0


if __name__ == '__main__':
    sys.exit(main())
