# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One frame of a simulated sequence, and how much of it is to move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]


LIDAR_FRAME = 'lidar'


SHARES = {'none': (0.0, 0.0), '10-30': (0.1, 0.3), '30-50': (0.3, 0.5)}


@dataclass(frozen=True, eq=False)
class SimulatedFrame:
    """One scan of a simulated sequence.

    Attributes:
        points: (N, 3) float32, sensor frame, metres; NaN where there is no return.
        shape: (height, width) of the organised cloud, row by row.
        times: (N,) float64 seconds relative to the stamp, or None for a camera.
        stamp_s: time of the frame, seconds from the start.
        T_world_sensor: (4, 4) pose at the stamp.
        label: (N,) uint8 of `data.pair.Label`.
        instance: (N,) uint16, 0 = static background.
        frame_id: name of the sensor frame.
    """

    points: NDArray[np.float32]
    shape: tuple[int, int]
    times: NDArray[np.float64] | None
    stamp_s: float
    T_world_sensor: F64
    label: NDArray[np.uint8]
    instance: NDArray[np.uint16]
    frame_id: str


def miss(share: float, wanted: tuple[float, float]) -> float:
    """How far a share of moving points lies outside what is wanted."""
    return max(wanted[0] + 0.03 * (wanted[1] > 0) - share, share - wanted[1], 0.0)
