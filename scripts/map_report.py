# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Static and dynamic accuracy of the cleaned map on labelled recordings, DUFOMap beside it.

DUFOMap (pip install dufomap) gets the same scans and poses, at its authors' settings; without the
package its columns stay empty. Points on the vehicle itself (`--own LENGTH WIDTH`, metres) are
not counted: they move with the sensor, whatever their label says.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from hybridreg_ros import HybridOdometry, Scan
from hybridreg_ros.data.loaders.labelled import LabelledScans, Moving
from hybridreg_ros.odometry.result import OdometryResult, Source
from hybridreg_ros.replay.clean_map import MOVING, STILL, UNKNOWN, MapSink

Frame = tuple[OdometryResult, np.ndarray]
AUTHORS = (0.1, 0.2, 2)  # resolution (m), d_s, d_p


def frames_of(folder: Path, own: tuple[float, float]) -> list[Frame]:
    """Results of the odometry and labels (N,) of their points."""
    recording = LabelledScans(folder, gap_s=0.0)
    times = recording.times_s
    assert times is not None
    odometry = HybridOdometry()
    frames = []
    for k, at in enumerate(times):
        points = recording.cloud(k)
        labels = recording.labels(k)
        known = np.where(labels == Moving.MOVING, MOVING, STILL).astype(np.uint8)
        known[labels == Moving.UNLABELLED] = UNKNOWN
        known[(np.abs(points[:, :2]) < 0.5 * np.array(own)).all(axis=1)] = UNKNOWN
        result = odometry.step(Scan(points, stamp=1.0 + float(at), frame_id='lidar'))
        if result.source is not Source.LOST:
            frames.append((result, known[result.scan.rows]))
    return frames


def ours(frames: list[Frame]) -> tuple[float | None, float | None]:
    """Static and dynamic accuracy of our map."""
    with tempfile.TemporaryDirectory() as folder:
        sink = MapSink(Path(folder))
        for result, labels in frames:
            moving = result.dynamic_probability >= 0.5
            sink.offer(result.pose, result.scan.points, moving, labels)
        made = sink.make().report
        sink.close()
    return made.static_accuracy, made.dynamic_accuracy


def theirs(frames: list[Frame]) -> tuple[float | None, float | None]:
    """The same of DUFOMap; None without it."""
    try:
        from dufomap import dufomap  # type: ignore[import-not-found,import-untyped,unused-ignore]
    except ImportError:
        return None, None
    made = dufomap(*AUTHORS, num_threads=1)
    for result, _ in frames:
        made.run(result.scan.points, result.pose, cloud_transform=True)
    made.oncePropagateCluster(if_propagate=True, if_cluster=True)
    called = [
        np.asarray(made.segment(r.scan.points, r.pose, cloud_transform=True)) for r, _ in frames
    ]
    out, labels = np.concatenate(called) > 0, np.concatenate([known for _, known in frames])
    return float((~out[labels == STILL]).mean()), float(out[labels == MOVING].mean())


def cells(pair: tuple[float | None, float | None]) -> str:
    """SA, DA and AA in percent, as cells of a table."""
    static, dynamic = pair
    if static is None or dynamic is None:
        return '- | - | -'
    both = np.sqrt(static * dynamic)
    return f'{100 * static:.1f} | {100 * dynamic:.1f} | {100 * both:.1f}'


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('recordings', type=Path, nargs='+')
    parser.add_argument('--own', type=float, nargs=2, default=(5.0, 5.0))
    args = parser.parse_args()
    print('| recording | scans | SA | DA | AA | DUFOMap SA | DA | AA |')
    print('|---|---|---|---|---|---|---|---|')
    accuracies = []
    for folder in args.recordings:
        frames = frames_of(folder, tuple(args.own))
        mine = ours(frames)
        print(
            f'| {folder.name} | {len(frames)} | {cells(mine)} | {cells(theirs(frames))} |',
            flush=True,
        )
        if mine[0] is not None and mine[1] is not None:
            accuracies.append(0.5 * np.log(mine[0] * mine[1]))
    print(f'geometric mean of AA: {100 * np.exp(np.mean(accuracies)):.1f}')


if __name__ == '__main__':
    main()
