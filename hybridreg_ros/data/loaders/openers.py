# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Any folder of pairs, whatever its format: what lies in it tells which loader reads it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.hybridmatch.shards import open_split
from hybridreg_ros.data.loaders.eth import Eth
from hybridreg_ros.data.loaders.kitti import KittiOdometry
from hybridreg_ros.data.loaders.official import OfficialHybridMatch
from hybridreg_ros.data.loaders.sevenscenes import SevenScenes
from hybridreg_ros.data.loaders.threedmatch import ThreeDMatch
from hybridreg_ros.data.loaders.tum import TumRgbd

if TYPE_CHECKING:
    from collections.abc import Callable

    from hybridreg_ros.data.loaders.posed_frames import PairSource

_SIGNS: tuple[tuple[str, str, Callable[[Path], PairSource]], ...] = (
    ('shards of `hybridreg generate`', '*.hrs', open_split),
    ('ETH', 'Hokuyo_*', Eth),
    ('3DMatch or 3DLoMatch', 'gt.log', ThreeDMatch),
    ('KITTI odometry', 'velodyne/*.bin', KittiOdometry),
    ('TUM RGB-D', 'groundtruth.txt', TumRgbd),
    ('7-Scenes', 'frame-*.depth.png', SevenScenes),
    ('HybridMatch as released', '**/relative_transform.npy', OfficialHybridMatch),
)


def open_pairs(folder: str | Path) -> PairSource:
    """Open a folder of pairs, procedural or recorded.

    Args:
        folder: shards, or 3DMatch (`gt.log`), ETH, KITTI odometry, TUM RGB-D, 7-Scenes, or
            HybridMatch in the layout of its authors; loaders' defaults apply.

    Raises:
        FileFormatError: the folder is missing, holds none of these, or is malformed.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileFormatError(f'no folder of pairs at {folder}')
    for _, sign, reader in _SIGNS:
        if next(folder.glob(sign), None) is not None:
            return reader(folder)
    known = ', '.join(f'{what} ({sign})' for what, sign, _ in _SIGNS)
    raise FileFormatError(
        f'{folder} holds no pairs: make some with `hybridreg generate`, or give one of {known}'
    )
