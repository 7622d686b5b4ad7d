# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""KITTI odometry: velodyne/*.bin with poses.txt, and calib.txt and times.txt where they exist."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from natsort import natsorted

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.loaders.clouds import read_cloud
from hybridreg_ros.data.loaders.posed_frames import FramePairs, pairs_apart, read_numbers, rigid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]


class KittiOdometry(FramePairs):
    """One sequence in the layout of the KITTI odometry benchmark.

    Poses of the camera are moved to the lidar when `calib.txt` gives `Tr`; without it the poses
    are taken as those of the lidar.

    Args:
        folder: with `velodyne/` and `poses.txt`; the poses may also lie in `../../poses/NN.txt`.
        distance_m: each pair is the first two scans at least this far apart.
        voxel_size_m: suggested finest voxel.

    Raises:
        FileFormatError: a file is missing or malformed, or scans and poses differ in number.
    """

    def __init__(
        self, folder: str | Path, *, distance_m: float = 10.0, voxel_size_m: float = 0.3
    ) -> None:
        folder = Path(folder)
        self.files = natsorted((folder / 'velodyne').glob('*.bin'))
        if not self.files:
            raise FileFormatError(f'{folder}/velodyne holds no .bin scans')
        rows = read_numbers(_poses_file(folder), 12)
        if len(rows) != len(self.files):
            raise FileFormatError(
                f'{folder}: expected one pose for each of {len(self.files)} scans, '
                f'found {len(rows)}'
            )
        T_camera_lidar = calibration(folder)
        back = se3.inverse(T_camera_lidar)
        poses = [
            back @ rigid(row, f'{folder} pose {k}') @ T_camera_lidar for k, row in enumerate(rows)
        ]
        times = folder / 'times.txt'
        self.times_s: F64 | None = read_numbers(times, 1)[:, 0] if times.exists() else None
        stacked = np.stack(poses)
        super().__init__(folder, stacked, pairs_apart(stacked, distance_m), voxel_size_m)

    def cloud(self, index: int) -> F32:
        """Points (N, 3) of a scan, lidar frame, metres."""
        return read_cloud(self.files[index])


def _poses_file(folder: Path) -> Path:
    """`poses.txt` of the sequence, or the official place of the same file."""
    official = folder.parent.parent / 'poses' / f'{folder.name}.txt'
    own = folder / 'poses.txt'
    return official if official.exists() and not own.exists() else own


def calibration(folder: Path) -> F64:
    """T_camera_lidar (4, 4) of calib.txt in a folder, the identity without one.

    Raises:
        FileFormatError: it has no row `Tr:` of a rigid transform.
    """
    path = folder / 'calib.txt'
    if not path.exists():
        return np.eye(4)
    for line in path.read_text('utf-8', 'replace').splitlines():
        name, _, rest = line.partition(':')
        if name.strip() in ('Tr', 'Tr_velo_to_cam', 'Tr_velo_cam'):
            try:
                return rigid(np.array([float(w) for w in rest.split()]), f'{path} {name}')
            except ValueError:
                raise FileFormatError(
                    f'{path}: {name} holds something other than numbers'
                ) from None
    raise FileFormatError(f'{path}: expected a line Tr:, found none')
