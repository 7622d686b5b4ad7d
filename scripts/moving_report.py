# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which points move: the front end, a test of two scans and DUFOMap on the same labelled scans.

    python scripts/moving_report.py                      # everything
    python scripts/moving_report.py --only people demo   # some groups
    python scripts/moving_report.py --no-dufomap --json out/moving.json
    python scripts/moving_report.py --only recorded --pictures docs/results

All methods get the poses of the front end. Points from 1 to 50 m count (people: 5 to 25 m, and
only they), and the first scan does not. DUFOMap (pip install dufomap) sees the whole recording
before it says anything. CPU is that of the mask alone, median ms a scan.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.benchmark import suite_data
from hybridreg_ros.benchmark.suite_list import SEQUENCES
from hybridreg_ros.core.scan import NO_RETURN_M, NS_PER_S, Scan
from hybridreg_ros.data.hybridmatch.recorded_streets import recorded_frames
from hybridreg_ros.data.loaders.labelled import LabelledScans, Moving
from hybridreg_ros.data.pair import Label
from hybridreg_ros.metrics.mask import MaskCounts, count, score
from hybridreg_ros.odometry import world
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.visibility.range_image import FRONT, RangeImage, view_of
from hybridreg_ros.replay.page.tables import text_table
from hybridreg_ros.replay.recording import EPOCH_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    F64 = NDArray[np.float64]
    Mask = NDArray[np.bool_]
    Row = dict[str, Any]

ROOT = Path(__file__).resolve().parents[1]
CACHE = ROOT / 'out' / 'suite' / 'frames'
RECORDED = (
    'lidar_semantickitti_04',
    'lidar_semantickitti_01',
    'lidar_kitti_tracking_0000_a',
    'lidar_nuscenes_1072_a',
)
STILL = ('lidar_balm_walk_a', 'depth_7scenes')
SIMULATED = (
    'dev-room-502',
    'dev-room-505',
    'dev-room-507',
    'dev-room-911',
    'dev-room-933',
    'dev-street-504',
    'dev-street-6202',
)
PEOPLE = range(6_291_000, 6_291_012)
"""Seeds of streets as recorded; nothing is fitted to them."""
DEMO_SEED, DEMO_FRAMES = 1, 60
COUNTED_M, PEOPLE_M = (1.0, 50.0), (5.0, 25.0)
DUFOMAP = {'resolution': 0.1, 'd_s': 0.2, 'd_p': 2, 'num_threads': 1}
"""Settings of its paper."""
TWO_SCANS = (0.15, 0.015)
"""Slack of the test of two scans: metres, and share of the range."""


@dataclass(frozen=True, eq=False)
class Shown:
    """A scan with labels (N,): which points move, and which of them count."""

    scan: Scan
    moves: Mask
    counts: Mask


def recorded(name: str, data: Path) -> Iterator[Shown]:
    """A labelled recording."""
    scans = LabelledScans(data / name, gap_s=0.1)
    assert scans.times_s is not None
    for k, time_s in enumerate(scans.times_s.tolist()):
        label, points = scans.labels(k), scans.cloud(k)
        counts = (label != Moving.UNLABELLED) & within(points, COUNTED_M)
        stamp = round((EPOCH_S + time_s) * NS_PER_S)
        yield Shown(Scan(points, stamp=stamp, frame_id='lidar'), label == Moving.MOVING, counts)


def of_suite(name: str, data: Path, frames: int) -> Iterator[Shown]:
    """The first frames of a sequence of the suite."""
    for frame in suite_data.load(SEQUENCES[name], data, ROOT / 'out' / 'suite' / 'frames')[
        :frames
    ]:
        assert frame.moving is not None
        yield Shown(frame.scan, frame.moving, np.ones(len(frame.scan), np.bool_))


