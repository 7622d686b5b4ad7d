# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recorded files as frames of a bag: KITTI-style scans, depth images with poses, TUM RGB-D."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from natsort import natsorted

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.core.pointcloud2 import from_arrays
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.data.loaders.clouds import read_cloud
from hybridreg_ros.data.loaders.columns import read_bin
from hybridreg_ros.data.loaders.depth_images import organised_points, read_depth_m, read_intrinsics
from hybridreg_ros.data.loaders.kitti import calibration
from hybridreg_ros.data.loaders.posed_frames import read_numbers, rigid
from hybridreg_ros.data.loaders.tum import CAMERAS, UNITS_PER_M, USUAL_CAMERA
from hybridreg_ros.replay import trajectory_io
from hybridreg_ros.replay.recording import EPOCH_S, RecordedFrame

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from hybridreg_ros.core.pointcloud2 import CloudData
    from hybridreg_ros.data.loaders.depth_images import Intrinsics
    from hybridreg_ros.metrics.trajectory import Trajectory

LIDAR_FRAME = 'lidar'
CAMERA_FRAME = 'camera_depth_optical_frame'
KITTI_RATE_HZ, DEPTH_RATE_HZ = 10.0, 30.0
DEPTH_UNITS_PER_M = 1000.0
MAX_POSE_GAP_S = 0.1
CLOUDS = ('.ply', '.pcd', '.npy', '.npz')
PATTERNS = {
    'kitti': ('velodyne/*.bin', '*.bin'),
    'tum': ('depth.txt',),
    'depth': ('*depth*.png', 'depth/*.png'),
    'clouds': tuple(f'*{suffix}' for suffix in CLOUDS),
}
KINDS = tuple(PATTERNS)
"""Layouts of folders, and the files that tell them."""


@dataclass(frozen=True)
class ConvertOptions:
    """How files are read.

    Attributes:
        poses: poses file; None looks for it in the folder.
        rate_hz: frames per second where the files give no times; None = by format.
        stride: take every n-th frame.
        pixel_step: of a depth image, take every n-th row and column.
        max_depth_m: farther pixels are missing, metres.
        columns: values per point of a scan; None tells it by those of the first scan.
    """

    poses: Path | None = None
    rate_hz: float | None = None
    stride: int = 1
    pixel_step: int = 1
    max_depth_m: float = 10.0
    columns: int | None = None


@dataclass(frozen=True)
class Recording:
    """A folder that was looked through: what it holds, and how to read it.

    Attributes:
        frames: number of frames.
        poses: number of frames with a true pose.
        read: reads the frame of a number.
        truth: stamp (ns) and true pose (4, 4) of the frames that have one, in their order.
    """

    frames: int
    poses: int
    read: Callable[[int], RecordedFrame]
    truth: list[tuple[int, NDArray[np.float64]]]

    def __iter__(self) -> Iterator[RecordedFrame]:
        """Frames one after the other."""
        return map(self.read, range(self.frames))


def open_recording(kind: str, folder: Path, options: ConvertOptions) -> Recording:
    """Look through a folder.

    Args:
        kind: one of KINDS.
        folder: where the files are.
        options: how to read them.

    Raises:
        FileFormatError: the folder does not hold what `kind` needs.
    """
    if not folder.is_dir():
        raise FileFormatError(f'no folder {folder}')
    return {'kitti': _kitti, 'depth': _depth, 'tum': _tum, 'clouds': _clouds}[kind](
        folder, options
    )


def kind_of(folder: Path) -> str | None:
    """Which of KINDS a folder looks like; None for none of them."""
    for kind, patterns in PATTERNS.items():
        if any(next(folder.glob(pattern), None) for pattern in patterns):
            return kind
    return None


def _recording(
    stamps: list[int],
    poses: Sequence[NDArray[np.float64] | None],
    read: Callable[[int], RecordedFrame],
) -> Recording:
    truth = [(s, T) for s, T in zip(stamps, poses, strict=True) if T is not None]
    return Recording(len(stamps), len(truth), read, truth)


