# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Scan: one cloud as the front end sees it, whatever message or file it came from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import PointCloudError

if TYPE_CHECKING:
    from numpy.typing import NDArray

NS_PER_S = 1_000_000_000
_NO_ROWS = np.empty(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Scan:
    """One cloud in the sensor frame. Every point is finite; all per-point fields share one order.

    Attributes:
        points: (N, 3) float32, sensor frame, metres, all finite.
        times: (N,) float64 seconds relative to `stamp`, or None when the sensor gives none.
        stamp: int nanoseconds; a float given to the constructor is read as seconds.
        frame_id: name of the sensor frame.
        rows: (N,) int64, row of each point in its message (rows with NaN are skipped).
        size: number of rows of that message, dropped ones included.
        thinned: rows of that message that were passed over because there are so many.
        shape: (height, width) of the message; height > 1 means an organised cloud.
        notes: what could not be used of the message (one line each), for logs and diagnostics.
    """

    points: NDArray[np.float32]
    times: NDArray[np.float64] | None = None
    stamp: int = 0
    frame_id: str = ''
    rows: NDArray[np.int64] = field(default_factory=lambda: _NO_ROWS)
    size: int = -1
    thinned: int = 0
    shape: tuple[int, int] = (0, 0)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Normalise types; fill `rows`, `size`, `shape` when they are not given.

        Raises:
            PointCloudError: points are not (N, 3) or not finite, or a per-point field has another
                length.
        """
        points = np.ascontiguousarray(self.points, dtype=np.float32)
        if points.ndim != 2 or points.shape[1] != 3:
            raise PointCloudError(f'points must be (N, 3), found {points.shape}')
        if not np.isfinite(points).all():
            raise PointCloudError(
                'points hold NaN or inf: drop them first (core.pointcloud2.to_scan does)'
            )
        n = len(points)
        object.__setattr__(self, 'points', points)
        stamp: int | float = self.stamp
        if isinstance(stamp, float):
            object.__setattr__(self, 'stamp', round(stamp * NS_PER_S))
        if self.times is not None:
            times = np.ascontiguousarray(self.times, dtype=np.float64)
            if times.shape != (n,):
                raise PointCloudError(f'times must be ({n},), found {times.shape}')
            object.__setattr__(self, 'times', times)
        if self.rows is _NO_ROWS:
            object.__setattr__(self, 'rows', np.arange(n, dtype=np.int64))
        elif np.shape(self.rows) != (n,):
            raise PointCloudError(f'rows must be ({n},), found {np.shape(self.rows)}')
        if self.size < 0:
            object.__setattr__(self, 'size', n)
        if self.shape == (0, 0):
            object.__setattr__(self, 'shape', (1, self.size))

    def __len__(self) -> int:
        """Number of valid points N."""
        return len(self.points)

    @property
    def stamp_s(self) -> float:
        """Stamp in seconds (for printing; arithmetic uses `stamp`)."""
        return self.stamp / NS_PER_S

    @property
    def dropped(self) -> int:
        """Rows of the message that held NaN or inf and are not in `points`."""
        return self.size - self.thinned - len(self.points)
