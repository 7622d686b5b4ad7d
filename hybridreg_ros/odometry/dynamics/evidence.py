# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is physically there: how each cell of a scan stands against what earlier scans saw."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.core.scan import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.dynamics.cells import Cells
    from hybridreg_ros.odometry.visibility.range_image import RangeImage

    F32 = NDArray[np.float32]

LOOKS = 8
"""Earlier scans that are kept."""
_TELLING_S = 0.25
"""Age from which an earlier scan tells who walks: half a body's width off at 1 m/s. Before that,
no mask tells what moves from what stands."""
_LONGEST_S = 3.0
"""An earlier scan goes when the next one is as old as this."""
NOISE = {'lidar': (0.04, 0.004, 0.0), 'depth': (0.006, 0.003, 0.0012)}
"""One standard deviation of a range against an earlier scan at its pose: metres, share of the
range, and share of its square per metre."""
CLEAR, _SURE = 2.0, 6.0
"""Standard deviations off a surface at which a point is off it, and clearly so."""
COLUMNS = 28


class Look(NamedTuple):
    """An earlier scan: its stamp, ns, what it saw, and some points (K, 3) of it, odom frame."""

    stamp: int
    image: RangeImage
    points: F32


class Past:
    """Earlier scans, kept closely if they are recent and the more sparsely the older they are."""

    def __init__(self) -> None:
        self._kept: list[Look] = []

    def keep(self, look: Look) -> None:
        """Keep one more; of too many, the one goes whose neighbours are the closest in age."""
        kept = self._kept
        kept.append(look._replace(image=look.image.kept()))
        if len(kept) <= LOOKS:
            return
        since = [max(0.0, (look.stamp - past.stamp) / NS_PER_S) + 1e-3 for past in kept]
        if since[1] > _LONGEST_S:
            del kept[0]
            return
        # As old as they will be for the next scan, if it comes as soon as this one did.
        age = np.array([*(s + since[-2] for s in since[:-1]), since[-2]])
        del kept[1 + int(np.argmin(np.log(age[:-2] / age[2:])))]

    def looks(self, stamp: int) -> list[tuple[float, RangeImage]]:
        """Age, seconds, and image of each, newest first, for a scan at a stamp, ns."""
        return [(max(1e-3, (stamp - k.stamp) / NS_PER_S), k.image) for k in self._kept[::-1]]

    def tells(self, stamp: int) -> bool:
        """Whether the oldest is old enough for a scan at a stamp, ns, to show who walks."""
        return bool(self._kept) and stamp - self._kept[0].stamp >= _TELLING_S * NS_PER_S

    def vanished(self, image: RangeImage, kind: str) -> F32:
        """Points (V, 3), odom frame, of the oldest and the newest scan in space seen free since.

        Args:
            image: what a new scan saw.
            kind: depth or lidar.
        """
        gone = [np.zeros((0, 3), np.float32)]
        for past in (*self._kept[:1], *self._kept[1:][-1:]):
            places = past.points.astype(np.float64)
            margin, _ = image.look(places, np.eye(4), image, NOISE[kind], 1.0)
            gone.append(past.points[np.isfinite(margin) & (margin > _SURE)])
        return np.concatenate(gone)

    def clear(self) -> None:
        """Forget all."""
        self._kept.clear()