def _kitti(folder: Path, options: ConvertOptions) -> Recording:
    scans = natsorted((folder / 'velodyne').glob('*.bin')) or natsorted(folder.glob('*.bin'))
    if not scans:
        raise FileFormatError(f'{folder} holds no scans: expected velodyne/*.bin')
    columns = options.columns or read_bin(scans[0]).shape[1]

    def read(path: Path) -> CloudData:
        table = read_bin(path, columns)
        return from_arrays(
            table[:, :3], {'intensity': table[:, 3].copy()} if columns > 3 else None
        )

    return _scans(folder, scans, read, options)


def _clouds(folder: Path, options: ConvertOptions) -> Recording:
    """Clouds of any format, one file each, with poses.txt and times.txt as KITTI has them."""
    scans = natsorted(p for p in folder.iterdir() if p.suffix.lower() in CLOUDS)
    if not scans:
        raise FileFormatError(f'{folder} holds no clouds: expected {", ".join(CLOUDS)}')
    return _scans(folder, scans, lambda path: from_arrays(read_cloud(path)), options)


def _scans(
    folder: Path, scans: list[Path], read: Callable[[Path], CloudData], options: ConvertOptions
) -> Recording:
    """Files of one scan each, with their poses and times."""
    poses = _kitti_poses(folder, options.poses)
    stamps = _kitti_stamps(folder, len(scans), options.rate_hz or KITTI_RATE_HZ)
    if poses is not None and len(poses) != len(scans):
        raise FileFormatError(f'{folder} has {len(scans)} scans but {len(poses)} poses')
    chosen = range(0, len(scans), options.stride)
    every = [None] * len(scans) if poses is None else list(poses)

    def frame(number: int) -> RecordedFrame:
        i = chosen[number]
        return RecordedFrame(stamps[i], LIDAR_FRAME, read(scans[i]), every[i])

    return _recording([stamps[i] for i in chosen], [every[i] for i in chosen], frame)


def _kitti_poses(folder: Path, given: Path | None) -> NDArray[np.float64] | None:
    """Poses (N, 4, 4) of the lidar; with calib.txt the file holds those of the camera."""
    path = given
    if path is None:
        found = sorted(folder.glob('poses*.txt'))
        path = folder / 'poses.txt' if folder / 'poses.txt' in found else None
        if path is None and len(found) > 1:
            raise FileFormatError(
                f'{folder} has several pose files, choose one with --poses: '
                f'{", ".join(p.name for p in found)}'
            )
        path = path or (found[0] if found else None)
        official = folder.parent.parent / 'poses' / f'{folder.name}.txt'
        path = path or (official if official.exists() else None)
    if path is None:
        return None
    poses = trajectory_io.read_kitti_rows(path)
    T_camera_lidar = calibration(folder)
    lidar: NDArray[np.float64] = se3.inverse(T_camera_lidar) @ poses @ T_camera_lidar
    return lidar


def _kitti_stamps(folder: Path, count: int, rate_hz: float) -> list[int]:
    times = folder / 'times.txt'
    if not times.exists():
        return [_stamp_of(i, rate_hz) for i in range(count)]
    stamps = trajectory_io.read_times(times)
    if len(stamps) != count:
        raise FileFormatError(
            f'{folder} has {count} scans but {len(stamps)} times in {times.name}'
        )
    return stamps


def _stamp_of(number: int, rate_hz: float) -> int:
    return EPOCH_S * NS_PER_S + round(number / rate_hz * NS_PER_S)


