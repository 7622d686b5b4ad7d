# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Frames of a benchmark sequence: simulated once and kept, or read from real recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import DependencyError, FileFormatError
from hybridreg_ros.core.pointcloud2 import field_values, has_field, to_scan
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.odometry.preprocess import deskew
from hybridreg_ros.replay.convert import ConvertOptions, open_recording
from hybridreg_ros.replay.recording import EPOCH_S, RecordedFrame, as_message, simulated
from hybridreg_ros.replay.trajectory_io import read_kitti_rows

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from hybridreg_ros.benchmark.suite_list import Sequence

    F64 = NDArray[np.float64]

RATE_HZ = 10.0


@dataclass(frozen=True, eq=False)
class SuiteFrame:
    """One scan of a benchmark.

    Attributes:
        scan: as a front end gets it.
        T_world_sensor: (4, 4) true pose at the stamp.
        moving: (N,) which points of the scan move, None when nobody knows.
    """

    scan: Scan
    T_world_sensor: F64
    moving: NDArray[np.bool_] | None


def load(sequence: Sequence, data: Path, cache: Path) -> list[SuiteFrame]:
    """All frames of a sequence.

    Args:
        sequence: which one.
        data: folder of the real recordings.
        cache: folder in which simulated frames are kept.

    Raises:
        FileFormatError: a recording is missing or damaged.
        DependencyError: a package that reads or simulates it is not installed.
    """
    if sequence.source == 'simulated':
        made = _simulated(sequence, cache)
        if sequence.deskewed:
            made = _deskewed(made)
        return [_narrowed(f, sequence.window) for f in made] if sequence.window else made
    folder = data / sequence.folder
    if not folder.is_dir():
        raise FileFormatError(f'no recording {folder}: give its folder with --data')
    if sequence.source == 'ouster':
        frames = _ouster(folder, sequence.period_s)
    else:
        options = ConvertOptions(
            poses=folder / sequence.poses if sequence.source == 'kitti' else None,
            rate_hz=1.0 / sequence.period_s,
        )
        recording = open_recording(sequence.source, folder, options)
        frames = map(_decoded, recording)
    still = sequence.moving is False
    return [
        SuiteFrame(f.scan, f.T_world_sensor, np.zeros(len(f.scan), np.bool_) if still else None)
        for f, _ in zip(frames, range(sequence.frames), strict=False)
    ]


def _narrowed(frame: SuiteFrame, window: float) -> SuiteFrame:
    """A frame of a depth camera (z ahead) that sees the middle of its view only."""
    points = frame.scan.points
    inside = np.abs(points[:, :2]).max(axis=1) < window * points[:, 2]
    moving = None if frame.moving is None else frame.moving[inside]
    scan = Scan(points[inside], stamp=frame.scan.stamp, frame_id=frame.scan.frame_id)
    return SuiteFrame(scan, frame.T_world_sensor, moving)


def _deskewed(frames: list[SuiteFrame]) -> list[SuiteFrame]:
    """Frames with the motion from stamp to stamp undone, and no times."""
    done = []
    for k, frame in enumerate(frames):
        if frame.scan.times is None:
            raise FileFormatError(
                f'frame {k}: no times per point, so motion cannot be compensated: '
                'leave out `deskewed`'
            )
        a, b = (frame, frames[k + 1]) if k + 1 < len(frames) else (frames[k - 1], frame)
        dt = (b.scan.stamp - a.scan.stamp) / NS_PER_S
        twist = se3.log(se3.inverse(a.T_world_sensor) @ b.T_world_sensor) / dt
        points = deskew(frame.scan.points, frame.scan.times, twist, 0.0)
        scan = Scan(points, stamp=frame.scan.stamp, frame_id=frame.scan.frame_id)
        done.append(replace(frame, scan=scan))
    return done


def _decoded(frame: RecordedFrame) -> SuiteFrame:
    """A recorded frame through the decoder that bags and topics go through."""
    message = as_message(frame)
    scan = to_scan(message)
    if frame.T_world_sensor is None:
        raise FileFormatError(f'the frame at {frame.stamp / NS_PER_S:.3f} s has no true pose')
    labels = field_values(message, 'label')[scan.rows] > 0 if has_field(message, 'label') else None
    return SuiteFrame(scan, frame.T_world_sensor, labels)


def _simulated(sequence: Sequence, cache: Path) -> list[SuiteFrame]:
    """Frames from the cache; simulated and kept there when they are not yet."""
    scene = 'room' if sequence.kind == 'depth' else 'street'
    path = cache / f'{scene}_{sequence.seed}_{sequence.share}_{sequence.frames}.npz'
    if path.is_file():
        return _kept(path)
    made = simulated(scene, sequence.frames, RATE_HZ, sequence.seed, sequence.share)
    frames = [_decoded(frame) for frame in made]
    cache.mkdir(parents=True, exist_ok=True)
    scratch = path.with_suffix('.writing.npz')
    timed = frames[0].scan.times is not None
    np.savez(
        scratch,
        stamps=np.array([f.scan.stamp for f in frames]),
        poses=np.array([f.T_world_sensor for f in frames]),
        sizes=np.array([len(f.scan) for f in frames]),
        points=np.concatenate([f.scan.points for f in frames]),
        moving=np.concatenate([f.moving for f in frames if f.moving is not None]),
        times=np.concatenate([f.scan.times for f in frames if f.scan.times is not None])
        if timed
        else np.zeros(0),
    )
    scratch.replace(path)
    return frames


def _kept(path: Path) -> list[SuiteFrame]:
    with np.load(path) as kept:
        arrays = {name: kept[name] for name in kept.files}
    ends = np.cumsum(arrays['sizes'])[:-1]
    points = np.split(arrays['points'], ends)
    moving = np.split(arrays['moving'], ends)
    times = np.split(arrays['times'], ends) if len(arrays['times']) else [None] * len(points)
    return [
        SuiteFrame(Scan(p, stamp=int(stamp), frame_id='sensor', times=t), T, m)
        for p, stamp, t, T, m in zip(
            points, arrays['stamps'], times, arrays['poses'], moving, strict=True
        )
    ]


def _ouster(folder: Path, period_s: float) -> Iterator[SuiteFrame]:
    """Scans of an Ouster recording (.osf) with its poses; needs ouster-sdk."""
    try:
        from ouster.sdk import core, open_source  # type: ignore[import-not-found,unused-ignore]
    except ImportError:
        raise DependencyError('Ouster recordings need: pip install ouster-sdk') from None
    file = next(iter(sorted(folder.glob('*.osf'))), None)
    poses = next(iter(sorted(folder.glob('*poses_kitti.txt'))), None)
    if file is None or poses is None:
        raise FileFormatError(f'{folder}: expected an .osf file and *poses_kitti.txt')
    rows = read_kitti_rows(poses)
    source = open_source(str(file))
    table = core.XYZLut(source.sensor_info[0])
    for k, (scan, T) in enumerate(zip(source, rows, strict=False)):
        one = scan if hasattr(scan, 'measurement_id') else scan[0]
        points = table(one).reshape(-1, 3).astype(np.float32)
        seen = (points**2).sum(axis=1) > 0.01
        stamp = EPOCH_S * NS_PER_S + round(k * period_s * NS_PER_S)
        yield SuiteFrame(Scan(points[seen], stamp=stamp, frame_id='lidar'), T, None)
