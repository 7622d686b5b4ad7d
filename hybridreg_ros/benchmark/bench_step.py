# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg bench --step`: what a step costs on recordings, with kiss-icp scan by scan beside."""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING, Any

from hybridreg_ros.benchmark import suite_data
from hybridreg_ros.benchmark.pipelines import KissIcp
from hybridreg_ros.benchmark.suite_list import chosen
from hybridreg_ros.core.progress import progress
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.preprocess import recognise_sensor
from hybridreg_ros.odometry.result import Source
from hybridreg_ros.replay.page.tables import text_table

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence

    from hybridreg_ros.core.scan import Scan

USUAL = ('lidar_kitti_raw_22scans', 'depth_7scenes')
_KISS_VOXEL_M = {'depth': 0.1, 'lidar': 1.0}
"""Voxel of kiss-icp beside: for a lidar that of its users (a hundredth of the maximum range)."""
_FIRST = 4
"""Scans at the start that are not counted: keyframes and the local map are being filled."""
_RATIO, _SHARE = 'step / kiss-icp, CPU', 'poses by the network, %'
_PARTS = ('preprocess', 'encode', 'match', 'refine', 'dynamics', 'map')


def run(args: argparse.Namespace) -> tuple[str, dict[str, Any]]:
    """Measure; returns the text to print and the figures.

    Raises:
        ConfigError: no such sequence.
        FileFormatError: its recording is not there.
    """
    figures = {}
    for sequence in chosen('real', args.step or USUAL):
        frames = suite_data.load(sequence, args.recordings, args.recordings)
        scans = [frame.scan for frame in frames[: args.scans]]
        list(_steps(scans[:_FIRST]))  # compiles
        measured = list(progress(_steps(scans), len(scans), sequence.name, 'scan'))
        figures[sequence.name] = _figures(measured)
    rows = [['median ms', *figures]]
    for row in next(iter(figures.values())):
        digits = 2 if row == _RATIO else 0
        rows.append([row, *(f'{f[row]:.{digits}f}' for f in figures.values())])
    return text_table(rows), {'median_ms': figures, 'threads': args.threads}


def _steps(scans: Sequence[Scan]) -> Iterator[dict[str, float]]:
    """Milliseconds per scan, ours and kiss-icp in turns: a busy machine is busy for both."""
    sensor = recognise_sensor(scans[0].points, OdometryConfig())
    kiss = KissIcp(_KISS_VOXEL_M[sensor.kind], sensor.max_range_m, sensor.min_range_m)
    ours = HybridOdometry()
    for scan in scans:
        began = time.process_time()
        _, rest = ours.locate(scan)
        located = time.process_time()
        result = rest()
        ended = time.process_time()
        kiss.step(scan.points, scan.times)
        stages = {part: 1e3 * result.timings_s.get(part, 0.0) for part in _PARTS}
        yield {
            'step, CPU': 1e3 * (ended - began),
            'until the pose, CPU': 1e3 * (located - began),
            'kiss-icp, CPU': 1e3 * (time.process_time() - ended),
            'encode + match': stages['encode'] + stages['match'],
            **stages,
            _SHARE: 100.0 * (result.source is Source.HYBRIDREG),
        }


def _figures(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    """Medians over the scans, mean for the share of the network, and the ratio of the medians."""
    rows = rows[_FIRST:]
    found = {key: statistics.median(row[key] for row in rows) for key in rows[0]}
    found[_SHARE] = statistics.fmean(row[_SHARE] for row in rows)
    return {_RATIO: found['step, CPU'] / found['kiss-icp, CPU'], **found}