def _depth(folder: Path, options: ConvertOptions) -> Recording:
    images = natsorted(folder.glob('*depth*.png')) or natsorted(folder.glob('depth/*.png'))
    if not images:
        raise FileFormatError(
            f'{folder} holds no depth images: expected *depth*.png or depth/*.png'
        )
    camera = _camera_of(folder)
    if camera is None:
        raise FileFormatError(f'{folder} lacks camera-intrinsics.txt (3x3 matrix or fx fy cx cy)')
    poses = [_pose_beside(image) for image in images]
    numbers = [re.findall(r'\d+', image.name) for image in images]
    ordered = all(numbers) and len({int(n[-1]) for n in numbers}) == len(images)
    rate = options.rate_hz or DEPTH_RATE_HZ
    chosen = range(0, len(images), options.stride)
    stamps = [_stamp_of(int(numbers[i][-1]) if ordered else i, rate) for i in chosen]

    def read(number: int) -> RecordedFrame:
        i = chosen[number]
        cloud = _depth_cloud(images[i], DEPTH_UNITS_PER_M, camera, options)
        return RecordedFrame(stamps[number], CAMERA_FRAME, cloud, poses[i])

    return _recording(stamps, [poses[i] for i in chosen], read)


def _depth_cloud(
    path: Path, units_per_m: float, camera: Intrinsics, options: ConvertOptions
) -> CloudData:
    """Organised cloud of a depth image, NaN where there is no return."""
    points = organised_points(
        read_depth_m(path, units_per_m), camera, options.max_depth_m, options.pixel_step
    )
    return from_arrays(points.reshape(-1, 3), shape=points.shape[:2])


def _camera_of(folder: Path) -> Intrinsics | None:
    for name in ('camera-intrinsics.txt', 'intrinsics.txt', 'camera_intrinsics.txt'):
        if (folder / name).exists():
            return read_intrinsics(folder / name)
    return None


def _pose_beside(image: Path) -> NDArray[np.float64] | None:
    """4x4 camera-to-world of frame-N.depth.png in frame-N.pose.txt; None when lost or absent."""
    path = image.with_name(re.sub(r'[.\-_]?depth[.\-_]?', '', image.stem) + '.pose.txt')
    if not path.exists():
        return None
    values = read_numbers(path, 4)
    return rigid(values, str(path)) if np.isfinite(values).all() else None


def _tum(folder: Path, options: ConvertOptions) -> Recording:
    listing = folder / 'depth.txt'
    if not listing.exists():
        raise FileFormatError(f'{folder} lacks depth.txt (one line per image: stamp file)')
    entries = trajectory_io.read_listing(listing)
    truth_file = options.poses or folder / 'groundtruth.txt'
    truth = trajectory_io.read_tum(truth_file) if truth_file.exists() or options.poses else None
    camera = _camera_of(folder) or next(
        (c for name, c in CAMERAS.items() if name in folder.resolve().name), USUAL_CAMERA
    )
    chosen = entries[:: options.stride]
    poses = [None if truth is None else pose_at(truth, stamp) for stamp, _ in chosen]

    def read(number: int) -> RecordedFrame:
        stamp, name = chosen[number]
        cloud = _depth_cloud(folder / name, UNITS_PER_M, camera, options)
        return RecordedFrame(stamp, CAMERA_FRAME, cloud, poses[number])

    return _recording([stamp for stamp, _ in chosen], poses, read)


def pose_at(truth: Trajectory, stamp: int) -> NDArray[np.float64] | None:
    """Pose (4, 4) at a stamp (ns), interpolated; None outside, or in a gap of 0.1 s or more."""
    right = int(np.searchsorted(truth.stamps, stamp))
    if right < len(truth) and truth.stamps[right] == stamp:
        exact: NDArray[np.float64] = truth.poses[right]
        return exact
    if right == 0 or right == len(truth):
        return None
    before, after = int(truth.stamps[right - 1]), int(truth.stamps[right])
    if after - before >= MAX_POSE_GAP_S * NS_PER_S:
        return None
    share = (stamp - before) / (after - before)
    return se3.interpolate(truth.poses[right - 1], truth.poses[right], share)
