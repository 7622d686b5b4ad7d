# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""TUM RGB-D: depth.txt, depth/*.png and groundtruth.txt, associated by their times."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.loaders.depth_images import Intrinsics, depth_to_points, read_depth_m
from hybridreg_ros.data.loaders.posed_frames import (
    FramePairs,
    from_quaternion,
    pairs_stepped,
    read_numbers,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

UNITS_PER_M = 5000.0
CAMERAS = {
    'freiburg1': Intrinsics(517.3, 516.5, 318.6, 255.3),
    'freiburg2': Intrinsics(520.9, 521.0, 325.1, 249.7),
    'freiburg3': Intrinsics(535.4, 539.2, 320.1, 247.6),
}
USUAL_CAMERA = Intrinsics(525.0, 525.0, 319.5, 239.5)


class TumRgbd(FramePairs):
    """Depth frames of one recording that have a true pose at about the same time.

    Args:
        folder: of the recording; a name with freiburg1, 2 or 3 chooses the camera.
        step: frames between the clouds of a pair.
        max_gap_s: largest gap between a depth image and its pose.
        max_depth_m: farther pixels are left out.
        voxel_size_m: suggested finest voxel.

    Raises:
        FileFormatError: a file is missing or malformed, or no depth image has a pose.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        step: int = 10,
        max_gap_s: float = 0.02,
        max_depth_m: float = 6.0,
        voxel_size_m: float = 0.05,
    ) -> None:
        folder = Path(folder)
        times, names = _depth_list(folder / 'depth.txt')
        truth = read_numbers(folder / 'groundtruth.txt', 8)
        truth = truth[np.argsort(truth[:, 0], kind='stable')]
        near = _nearest(truth[:, 0], times)
        good = np.abs(truth[near, 0] - times) <= max_gap_s
        if not good.any():
            raise FileFormatError(
                f'{folder}: no depth image within {max_gap_s:g} s of a pose of groundtruth.txt'
            )
        self.files = [folder / names[k] for k in np.nonzero(good)[0]]
        self.times_s: F64 = times[good]
        self.max_depth_m = max_depth_m
        self.camera = next((c for k, c in CAMERAS.items() if k in folder.name), USUAL_CAMERA)
        what = str(folder / 'groundtruth.txt')
        poses = np.stack([from_quaternion(r[1:4], r[4:8], what) for r in truth[near[good]]])
        super().__init__(folder, poses, pairs_stepped(len(poses), step), voxel_size_m)

    def cloud(self, index: int) -> NDArray[np.float32]:
        """Points (N, 3) of a frame, optical frame, metres."""
        depth = read_depth_m(self.files[index], UNITS_PER_M)
        return depth_to_points(depth, self.camera, self.max_depth_m)


def _depth_list(path: Path) -> tuple[F64, list[str]]:
    """Times (N,), seconds, and file names of depth.txt."""
    try:
        lines = path.read_text('utf-8', 'replace').splitlines()
    except OSError as error:
        raise FileFormatError(f'cannot read {path}: {error.strerror}') from None
    rows = [w for line in lines if (w := line.split('#')[0].split())]
    try:
        times = np.array([float(row[0]) for row in rows])
        names = [row[1] for row in rows]
    except (ValueError, IndexError):
        raise FileFormatError(f'{path}: expected lines of a time and a file name') from None
    if not names:
        raise FileFormatError(f'{path} lists no depth images')
    return times, names


def _nearest(sorted_values: F64, wanted: F64) -> NDArray[np.int64]:
    """Rows of the nearest of some sorted values for each wanted one."""
    after = np.clip(np.searchsorted(sorted_values, wanted), 1, max(len(sorted_values) - 1, 1))
    after = np.minimum(after, len(sorted_values) - 1)
    before = np.maximum(after - 1, 0)
    closer = wanted - sorted_values[before] <= sorted_values[after] - wanted
    rows: NDArray[np.int64] = np.where(closer, before, after)
    return rows