def evidence_of(
    cells: Cells,
    looks: list[tuple[float, RangeImage]],
    now: RangeImage,
    kind: str,
    static: F32 | None,
) -> F32:
    """Evidence about each cell of a scan.

    Args:
        cells: the cells.
        looks: age, seconds, and image of earlier scans, at least one, newest first.
        now: what the scan itself saw.
        kind: depth or lidar.
        static: (N,) P(static) by the network of the points that the cells were made of; None =
            not asked.

    Returns:
        (M, COLUMNS) float32. 0 to 13 and 25: `_sum_up`; 14: whether it is a depth camera; 15, 16:
        logarithms of the ages of the oldest and the newest look; 17: number of looks; 18 to 20:
        does the surface face the sensor, is it level, is there one. Of a lidar also 21 to 24:
        logarithms of range and points, height over the sensor, logarithm of the size of the cell.
        Not of a depth camera: in a room they say what a thing is rather than whether it moves.
        26, 27: log odds of motion by the network, and whether it was asked.
    """
    count, out = len(cells), np.zeros((len(cells), COLUMNS), np.float32, order='F')
    margin, speed = np.empty((2, len(looks), count), np.float32)
    where = cells.centre, cells.T_odom_sensor
    for row, (age_s, image) in enumerate(looks):
        margin[row], speed[row] = image.look(*where, now, NOISE[kind], age_s)
    _sum_up(margin, speed, out)
    ranges = np.maximum(cells.range_m, 1e-6)
    facing = np.abs(np.einsum('ij,ij->i', cells.normal, cells.centre)) / ranges
    out[:, 14] = kind == 'depth'
    out[:, 15], out[:, 16] = np.log(looks[-1][0] + 0.05), np.log(looks[0][0] + 0.02)
    out[:, 17] = len(looks) / LOOKS
    out[:, 18], out[:, 20] = facing * cells.flat, cells.flat
    if kind == 'lidar':
        out[:, 19] = np.abs(cells.normal[:, 2]) * cells.flat
        out[:, 21], out[:, 22] = np.log(ranges), np.log(cells.counts)
        out[:, 23] = np.clip(cells.centre[:, 2] / 3.0, -3.0, 3.0)
        out[:, 24] = np.log(cells.size_m / (0.02 * ranges + 0.02))
    if static is not None:
        out[:, 26], out[:, 27] = _said(cells, static), 1.0
    return out


def _said(cells: Cells, static: F32) -> NDArray[np.float64]:
    """Mean log odds (M,) of motion over the points (N,) of each cell, by their P(static)."""
    sure = np.clip(static, 0.002, 0.998)
    inside = cells.of_point >= 0
    odds = np.log((1.0 - sure) / sure)[inside]
    total = np.bincount(cells.of_point[inside], odds, len(cells))
    return total / np.maximum(np.bincount(cells.of_point[inside], minlength=len(cells)), 1)


@compiled
def _bent(x):  # type: ignore[no-untyped-def]
    """Logarithm on both sides of 0."""
    return np.log1p(x) if x > 0.0 else -np.log1p(-x) if x < 0.0 else 0.0


@compiled
def _sum_up(margin, speed, out):  # type: ignore[no-untyped-def]
    """What K looks at M cells say together.

    Args:
        margin: (K, M) float32 standard deviations before (+) or behind (-) what was seen; 0 on
            it, NaN unseen, infinite where nothing came back; newest look first.
        speed: (K, M) float32 m/s at which what hid the cell would have moved to it, -1 where it
            is still there.
        out: (M, 26 or more) float32. 0: looks in whose view it is; 1, 2: share of the looks at
            the place that saw it free, or clearly so; 3, 4: number that saw it free, or a surface;
            5: share that something hid it from; 6, 7: largest and smallest margin of the looks at
            the place; 8, 9, 10: margin of the newest, the second and the oldest look; 11: share of
            the hidden looks of which the hiding thing has gone; 12, 13: its speed, and the scatter
            of that; 25: share of the looks to which nothing came back from there.
    """
    looks, cells = margin.shape
    for row in range(cells):
        free, clear, on, behind, gone, seen, empty = 0, 0, 0, 0, 0, 0, 0
        most, least, total, squared = 0.0, 99.0, 0.0, 0.0
        for k in range(looks):
            m = margin[k, row]
            if not np.isfinite(m):
                empty += m > 0.0
                continue
            if seen < 2:
                out[row, 8 + seen] = _bent(m)
            out[row, 10] = _bent(m)
            seen += 1
            if m < -CLEAR:
                behind += 1
                if speed[k, row] >= 0.0:
                    gone += 1
                    total += speed[k, row]
                    squared += speed[k, row] ** 2
                continue
            if m > CLEAR:
                free += 1
                clear += m > _SURE
            else:
                on += 1
            most, least = max(most, m), min(least, m)
        at = free + on
        mean = total / max(1, gone)
        out[row, 0] = seen / LOOKS
        out[row, 1], out[row, 2] = free / max(1, at), clear / max(1, at)
        out[row, 3], out[row, 4] = free / LOOKS, on / LOOKS
        out[row, 5] = behind / max(1, seen)
        out[row, 6], out[row, 7] = _bent(most), _bent(least) if at else 0.0
        out[row, 11], out[row, 12] = gone / max(1, behind), _bent(mean)
        scatter = np.sqrt(max(0.0, squared / max(1, gone) - mean * mean)) / (mean + 0.3)
        out[row, 13] = scatter if gone > 1 else 1.0
        out[row, 25] = empty / looks
