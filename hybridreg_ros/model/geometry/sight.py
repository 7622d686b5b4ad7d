# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What a sensor saw in every direction, and what that says of the points of another cloud.

A point that stands before everything that the other sensor saw around its direction stands in
space that was looked through; one that lies on what was seen there stays; one behind it, or in a
direction without a return, was not seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.jit import compiled
from hybridreg_ros.core.pages import zeros
from hybridreg_ros.model.geometry.grid import moved
from hybridreg_ros.model.geometry.views import direction_bin

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]
    I32 = NDArray[np.int32]

COUNT = 18
"""Numbers per point (`looks`)."""
_LENGTHS = (1, 2, 4, 5, 6, 8, 9, 10, 11, 13, 14, 17)
"""Those that are lengths."""
_BINS = (128, 40)
"""Directions along an edge of the cube around the sensor: about 0.7 and 2.2 degrees apart, for
what is near enough to be finely seen, and for sensors of few rings."""
_UNIT_M = 0.05
"""Lengths below this are noise; above it, only their order of magnitude counts."""
_BLOCK = 4096
"""Points whose lengths are turned into magnitudes at a time; so they stay in the cache."""
_FAR_M = 20.0
"""Distance to the nearest point where there is none, or none so near."""


class Directions(NamedTuple):
    """What was seen in every direction; (6, B, B) faces, rows and columns of a cube.

    Attributes:
        row: int32, 1 + row of the nearest point, 0 where none is.
        far: float32 range of the farthest point, metres; 0 where none is.
        low: float32 nearest range within one direction around, 0 where none is.
        high: float32 farthest range within one direction around, 0 where none is.
        share: float32 share of these directions that have a point.
    """

    row: I32
    far: F32
    low: F32
    high: F32
    share: F32

    @classmethod
    def of(cls, points: F32, bins: int) -> Directions:
        """Look at a cloud (N, 3) from its sensor."""
        shape = (6, bins, bins)
        found = cls(zeros(shape, np.int32), *(zeros(shape, np.float32) for _ in range(4)))
        _draw(points, found)
        return found


@dataclass(frozen=True, eq=False)
class Sight:
    """The input points of a cloud, and what was seen in every direction.

    Attributes:
        points: (N, 3) float32, sensor frame, metres; NaN rows are kept.
        fine: in fine directions.
        wide: in wide ones.
    """

    points: F32
    fine: Directions
    wide: Directions

    @classmethod
    def of(cls, points: F32) -> Sight:
        """Look at a cloud (N, 3) from its sensor."""
        fine, wide = (Directions.of(points, bins) for bins in _BINS)
        return cls(points, fine, wide)


@compiled
def _draw(points: F32, into: Directions) -> None:
    """Enter all points, then spread what was entered by one direction."""
    row, far, low, high, share = into
    bins, used = row.shape[1], np.zeros(6, np.bool_)
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        r = np.float32(np.sqrt(x * x + y * y + z * z))
        if not (0.0 < r < np.inf):
            continue
        f, u, v = direction_bin(x, y, z, bins)
        if row[f, u, v] == 0 or r < low[f, u, v]:
            row[f, u, v], low[f, u, v] = i + 1, r
        far[f, u, v] = max(far[f, u, v], r)
        used[f] = True
    near = low.copy()
    for f in np.flatnonzero(used):
        for u in range(bins):
            for v in range(bins):
                least, most, filled, total = np.float32(np.inf), np.float32(0.0), 0, 0
                for p in range(max(u - 1, 0), min(u + 2, bins)):
                    for q in range(max(v - 1, 0), min(v + 2, bins)):
                        total += 1
                        if row[f, p, q]:
                            filled += 1
                            least = min(least, near[f, p, q])
                            most = max(most, far[f, p, q])
                if filled:
                    low[f, u, v], high[f, u, v] = least, most
                    share[f, u, v] = filled / total


def magnitude(length: float) -> float:
    """Sign and order of magnitude of a length in metres: sign(x) log(1 + |x| / 0.05) / 3."""
    return float(np.sign(length) * np.log(1.0 + abs(length) / _UNIT_M) / 3.0)


@compiled
def _nearest(
    x: float, y: float, z: float, f: int, u: int, v: int, points: F32, row: I32
) -> tuple[float, int]:
    """Distance to the nearest of the points entered in 3 x 3 directions, and its row or -1."""
    bins, least, found = row.shape[1], np.float32(_FAR_M * _FAR_M), -1
    for p in range(max(u - 1, 0), min(u + 2, bins)):
        for q in range(max(v - 1, 0), min(v + 2, bins)):
            i = row[f, p, q] - 1
            k = max(i, 0)  # no branches: they would be guessed wrongly
            dx, dy, dz = points[k, 0] - x, points[k, 1] - y, points[k, 2] - z
            d2 = dx * dx + dy * dy + dz * dz
            nearer = (i >= 0) & (d2 < least)
            least = d2 if nearer else least
            found = i if nearer else found
    return np.sqrt(least), found