def people(seed: int, frames: int = 20) -> Iterator[Shown]:
    """A simulated street; only people (what deforms) and what stands still count."""
    for frame in recorded_frames(seed, np.arange(frames) / 10.0):
        seen = np.isfinite(frame.points[:, 0])
        points, label = frame.points[seen], frame.label[seen]
        times = None if frame.times is None else frame.times[seen]
        stamp = round((EPOCH_S + frame.stamp_s) * NS_PER_S)
        counts = (label != Label.MOVING_RIGID) & within(points, PEOPLE_M)
        yield Shown(Scan(points, times, stamp, 'lidar'), label == Label.DEFORMING, counts)


def demo() -> Iterator[Shown]:
    """The room of `hybridreg demo`."""
    room = replace(
        SEQUENCES['dev-room-505'], name='demo', frames=DEMO_FRAMES, share='10-30', seed=DEMO_SEED
    )
    for frame in suite_data.load(room, CACHE, CACHE):
        assert frame.moving is not None
        yield Shown(frame.scan, frame.moving, np.ones(len(frame.scan), np.bool_))


def within(points: NDArray[np.float32], limits: tuple[float, float]) -> Mask:
    """Which points (N, 3) lie between two ranges."""
    r = np.linalg.norm(points, axis=1)
    inside: Mask = (r >= limits[0]) & (r < limits[1])
    return inside


@dataclass(frozen=True, eq=False)
class Answer:
    """What a method says about a sequence.

    Attributes:
        masks: what moves, by scan.
        cpu_s: CPU time of each, seconds.
        known: whether the rest is published as static; empty = always.
    """

    masks: list[Mask]
    cpu_s: list[float]
    known: list[bool] = field(default_factory=list)


def ours(scans: list[Scan]) -> tuple[Answer, list[F64]]:
    """The front end with its defaults, and its poses."""
    cpu: list[float] = []
    with timed(cpu, ('moving', '_remember')):
        front_end = HybridOdometry()
        threshold = front_end.config.dynamics.threshold
        masks, poses, known = [], [], []
        for scan in scans:
            cpu.append(0.0)
            result = front_end.step(scan)
            masks.append(result.dynamic_probability >= threshold)
            poses.append(result.pose)
            known.append(result.mask_known)
    return Answer(masks, cpu, known), poses


class timed:  # noqa: N801
    """Adds the CPU time that some methods of `World` take to the last entry of a list."""

    def __init__(self, cpu: list[float], names: tuple[str, ...]) -> None:
        self._cpu = cpu
        self._before = {name: getattr(world.World, name) for name in names}

    def __enter__(self) -> None:
        """Begin."""
        for name, method in self._before.items():
            setattr(world.World, name, self._clocked(method))

    def __exit__(self, *_: object) -> None:
        """Put the methods back."""
        for name, method in self._before.items():
            setattr(world.World, name, method)

    def _clocked(self, method: Callable[..., object]) -> Callable[..., object]:
        def clocked(*args: object, **options: object) -> object:
            began = time.thread_time()
            try:
                return method(*args, **options)
            finally:
                self._cpu[-1] += time.thread_time() - began

        return clocked


def two_scans(scans: list[Scan], poses: list[F64]) -> Answer:
    """Moving is what stands in space that the scan before saw free."""
    masks, cpu, last, view = [], [], None, None
    for scan, pose in zip(scans, poses, strict=True):
        began = time.thread_time()
        if view is None:
            forward = np.abs(scan.points.mean(axis=0)).max() > 1.0
            view = view_of(scan.points, 'depth' if forward and scan.shape[0] > 200 else 'lidar')
        image = RangeImage(scan.points, view, pose)
        free = np.zeros(len(scan), np.bool_)
        if last is not None:
            free = last.stand(scan.points, pose, *TWO_SCANS) == FRONT
        masks.append(free)
        last = image
        cpu.append(time.thread_time() - began)
    return Answer(masks, cpu)


