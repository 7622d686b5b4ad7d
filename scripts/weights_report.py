# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The weights against their floors and goals: one attempt per pair, at the budget of the node.

    for s in room street; do for k in match lomatch; do for m in rigid 10-30 30-50; do
      hybridreg generate $s-$k-$m --part val --pairs 100 --out data/val/$s-$k-$m; done; done; done
    hybridreg generate street-recorded --part val --pairs 96 --out data/val/street-recorded
    python scripts/weights_report.py data/val                # the packaged weights
    python scripts/weights_report.py data/val --weights runs/1/best.safetensors --limit 24

Recordings (--data) are left out where they are missing. About a second per pair and core.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from goals_report import OURS, REAL, Row, Scores, confidence_rows, recall, recall_rows, table

from hybridreg_ros.core import se3
from hybridreg_ros.core.progress import progress
from hybridreg_ros.data.loaders.clouds import read_cloud
from hybridreg_ros.data.loaders.labelled import open_labelled
from hybridreg_ros.data.loaders.openers import open_pairs
from hybridreg_ros.data.loaders.posed_frames import recorded_pair
from hybridreg_ros.metrics.registration import bootstrap_interval
from hybridreg_ros.model.budget import Budget
from hybridreg_ros.training.evaluate import evaluate, recorded_pairs
from hybridreg_ros.training.moving import score_moving
from hybridreg_ros.training.variants import load_variant

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from hybridreg_ros.data.pair import PointPair
    from hybridreg_ros.model.register import HybridReg
    from hybridreg_ros.training.report import PairScore

BUDGET = Budget(5_000, 256)
ROOMS = {'match': ((99, 97, 93), (99.5, 98.5, 97)), 'lomatch': ((86, 78, 77), (94, 86, 84))}
"""Floors and goals of RR, in percent, of each of `goals_report.KINDS`."""
CARS = (
    'lidar_semantickitti_04',
    'lidar_semantickitti_01',
    'lidar_kitti_tracking_0000_a',
    'lidar_nuscenes_1072_a',
)
KITTI = 'pairs_kitti10m'
_TILT_DEG = 20.0
_TURNS = 4
"""Random turns of each pair."""


def scored(model: HybridReg, pairs: Sequence[PointPair], text: str) -> list[PairScore]:
    """Scores of some pairs, with a progress bar."""
    found: list[PairScore] = []
    for pair in progress(pairs, len(pairs), text, 'pair'):
        found += evaluate(model, [pair], budget=BUDGET).scores
    return found


def turned(pair: PointPair, R: np.ndarray) -> PointPair:
    """The pair with both clouds turned about their sensors by R (3, 3)."""
    T = se3.transform(R, np.zeros(3))
    return dataclasses.replace(
        pair,
        source=se3.apply(T, pair.source).astype(np.float32),
        target=se3.apply(T, pair.target).astype(np.float32),
        T_target_source=T @ pair.T_target_source @ se3.inverse(T),
    )


def kitti_pairs(folder: Path) -> list[PointPair]:
    """Pairs of scans ten metres apart: NNN_pts_src.ply, NNN_pts_dst.ply, NNN_trans.txt."""
    pairs = []
    for file in sorted(folder.glob('*_trans.txt')):
        name = file.name[: -len('_trans.txt')]
        source, target = (read_cloud(folder / f'{name}_pts_{k}.ply') for k in ('src', 'dst'))
        T = se3.orthonormalise(np.loadtxt(file))
        pairs.append(recorded_pair(source, target, T, 0.3, f'{KITTI}-{name}'))
    return pairs


def split_rows(scores: dict[str, list[PairScore]]) -> list[Row]:
    """Registration of the generated splits, and the confidence over all of them."""
    every: Scores = {OURS: {s.name: s for found in scores.values() for s in found}}
    rows = recall_rows(every, ROOMS, 97)
    for kind, floor, goal in (('match', 86, 96.6), ('lomatch', 55, 73.6)):
        found = scores.get(f'room-{kind}-30-50', [])
        alone = 100 * float(np.mean([s.coarse_right for s in found])) if found else math.nan
        rows.append(Row(f'LGR alone % room-{kind}-30-50', alone, floor, goal, f'n = {len(found)}'))
    return [*rows, *confidence_rows(every, (0.02, 0.01), (1.0, 0.1))]


