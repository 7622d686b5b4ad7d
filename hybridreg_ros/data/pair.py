# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""PointPair: the one sample type of every data set, procedural or recorded."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class Label(IntEnum):
    """What a point belongs to."""

    STATIC = 0
    MOVING_RIGID = 1
    DEFORMING = 2


@dataclass(frozen=True, eq=False)
class PointPair:
    """Two clouds of one scene, taken at two times from two places.

    Attributes:
        source: (N, 3) float32, source sensor frame, metres.
        target: (M, 3) float32, target sensor frame, metres.
        T_target_source: (4, 4) float64, motion of the static background.
        source_label: (N,) uint8 of `Label`; all STATIC where the data set has no labels.
        target_label: (M,) uint8 of `Label`.
        source_instance: (N,) uint16, 0 = background, k > 0 = the same object in both clouds.
        target_instance: (M,) uint16.
        overlap: share of the static source points that the target sees too, [0, 1].
        dynamic_share: share of non-static points over both clouds, [0, 1].
        voxel_size_m: suggested finest voxel of the network for this sensor, metres.
        name: unique name inside its split, for logs and tables.
        seed: seed it was made from, -1 for recordings.
    """

    source: NDArray[np.float32]
    target: NDArray[np.float32]
    T_target_source: NDArray[np.float64]
    source_label: NDArray[np.uint8]
    target_label: NDArray[np.uint8]
    source_instance: NDArray[np.uint16]
    target_instance: NDArray[np.uint16]
    overlap: float
    dynamic_share: float
    voxel_size_m: float
    name: str = ''
    seed: int = -1