def dufomap(scans: list[Scan], poses: list[F64]) -> Answer:
    """DUFOMap, which sees the whole sequence first; it takes no points at the sensor."""
    from dufomap import dufomap as Map  # type: ignore[import-untyped,import-not-found,unused-ignore]

    began = time.process_time()
    grid = Map(**DUFOMAP)
    for scan, pose in zip(scans, poses, strict=True):
        grid.run(scan.points[np.linalg.norm(scan.points, axis=1) > NO_RETURN_M], pose)
    grid.oncePropagateCluster(if_propagate=True, if_cluster=False)
    masks = [np.asarray(grid.segment(s.points, p)) > 0 for s, p in zip(scans, poses, strict=True)]
    each = (time.process_time() - began) / len(scans)
    return Answer(masks, [each] * len(scans))


def counts_of(shown: list[Shown], answer: Answer, first: int = 1, last: int = 10**9) -> MaskCounts:
    """Confusion counts of the scans from `first` to before `last`."""
    total = MaskCounts()
    for frame, mask in list(zip(shown, answer.masks, strict=True))[first:last]:
        total += count(mask[frame.counts], frame.moves[frame.counts])
    return total


def published(shown: list[Shown], answer: Answer, last: int | None = None) -> float:
    """Share of the points published as static that move, first scan included."""
    known = answer.known or [True] * len(shown)
    still = [~mask & know for mask, know in zip(answer.masks, known, strict=True)][:last]
    moving = sum(int((s & f.moves).sum()) for s, f in zip(still, shown, strict=False))
    return moving / max(1, sum(int(s.sum()) for s in still))


def sources(data: Path, only: list[str]) -> Iterator[tuple[str, str, list[Shown]]]:
    """Group, name and frames of everything that is scored."""
    if 'recorded' in only:
        for name in RECORDED:
            yield 'recorded', name, list(recorded(name, data))
    if 'people' in only:
        for seed in PEOPLE:
            yield 'people', f'people-{seed}', list(people(seed))
    if 'simulated' in only:
        for name in SIMULATED:
            yield 'simulated', name, list(of_suite(name, data, 40))
    if 'still' in only:
        for name in STILL:
            yield 'still', name, list(of_suite(name, data, 100))
    if 'demo' in only:
        yield 'demo', 'demo', list(demo())


GROUPS = ('recorded', 'people', 'simulated', 'still', 'demo')


COLOURS = {'right': '#0072b2', 'missed': '#e69f00', 'false': '#000000'}


