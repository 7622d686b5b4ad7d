# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Scan: one cloud as the front end sees it, whatever message or file it came from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import PointCloudError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

NS_PER_S = 1_000_000_000
_FARTHEST_M = 300.0
NO_RETURN_M = 0.01
"""Nothing measures nearer than this: drivers write (0, 0, 0) where there was no return."""


@dataclass(frozen=True, eq=False, init=False)
class Scan:
    """One cloud in the sensor frame. Every point is finite; all per-point fields share one order.

    Attributes:
        points: (N, 3) float32, sensor frame, metres, all finite.
        times: (N,) float64 seconds relative to `stamp`, or None when the sensor gives none.
        stamp: nanoseconds.
        frame_id: name of the sensor frame.
        rows: (N,) int64, row of each point in its message (rows with NaN are skipped).
        size: number of rows of that message, dropped ones included.
        thinned: rows of that message that were passed over because there are so many.
        shape: (height, width) of the message; height > 1 means an organised cloud.
        near: rows of the message left out because they lie at the sensor, or nearer than it sees.
        notes: what could not be used of the message (one line each), for logs and diagnostics.
        times_from: field and unit that `times` were made from, or why there are none.
    """

    points: NDArray[np.float32]
    times: NDArray[np.float64] | None
    stamp: int
    frame_id: str
    rows: NDArray[np.int64]
    size: int
    thinned: int
    shape: tuple[int, int]
    near: int
    notes: tuple[str, ...]
    times_from: str

    def __init__(  # noqa: PLR0913, PLR0917 - one argument a field
        self,
        points: ArrayLike,
        times: ArrayLike | None = None,
        stamp: float = 0,
        frame_id: str = '',
        rows: NDArray[np.int64] | None = None,
        size: int = -1,
        shape: tuple[int, int] = (0, 0),
        notes: tuple[str, ...] = (),
        near: int = 0,
        times_from: str = '',
        thinned: int = 0,
    ) -> None:
        """Normalise types; fill `rows`, `size`, `shape` when they are not given.

        Args:
            points: (N, 3) floats.
            times: (N,) floats, or None.
            stamp: an int is read as nanoseconds, a float as seconds.
            frame_id: name of the sensor frame.
            rows: None counts the points.
            size: -1 means N.
            shape: (0, 0) means (1, size).
            notes: one line each.
            near: rows left out for their range.
            times_from: where the times come from.
            thinned: rows passed over.

        Raises:
            PointCloudError: points are not (N, 3) or not finite, or a per-point field has another
                length.
        """
        cloud = np.ascontiguousarray(points, dtype=np.float32)
        if cloud.ndim != 2 or cloud.shape[1] != 3:
            raise PointCloudError(f'points must be (N, 3), found {cloud.shape}')
        if not np.isfinite(cloud).all():
            raise PointCloudError(
                'points hold NaN or inf: drop them first (core.pointcloud2.to_scan does)'
            )
        n = len(cloud)
        if times is not None:
            times = np.ascontiguousarray(times, dtype=np.float64)
            if times.shape != (n,):
                raise PointCloudError(f'times must be ({n},), found {times.shape}')
        if rows is None:
            rows = np.arange(n, dtype=np.int64)
        elif np.shape(rows) != (n,):
            raise PointCloudError(f'rows must be ({n},), found {np.shape(rows)}')
        size = n if size < 0 else size
        values = {
            'points': cloud,
            'times': times,
            'stamp': round(stamp * NS_PER_S) if isinstance(stamp, float) else stamp,
            'frame_id': frame_id,
            'rows': rows,
            'size': size,
            'thinned': thinned,
            'shape': (1, size) if shape == (0, 0) else shape,
            'near': near,
            'notes': notes,
            'times_from': times_from,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        """Number of valid points N."""
        return len(self.points)

    @property
    def stamp_s(self) -> float:
        """Stamp in seconds (for printing; arithmetic uses `stamp`)."""
        return self.stamp / NS_PER_S

    @property
    def dropped(self) -> int:
        """Rows of the message that are not in `points`: NaN, inf, or `near`."""
        return self.size - self.thinned - len(self.points)

    def beyond(self, range_m: float) -> Scan:
        """The scan without points nearer than a range (metres), in every field; `near` grows."""
        with np.errstate(over='ignore'):
            keep = np.einsum('ij,ij->i', self.points, self.points) >= range_m**2
        near = len(self) - int(np.count_nonzero(keep))
        if not near:
            return self
        rows = np.flatnonzero(keep)
        return replace(
            self,
            points=taken(self.points, rows),
            times=None if self.times is None else self.times[rows],
            rows=self.rows[rows],
            near=self.near + near,
        )


def taken(points: NDArray[np.float32], rows: NDArray[np.int64]) -> NDArray[np.float32]:
    """Some rows (R,) of points (N, 3): `points[rows]` in half the time."""
    whole = np.ascontiguousarray(points).view('V12').reshape(-1)
    return whole.take(rows).view(np.float32).reshape(-1, 3)


def units_note(points: NDArray[np.floating]) -> str:
    """What to say of a cloud whose points lie too far away for metres, '' for any other.

    Args:
        points: (N, 3), sensor frame, all finite.
    """
    some = points[:: max(1, len(points) // 1000)].astype(np.float64)
    middle = float(np.median(np.linalg.norm(some, axis=1))) if len(some) else 0.0
    if middle <= _FARTHEST_M:
        return ''
    return (
        f'half of the points are farther than {middle:.4g} m: expected metres, this looks like '
        'millimetres; divide the coordinates by 1000'
    )
