# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""7-Scenes and the like: frame-NNNNNN.depth.png with frame-NNNNNN.pose.txt and intrinsics."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from natsort import natsorted

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.loaders.depth_images import (
    Intrinsics,
    depth_to_points,
    read_depth_m,
    read_intrinsics,
)
from hybridreg_ros.data.loaders.posed_frames import FramePairs, pairs_stepped, read_numbers, rigid

if TYPE_CHECKING:
    from numpy.typing import NDArray

KINECT = Intrinsics(585.0, 585.0, 320.0, 240.0)


class SevenScenes(FramePairs):
    """Depth frames of one sequence with camera-to-world poses.

    Args:
        folder: with the frames; `camera-intrinsics.txt` is read where it exists.
        step: frames between the clouds of a pair.
        max_depth_m: farther pixels are left out.
        voxel_size_m: suggested finest voxel.

    Raises:
        FileFormatError: there are no frames, or a pose is missing or malformed.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        step: int = 10,
        max_depth_m: float = 6.0,
        voxel_size_m: float = 0.05,
    ) -> None:
        folder = Path(folder)
        self.files = natsorted(folder.glob('frame-*.depth.png'))
        if not self.files:
            raise FileFormatError(f'{folder} holds no frame-NNNNNN.depth.png')
        self.max_depth_m = max_depth_m
        intrinsics = folder / 'camera-intrinsics.txt'
        self.camera = read_intrinsics(intrinsics) if intrinsics.exists() else KINECT
        poses = np.stack([_pose(f) for f in self.files])
        super().__init__(folder, poses, pairs_stepped(len(poses), step), voxel_size_m)

    def cloud(self, index: int) -> NDArray[np.float32]:
        """Points (N, 3) of a frame, optical frame, metres."""
        return depth_to_points(read_depth_m(self.files[index]), self.camera, self.max_depth_m)


def _pose(depth_file: Path) -> NDArray[np.float64]:
    path = depth_file.with_name(depth_file.name.replace('.depth.png', '.pose.txt'))
    return rigid(read_numbers(path, 4), str(path))
