# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""ETH (laser scans of woods, gardens and stairs) in the usual registration layout."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybridreg_ros.data.loaders.threedmatch import ThreeDMatch

if TYPE_CHECKING:
    from pathlib import Path

SCENES = ('gazebo_summer', 'gazebo_winter', 'wood_autmn', 'wood_summer')


class Eth(ThreeDMatch):
    """One scene: `Hokuyo_K.ply` (or another cloud format) and `gt.log`.

    Args:
        folder: of the scene.
        voxel_size_m: suggested finest voxel.

    Raises:
        FileFormatError: gt.log is missing or malformed.
    """

    def __init__(self, folder: str | Path, *, voxel_size_m: float = 0.1) -> None:
        super().__init__(folder, pattern='Hokuyo_{}', voxel_size_m=voxel_size_m)