def picture(path: Path, name: str, shown: list[Shown], answer: Answer) -> None:
    """A frame as the sensor sees it: the one of the last two thirds in which most moves."""
    from matplotlib.figure import Figure

    late = range(len(shown) // 3, len(shown))
    k = max(late, key=lambda i: int((shown[i].moves & shown[i].counts).sum()))
    points, counts, moves = shown[k].scan.points, shown[k].counts, shown[k].moves
    called = answer.masks[k]
    azimuth = np.rad2deg(np.arctan2(points[:, 1], points[:, 0]))
    elevation = np.rad2deg(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    figure = Figure(figsize=(11.0, 2.6), layout='constrained')
    axes = figure.add_subplot()
    r = np.linalg.norm(points, axis=1)
    near_last = np.argsort(-r)
    grey = np.clip(0.55 + 0.4 * np.log(np.maximum(r, 1.0)) / np.log(50.0), 0.0, 0.95)
    axes.scatter(azimuth[near_last], elevation[near_last], 0.4, grey[near_last], cmap='gray',
                 vmin=0.0, vmax=1.0, linewidths=0)  # fmt: skip
    parts = {'right': called & moves, 'missed': ~called & moves, 'false': called & ~moves}
    for word, rows in parts.items():
        some = rows & counts
        label = f'{word}: {int(some.sum())}'
        axes.scatter(azimuth[some], elevation[some], 1.6, COLOURS[word], linewidths=0, label=label)
    axes.set(xlim=(180, -180), xlabel='azimuth, degrees', ylabel='elevation, degrees')
    low, high = np.percentile(elevation, [0.2, 99.8])
    axes.set(ylim=(low - 1.0, high + 1.0), title=f'{name}, scan {k}')
    axes.legend(loc='lower left', markerscale=5, fontsize=8, ncols=3)
    path.mkdir(parents=True, exist_ok=True)
    figure.savefig(path / f'moving_{name}.png', dpi=100)


def measured(
    group: str, name: str, shown: list[Shown], with_dufomap: bool, pictures: Path | None = None
) -> list[Row]:
    """One row a method."""
    scans = [frame.scan for frame in shown]
    mine, poses = ours(scans)
    if pictures is not None:
        picture(pictures, name, shown, mine)
    answers = {'ours': mine, 'two scans': two_scans(scans, poses)}
    if with_dufomap:
        answers['dufomap'] = dufomap(scans, poses)
    return [
        {
            'group': group,
            'name': name,
            'method': method,
            'all': vars(counts_of(shown, answer)),
            'early': vars(counts_of(shown, answer, 1, 4)),
            'published': published(shown, answer),
            'published_early': published(shown, answer, 4),
            'cpu_ms': 1e3 * float(np.median(answer.cpu_s[1:])),
        }
        for method, answer in answers.items()
    ]


def line(row: Row) -> list[str]:
    """A row of the table."""
    every, early = (score(MaskCounts(**row[key])) for key in ('all', 'early'))
    quotients = (every.iou, every.precision, every.recall, early.iou)
    shares = (every.false_share, row['published'], row['published_early'])
    return [
        str(row['name']),
        str(row['method']),
        *(f'{q:.3f}' for q in quotients),
        *(f'{100 * float(s):.2f}' for s in shares),
        f'{row["cpu_ms"]:.1f}',
    ]


def pooled(rows: list[Row], group: str, method: str) -> Row:
    """The sum of a group."""
    some = [r for r in rows if r['group'] == group and r['method'] == method]
    sums = {
        key: vars(sum((MaskCounts(**r[key]) for r in some), MaskCounts()))
        for key in ('all', 'early')
    }
    means = {
        key: float(np.mean([r[key] for r in some]))
        for key in ('published', 'published_early', 'cpu_ms')
    }
    return {'group': group, 'name': f'{group}: all points', 'method': method, **sums, **means}


HEAD = ['sequence', 'method', 'IoU', 'precision', 'recall', 'IoU of scans 2-4', 'falsely moving %',
        'moving in static cloud %', 'in scans 1-4 %', 'CPU ms']  # fmt: skip


def table(rows: list[Row]) -> str:
    """All rows, the sum of each group, and its mean IoU."""
    lines, notes = [HEAD], []
    for group in dict.fromkeys(str(r['group']) for r in rows):
        lines += [line(r) for r in rows if r['group'] == group]
        for method in dict.fromkeys(str(r['method']) for r in rows):
            lines.append(line(pooled(rows, group, method)))
            some = [r for r in rows if r['group'] == group and r['method'] == method]
            ious = [score(MaskCounts(**r['all'])).iou for r in some]
            notes.append(f'{group}, {method}: mean IoU {np.nanmean(ious):.3f}')
    return '\n'.join([text_table(lines), *notes])


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n')[0])
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    parser.add_argument('--only', nargs='+', choices=GROUPS, default=list(GROUPS))
    parser.add_argument('--no-dufomap', action='store_true')
    parser.add_argument('--json', type=Path, help='also write the counts here')
    parser.add_argument('--pictures', type=Path, help='also draw a frame of each, for lidars')
    args = parser.parse_args()
    rows: list[Row] = []
    for group, name, shown in sources(args.data, args.only):
        rows += measured(group, name, shown, not args.no_dufomap, args.pictures)
        print(*(' '.join(line(r)) for r in rows if r['name'] == name), sep='\n', flush=True)
    print(table(rows))
    if args.json:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == '__main__':
    main()