def turn_rows(
    model: HybridReg, splits: dict[str, list[PointPair]], scores: dict[str, list[PairScore]]
) -> list[Row]:
    """What turning both clouds costs where streets overlap little."""
    low = [name for name in splits if name.startswith('street-lomatch')]
    pairs = [p for name in low for p in splits[name]]
    if not pairs:
        return []
    many = pairs * _TURNS
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (2, len(many)))
    yaws = [se3.so3_exp(np.array([0.0, 0.0, a])) for a in angles[0]]
    tilt = math.radians(_TILT_DEG)
    tilts = [se3.so3_exp(tilt * np.array([np.cos(a), np.sin(a), 0.0])) for a in angles[1]]
    as_they_are = np.array([s.right for name in low for s in scores[name]])
    rows = []
    for name, turns in (('any yaw', yaws), (f'tilt {_TILT_DEG:g} deg', tilts)):
        moved = [turned(p, R) for p, R in zip(many, turns, strict=True)]
        right = np.array([s.right for s in scored(model, moved, name)]).reshape(_TURNS, -1)
        lost = 100.0 * (as_they_are - right.mean(axis=0))
        low_end, high_end = bootstrap_interval(lost)
        note = f'{low_end:.1f} to {high_end:.1f}, n = {len(pairs)}, {_TURNS} turns each'
        text = f'street-lomatch, {name}: loss in points of RR'
        rows.append(Row(text, float(lost.mean()), 2, 0, note, False))
    return rows


def real_rows(model: HybridReg, data: Path) -> list[Row]:
    """Recorded pairs."""
    rooms = [p for name in REAL if (data / name).is_dir() for p in recorded_pairs(data / name)]
    found = scored(model, rooms, 'recorded rooms') if rooms else []
    done = [s.rte_m for s in found if s.right]
    middle = 100 * float(np.median(done)) if done else math.nan
    streets = kitti_pairs(data / KITTI) if (data / KITTI).is_dir() else []
    far = scored(model, streets, KITTI) if streets else []
    return [
        Row('RR % recorded room pairs', *_both(recall(found), 100)),
        Row('median RTE cm, recorded room pairs', middle, 4.0, 2.5, f'n = {len(done)}', False),
        Row('RR % KITTI, 10 m apart', *_both(recall(far), 100)),
    ]


def _both(found: tuple[float, str], limit: float) -> tuple[float, float, float, str]:
    return found[0], limit, limit, found[1]


def moving_rows(model: HybridReg, splits: Path, data: Path, limit: int) -> list[Row]:
    """How well P(static) tells what moves."""

    def rows_of(folders: Iterable[Path], pairs: int) -> list[dict[str, float]]:
        found = []
        for folder in folders:
            if not folder.is_dir():
                continue
            source = open_labelled(folder, 0.5)
            count = min(pairs, len(source))
            numbers = np.linspace(0, len(source) - 1, count).round().astype(int)
            chosen = progress(
                (source.labelled(int(k)) for k in numbers), count, folder.name, 'pair'
            )
            found.append(score_moving(model, chosen, folder.name, BUDGET).row())
        return found

    cars = rows_of((data / name for name in CARS), 10)
    people = rows_of([splits / 'street-recorded'], max(limit, 32))
    rooms = rows_of([splits / 'room-match-30-50'], max(limit, 24))
    mean = float(np.mean([r['AUC_static'] for r in cars])) if cars else math.nan
    note = ', '.join(f'{r["AUC_static"]:.3f}' for r in cars)
    person = people[0]['people_AUC_static'] if people else math.nan
    room = rooms[0]['seen_AUC_static'] if rooms else math.nan
    return [
        Row('AUC of moving points, recorded cars, 0.5 s apart', mean, 0.93, 0.98, note, digits=3),
        Row('AUC of walking people, 5 to 25 m, simulated streets', person, 0.90, 0.97, digits=3),
        Row('AUC rooms 30-50 against static that is seen', room, 0.92, 0.98, digits=3),
    ]


def main() -> None:
    """Score, print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('splits', type=Path, help='folder of the generated splits')
    parser.add_argument('--data', type=Path, default=Path('../shared/data'), help='recordings')
    parser.add_argument('--weights', type=Path, help='weights file (default: the packaged one)')
    parser.add_argument('--limit', type=int, default=24, help='pairs of each split at most')
    parser.add_argument('--json', type=Path, help='file for the rows too')
    args = parser.parse_args()
    model = load_variant('hybridreg', args.weights, attempts=1)
    splits = {}
    for kind in ('room', 'street'):
        for folder in sorted(args.splits.glob(f'{kind}-*match-*')):
            source = open_pairs(folder)
            splits[folder.name] = [source[k] for k in range(min(args.limit, len(source)))]
    scores = {name: scored(model, pairs, name) for name, pairs in splits.items()}
    rows = [
        *split_rows(scores),
        *turn_rows(model, splits, scores),
        *real_rows(model, args.data),
        *moving_rows(model, args.splits, args.data, args.limit),
    ]
    print(table(rows))
    if args.json:
        plain = [{**vars(r), 'verdict': r.verdict} for r in rows]
        args.json.write_text(json.dumps(plain, indent=1) + '\n', encoding='utf-8')


if __name__ == '__main__':
    main()
