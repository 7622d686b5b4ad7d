# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg bench`: milliseconds per stage of register() and step(), and peak memory."""

from __future__ import annotations

import statistics
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.cli.common import told, write_result
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.core.pages import peak_mb
from hybridreg_ros.core.progress import progress
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.replay.page.tables import text_table

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    Cloud = NDArray[np.float32]

BUILT_IN_SEED = 11
FRAME_GAP_S = 0.1


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    if args.data:
        from hybridreg_ros.benchmark import bench_data

        return told(args, *bench_data.run(args))
    if args.step is not None:
        from hybridreg_ros.benchmark import bench_step

        return told(args, *bench_step.run(args))
    source, target = _clouds(args)
    if args.peers:
        from hybridreg_ros.benchmark import bench_peers

        return told(args, *bench_peers.run(args, source, target))
    rest = peak_mb()
    stages: dict[str, dict[str, list[float]]] = {}
    weights = _register(args, source, target, stages)
    after_register = peak_mb()
    _step(args, source, target, stages)
    rows = [['stage', 'median ms', 'fastest ms', 'slowest ms']]
    for part, laps in stages.items():
        rows += [
            [f'{part} {stage}', *(f'{1000 * f(s):.1f}' for f in (statistics.median, min, max))]
            for stage, s in laps.items()
        ]
    print(f'{len(source)} + {len(target)} points, {args.threads} threads, weights: {weights}')
    print(text_table(rows))
    print(f'peak memory      {rest:.0f} MB before, {after_register:.0f} MB after register(), ')
    print(f'                 {peak_mb():.0f} MB at the end')
    write_result(
        args,
        {
            'points': [len(source), len(target)],
            'threads': args.threads,
            'weights': weights,
            'stages_s': stages,
            'peak_mb': {'before': rest, 'register': after_register, 'end': peak_mb()},
        },
    )
    return 0


def _clouds(args: argparse.Namespace) -> tuple[Cloud, Cloud]:
    """The two clouds given, or two frames of a simulated room."""
    if args.pair:
        if len(args.pair) != 2:
            raise ConfigError(f'bench takes two clouds or none, found {len(args.pair)}')
        from hybridreg_ros.data.loaders.clouds import read_cloud

        return read_cloud(args.pair[0]), read_cloud(args.pair[1])
    from hybridreg_ros.data.sequences.simulate import simulate

    frames = list(simulate('room', 2, 1.0, BUILT_IN_SEED))
    clouds = [f.points[np.isfinite(f.points).all(axis=1)] for f in frames]
    return clouds[1], clouds[0]


def _collect(laps: dict[str, list[float]], timings: Mapping[str, float]) -> None:
    for stage, seconds in timings.items():
        laps.setdefault(stage, []).append(seconds)


def _register(
    args: argparse.Namespace,
    source: Cloud,
    target: Cloud,
    stages: dict[str, dict[str, list[float]]],
) -> str:
    """Time register(); returns which weights were used."""
    from hybridreg_ros.model.register import HybridReg

    model = HybridReg.from_pretrained(args.weights)
    _measure(args, 'register', lambda: model.register(source, target).timings_s, stages)
    return str(args.weights or 'packaged')


def _step(
    args: argparse.Namespace,
    source: Cloud,
    target: Cloud,
    stages: dict[str, dict[str, list[float]]],
) -> None:
    """Time step() on the second cloud of a new front end, with and without the network."""
    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.odometry.frontend import HybridOdometry

    gap = round(FRAME_GAP_S * NS_PER_S)
    scans: Sequence[Scan] = (
        Scan(target, stamp=NS_PER_S, frame_id='bench'),
        Scan(source, stamp=NS_PER_S + gap, frame_id='bench'),
    )
    for registrar in ('hybridreg', 'kiss-icp'):
        front_end = HybridOdometry(OdometryConfig(registrar=registrar))

        def once(front_end: HybridOdometry = front_end) -> Mapping[str, float]:
            front_end.reset()
            front_end.step(scans[0])
            return front_end.step(scans[1]).timings_s

        _measure(args, f'step ({registrar})', once, stages)


def _measure(
    args: argparse.Namespace,
    name: str,
    once: Callable[[], Mapping[str, float]],
    stages: dict[str, dict[str, list[float]]],
) -> None:
    """Run once to warm up, then as often as asked for."""
    laps: dict[str, list[float]] = {}
    once()
    items: Sequence[Any] = range(args.repeat)
    for _ in progress(items, args.repeat, name, 'run'):
        _collect(laps, once())
    stages[name] = laps
