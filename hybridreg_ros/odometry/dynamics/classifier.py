# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which points move: learned evidence of cells and things, remembered from scan to scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.dynamics import models
from hybridreg_ros.odometry.dynamics.cells import LARGER, Cells, Grid
from hybridreg_ros.odometry.dynamics.context import context_of
from hybridreg_ros.odometry.dynamics.evidence import Look, Past, evidence_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import DynamicsConfig
    from hybridreg_ros.odometry.preprocess import SensorModel
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan
    from hybridreg_ros.odometry.visibility.range_image import RangeImage

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

_KEEP = 0.8
"""Share of the log odds of a place that carries over to the next scan."""
_MOST = 8.0
"""Largest log odds that are remembered."""
_FORGET, _LEAST, _SHARE = 0.5, 1.0, 0.4
"""Log odds that a thing at rest loses a second, and below which it no longer counts as moving; and
the share of a part that moved from which on it is one."""
_STANDS = -1000.0
"""Where nothing moved, so that a place beside it keeps nothing either."""
FIRST = -1.0
"""Log odds in the first scan, before which nothing was seen."""


@dataclass(frozen=True, eq=False)
class _Last:
    """The last scan: its stamp, ns, its cells, what is remembered of them, and P(dynamic) (M, 1).

    Remembered (M, 3): as by `remembered`, and log odds of what moves, else `_STANDS`.
    """

    stamp: int
    cells: Cells
    memory: F32
    moving: F32


class Dynamics:
    """Per-point P(dynamic).

    A small model gives every cell of a scan log odds from how it stands against earlier scans
    (`evidence`). Those of a place add up from scan to scan and fade. A second one decides, from
    them and from what the thing says that a cell belongs to (`context`). What moved and comes to
    rest counts as moving for a while (`kept_at_rest`).

    Args:
        config: settings.
        sensor: kind and voxel size.
    """

    def __init__(self, config: DynamicsConfig, sensor: SensorModel) -> None:
        self._config = config
        self._voxel_m = sensor.voxel_size_m
        self._kind = sensor.kind
        self._models = models.packaged()
        self._past = Past()
        self._last: _Last | None = None

    def recalled(self, points: F32, T_odom_sensor: F64) -> F32:
        """P(dynamic) (N,) of points (N, 3), sensor frame, by what the last update said there."""
        if self._last is None:
            return np.zeros(len(points), np.float32)
        return self._last.cells.at(points, T_odom_sensor, self._last.moving)[:, 0]

    def update(
        self,
        cloud: PreprocessedScan,
        T_odom_sensor: F64,
        image: RangeImage,
        stamp: int,
        static: F32 | None = None,
    ) -> F32:
        """P(dynamic) of every point of a scan at its pose.

        Args:
            cloud: the preprocessed scan.
            T_odom_sensor: (4, 4) its pose.
            image: what it saw.
            stamp: ns.
            static: (M,) P(static) of its thinned points by the network; None = not asked.

        Returns:
            (N,) float32 in [0, 1]; 0 outside the range limits, in the first scan, or when it is
            switched off.
        """
        if not self._config.enabled or len(cloud.means) == 0:
            return np.zeros(len(cloud.points), np.float32)
        grid = Grid.of(self._voxel_m, image.view.step_rad, LARGER[self._kind])
        cells = Cells.of(cloud.means, cloud.counts, T_odom_sensor, grid)
        before, age_s = np.zeros((len(cells), 4), np.float32), 0.0
        if self._last is not None:
            age_s = (stamp - self._last.stamp) / NS_PER_S
            before = self._last.cells.at(cells.centre, T_odom_sensor, self._last.memory)
        odds = final = np.full(len(cells), FIRST, np.float32)
        moving = np.zeros(len(cells), np.float32)
        if looks := self._past.looks(stamp):
            evidence = evidence_of(cells, looks, image, self._kind, static)
            odds = self._models.alone(evidence)
            context = context_of(cells, evidence, odds, before, self._kind)
            final = kept_at_rest(cells, self._models.in_context(context), before[:, 2], age_s)
            moving = (1.0 / (1.0 + np.exp(-final))).astype(np.float32)
        moves = np.where(final > 0.0, np.minimum(final, _MOST), _STANDS).astype(np.float32)
        memory = np.column_stack([remembered(before, odds), moves])
        self._last = _Last(stamp, cells, memory, moving[:, None])
        probability: F32 = _spread(moving, cells.of_point, cloud.cube)
        return probability

    def knows(self, stamp: int) -> bool:
        """Whether earlier scans tell what moves in a scan at a stamp, ns, or nobody asks."""
        return not self._config.enabled or self._past.tells(stamp)

    def remember(self, image: RangeImage, points: F32, stamp: int) -> None:
        """Keep a scan for later tests.

        Args:
            image: what the scan saw.
            points: (K, 3) float32, thinned static points, odom frame, metres.
            stamp: ns.
        """
        self._past.keep(Look(stamp, image, points))

    def vanished(self, image: RangeImage) -> F32:
        """Points (V, 3), odom frame, of earlier scans in space that a new scan sees through."""
        return self._past.vanished(image, self._kind)

    def clear(self) -> None:
        """Forget everything."""
        self._past.clear()
        self._last = None


@compiled
def _spread(moving, cell, cube):  # type: ignore[no-untyped-def]
    """Values (M,) of the cells of the cubes of points (N,); 0 where there is none."""
    of_cube, out = np.zeros(len(cell) + 1, np.float32), np.empty(len(cube), np.float32)
    for k in range(len(cell)):
        if cell[k] >= 0:
            of_cube[k] = moving[cell[k]]
    for row in range(len(cube)):
        out[row] = of_cube[cube[row]]  # the last one is of no cube
    return out


def kept_at_rest(cells: Cells, odds: F32, before: F32, age_s: float) -> F32:
    """Log odds (M,) of cells, with those of a thing that has come to rest.

    A part of which much stands where cells moved, and of which less moves now, is a thing that
    moved and stays: there it keeps the log odds that it had, less some a second. Where a thing has
    left, what it hid belongs to other parts, of which it covered little.

    Args:
        cells: the cells of a scan.
        odds: (M,) log odds that they move.
        before: (M,) those that the last scan had there if it moved, else `_STANDS`.
        age_s: seconds since then.
    """
    part, count = cells.parts
    was, rest = before > 0.0, before - np.float32(_FORGET * age_s)
    moved, moves = (np.bincount(part, cells.counts * some, count) for some in (was, odds > 0.0))
    calmer = (moved > moves) & (moved >= _SHARE * np.bincount(part, cells.counts, count))
    return np.where(was & calmer[part] & (rest > _LEAST), np.maximum(odds, rest), odds)


def remembered(before: F32, odds: F32) -> F32:
    """Log odds and number of scans (M, 2) of places after one more scan.

    Args:
        before: (M, 2 or more) what earlier scans tell of them.
        odds: (M,) log odds of the scan.
    """
    known = np.clip(_KEEP * before[:, 0] + odds, -_MOST, _MOST)
    return np.column_stack([known, _KEEP * before[:, 1] + 1.0]).astype(np.float32)