@compiled
def _stands_free(T: F64, others: F32, seen: Directions, own: Directions) -> F32:
    """How far what was seen in each direction stands before what the own sensor saw, metres.

    Args:
        T: (4, 4) from the frame of the others to that of the own cloud.
        others: (M, 3).
        seen: of the others.
        own: of the own cloud.

    Returns:
        (6, B, B) float32; -inf where the others saw nothing, 0 where the own sensor did not.
    """
    bins = own.row.shape[1]
    out = np.full(seen.row.shape, -np.inf, np.float32)
    for f in range(6):
        for u in range(bins):
            for v in range(bins):
                i = seen.row[f, u, v] - 1
                if i < 0:
                    continue
                x, y, z = moved(T, others[i, 0], others[i, 1], others[i, 2])
                a, b, c = direction_bin(x, y, z, bins)
                low = own.low[a, b, c]
                out[f, u, v] = 0.0
                if own.share[a, b, c] > 0.0:
                    out[f, u, v] = low - np.sqrt(x * x + y * y + z * z)
    return out


@compiled
def _looked_at(
    points: F32,
    mine: Directions,
    others: F32,
    theirs: tuple[Directions, Directions],
    T: F64,
    free: F32,
    out: F32,
    nearest: I32,
) -> None:
    """The columns of `looks`, lengths in metres, and the nearest point of the other cloud."""
    for i in range(points.shape[0]):
        x, y, z = moved(T, points[i, 0], points[i, 1], points[i, 2])
        r = np.sqrt(x * x + y * y + z * z)
        nearest[i] = -1
        if not r < np.inf:
            continue
        row = -1
        for k in range(2):
            seen = theirs[k]
            f, u, v = direction_bin(x, y, z, seen.row.shape[1])
            if k == 0 and seen.row[f, u, v] > 0:
                j = seen.row[f, u, v] - 1
                a, b, c = others[j, 0], others[j, 1], others[j, 2]
                out[i, 0] = 1.0
                out[i, 1] = np.sqrt(a * a + b * b + c * c) - r
                out[i, 2] = r - seen.far[f, u, v]
            share = seen.share[f, u, v]
            out[i, 3 + 4 * k] = share
            if share > 0.0:
                out[i, 4 + 4 * k] = seen.low[f, u, v] - r
                out[i, 5 + 4 * k] = r - seen.high[f, u, v]
            out[i, 6 + 4 * k], j = _nearest(x, y, z, f, u, v, others, seen.row)
            row = j if row < 0 else row
            if k == 0 and share > 0.0:
                out[i, 11] = _largest(free, f, u, v)
        nearest[i] = row
        out[i, 15] = np.log(max(r, 0.1))
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        r = np.sqrt(x * x + y * y + z * z)
        f, u, v = direction_bin(x, y, z, mine.row.shape[1])
        out[i, 12], out[i, 13] = mine.share[f, u, v], mine.low[f, u, v] - r
        out[i, 14], out[i, 16] = r - mine.high[f, u, v], np.log(max(r, 0.1))
        out[i, 17] = _nearest(x, y, z, f, u, v, others, theirs[0].row)[0]


@compiled
def _largest(image: F32, f: int, u: int, v: int) -> float:
    """Largest value within one direction around."""
    most, bins = -np.inf, image.shape[1]
    for p in range(max(u - 1, 0), min(u + 2, bins)):
        for q in range(max(v - 1, 0), min(v + 2, bins)):
            most = max(most, image[f, p, q])
    return most


def looks(source: Sight, target: Sight, T_target_source: F64) -> tuple[F32, I32]:
    """What one cloud says of the points of another under a pose.

    Args:
        source: N points.
        target: what looks at them.
        T_target_source: (4, 4), metres.

    Returns:
        (N, COUNT + 2) float32, the last two zero, and (N,) int32, the nearest point that the
        target saw around the direction of each (-1: none). Columns, lengths as `magnitude`: 0 to 2
        the very direction: seen or not, how far what was seen lies behind the point, and how far
        the point lies behind it; 3 to 6 and 7 to 10 the same around it in finer and wider
        directions (share of them seen), each with the distance to the nearest point seen; 11 how
        far what the target saw there stands in space that the source looked through; 12 to 14 like
        3 to 5 in its own cloud; 15 and 16 log of the range from the other and the own sensor; 17
        distance to the nearest point seen around it, had it moved along with the sensor. Rows of
        NaN are zero.
    """
    out = np.zeros((len(source.points), COUNT + 2), np.float32)
    nearest = np.empty(len(source.points), np.int32)
    free = _stands_free(se3.inverse(T_target_source), target.points, target.fine, source.fine)
    theirs, T = (target.fine, target.wide), T_target_source.astype(np.float32)
    _looked_at(source.points, source.fine, target.points, theirs, T, free, out, nearest)
    for start in range(0, len(out), _BLOCK):
        rows = out[start : start + _BLOCK]
        lengths = rows[:, _LENGTHS]
        size = np.log(np.abs(lengths) * np.float32(1.0 / _UNIT_M) + np.float32(1.0))
        rows[:, _LENGTHS] = np.copysign(size * np.float32(1.0 / 3.0), lengths)
    return out, nearest
