# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which points move: free-space test against earlier scans, memory, growth to whole objects."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.dynamics import cells, objects, segments
from hybridreg_ros.odometry.dynamics.background import lies_on_background, lies_on_plane
from hybridreg_ros.odometry.map.thinning import occupied
from hybridreg_ros.odometry.visibility.range_image import FRONT, ON, RangeImage

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import DynamicsConfig
    from hybridreg_ros.odometry.map.local_map import LocalMap
    from hybridreg_ros.odometry.preprocess import SensorModel
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

_SURE = 0.95
"""P(dynamic) of a cell that stands in space seen free."""
_FORGOTTEN = 1e-3
"""Remembered P(dynamic) below this is 0; fading on, it would become denormal, and slow."""
_BENT = 2.0
"""How far bent scans may raise the ground, in slacks."""
_TOLERANCE = {'depth': (0.4, 0.0125), 'lidar': (0.5, 0.015)}
"""Slack in voxels and as a share of the range; a sparse lidar says less about slanted surfaces."""


@dataclass(frozen=True, eq=False)
class _Past:
    """An earlier scan: what it saw, and some of its points to look for later."""

    stamp: int
    image: RangeImage
    points: F32


@dataclass(frozen=True, eq=False)
class _CellValues:
    """Cells of the last scan and their P(dynamic), odom frame."""

    table: NDArray[np.int64]
    slots: NDArray[np.int32]
    value: F32


class Dynamics:
    """Per-point P(dynamic) without a network; sharpened by one when there is one.

    A point that stands where two earlier scans saw through is something that came: a seed. Seeds
    grow to whole things (`objects`), but not over large planes (floors, walls), nor what lies on
    the surface behind (`background`); ground that a bent scan has raised is no seed. A cell that
    was dynamic keeps a fading part of it. A point in a direction or behind a surface where no
    scan saw anything is new: it moves only when the thing that it belongs to does.

    Args:
        config: settings.
        sensor: voxel size.
    """

    def __init__(self, config: DynamicsConfig, sensor: SensorModel) -> None:
        self._config = config
        self._size_m = config.cell * sensor.voxel_size_m
        self._kind = sensor.kind
        slack, share = _TOLERANCE[sensor.kind]
        self._slack_m = (config.tolerance or slack) * sensor.voxel_size_m
        self._slack_share = config.tolerance_share or share
        self._past: list[_Past] = []
        self._grid: _CellValues | None = None

    def trust(self, points: F32, T_odom_sensor: F64) -> F32:
        """Weight (K,) of points for a registration: low near what moved in the last scan.

        Args:
            points: (K, 3) float32, sensor frame, metres.
            T_odom_sensor: (4, 4) predicted pose.
        """
        if self._grid is None:
            return np.ones(len(points), np.float32)
        moving = self._remembered(se3.apply(T_odom_sensor, points), spread=True)
        return (1.0 - moving).astype(np.float32)

    def recalled(self, points: F32, T_odom_sensor: F64) -> F32:
        """P(dynamic) (N,) of points (N, 3), sensor frame, by what the last update said there."""
        if self._grid is None:
            return np.zeros(len(points), np.float32)
        return self._remembered(se3.apply(T_odom_sensor, points), spread=False)

    def update(
        self,
        cloud: PreprocessedScan,
        T_odom_sensor: F64,
        local_map: LocalMap,
        uncertainty: F32 | None = None,
    ) -> F32:
        """P(dynamic) of every point of a scan at its pose.

        Args:
            cloud: the preprocessed scan.
            T_odom_sensor: (4, 4) its pose.
            local_map: the map of static points; its large planes stop the growth.
            uncertainty: (M,) float32 sigma^2 of the network per map point, or None.

        Returns:
            (N,) float32 in [0, 1]; 0 outside the range limits, or when it is switched off.
        """
        if not self._config.enabled:
            return np.zeros(len(cloud.points), np.float32)
        placed = se3.apply(T_odom_sensor, cloud.means)
        everywhere = np.ones(len(placed), np.bool_)
        table, slots, keys, first, _, cell = occupied(placed, self._size_m, everywhere)
        inside = np.flatnonzero(cell >= 0)
        counts = np.bincount(cell[inside], weights=cloud.counts[inside], minlength=len(keys))
        remembered = self._remembered(placed[first], spread=False)
        seed, known = self._seeds(cloud.means[first], T_odom_sensor, remembered)
        self._leave_ground(seed, known, placed[first], T_odom_sensor, local_map)
        if uncertainty is not None:
            vote = _mean_per_cell(uncertainty, cell, len(keys))
            seed = self._with_network(seed, vote, cloud.means[first], T_odom_sensor)
        grid = objects.Cells(table, slots, keys, counts, self._size_m)
        group = objects.confirmed(grid, seed >= 0.5, self._config)
        value = np.zeros(len(keys), np.float32)
        if (group >= 0).any():
            shape = objects.Shape(
                *segments.normals(placed - T_odom_sensor[:3, 3], cell, *grid.index)
            )
            wall = lies_on_plane(placed[first], local_map.coarse, local_map.updates, self._slack_m)
            value = self._grown(grid, shape, group, seed, known, wall)
        # Memory comes after the growth and does not spread: else it would creep over everything.
        fading = self._config.decay * remembered
        fading[fading < _FORGOTTEN] = 0.0
        value = np.maximum(value, fading)
        self._leave_background(value, group >= 0, placed[first], T_odom_sensor[:3, 3], local_map)
        self._grid = _CellValues(table, slots, value)
        of_cube = np.where(cell >= 0, value[cell], 0.0).astype(np.float32)
        return np.where(cloud.cube >= 0, of_cube[cloud.cube], np.float32(0.0))

    def remember(self, image: RangeImage, points: F32, stamp: int) -> None:
        """Keep a scan for later tests: every one at first, then one per `spacing_s`.

        The scan that goes is the one nearest in time to the one before it, or the oldest when
        they are a spacing apart: so a short past is looked at closely and a long one evenly.

        Args:
            image: what the scan saw.
            points: (K, 3) float32, thinned static points, odom frame, metres.
            stamp: ns.
        """
        past, spacing = self._past, self._config.spacing_s * NS_PER_S
        if len(past) == self._config.memory:
            if abs(stamp - past[-1].stamp) < spacing:
                return
            gaps = [abs(b.stamp - a.stamp) for a, b in pairwise(past)]
            close = int(np.argmin(gaps)) if gaps and min(gaps) < 0.9 * spacing else -1
            del past[close + 1]
        past.append(_Past(stamp, image, points))

    def vanished(self, image: RangeImage) -> F32:
        """Points (V, 3), odom frame, of earlier scans in space that a new scan sees through.

        Args:
            image: what the new scan saw.
        """
        gone = [np.zeros((0, 3), np.float32)]
        for past in self._oldest_and_newest():
            stand = image.stand(
                past.points,
                np.eye(4),
                2.0 * self._slack_m,
                self._slack_share,
                strict=True,
            )
            gone.append(past.points[stand == FRONT])
        return np.concatenate(gone)

    def clear(self) -> None:
        """Forget everything."""
        self._past.clear()
        self._grid = None

    def _oldest_and_newest(self) -> Iterable[_Past]:
        return {id(p): p for p in (*self._past[:1], *self._past[-1:])}.values()

    def _seeds(
        self, points: F32, T_odom_sensor: F64, remembered: F32
    ) -> tuple[F32, NDArray[np.bool_]]:
        """P(dynamic) per point from free space, with hysteresis in time.

        And which of the other points stand on what an earlier scan saw.
        """
        front = np.zeros(len(points), np.int32)
        on = np.zeros(len(points), np.int32)
        for past in self._past:
            stand = past.image.stand(
                points, T_odom_sensor, self._slack_m, self._slack_share, strict=True
            )
            front += stand == FRONT
            on += stand == ON
        share = front / np.maximum(1, front + on)
        # One look is not enough: the poses of the first two scans may disagree.
        came = (front >= 2) & (share >= self._config.enter_share)
        stays = (front >= 2) & (share >= self._config.stay_share) & (remembered >= 0.5)
        moves = came | stays
        return np.where(moves, _SURE, 0.0).astype(np.float32), (on > 0) & ~moves

    def _with_network(self, seed: F32, uncertainty: F32, points: F32, T_odom_sensor: F64) -> F32:
        """Let the network speak for points in directions that the last scan kept has seen."""
        if not self._past:
            return seed
        stand = self._past[-1].image.stand(
            points, T_odom_sensor, self._slack_m, self._slack_share, strict=True
        )
        known = (stand == ON) | (stand == FRONT)
        vote = np.where(known, self._config.network_weight * uncertainty, 0.0)
        return (1.0 - (1.0 - seed) * (1.0 - vote)).astype(np.float32)

    def _remembered(self, placed: NDArray[np.floating], spread: bool) -> F32:
        """P(dynamic) in the last scan at points (K, 3), odom frame, or also one cell around."""
        out = np.zeros(len(placed), np.float32)
        if self._grid is not None:
            grid = self._grid
            cells.look_up(placed, self._size_m, grid.table, grid.slots, grid.value, spread, out)
        return out

    def _leave_ground(
        self,
        seed: F32,
        known: NDArray[np.bool_],
        placed: F32,
        T_odom_sensor: F64,
        local_map: LocalMap,
    ) -> None:
        """Take seeds (M,) on the ground for known: it does not move, so a scan was bent there.

        Only for lidars, which stand upright: a nod within a turn that was not found raises the
        ground in part of the view, and what hangs on it would follow.
        """
        rows = np.flatnonzero(seed > 0.0)
        if self._kind != 'lidar' or len(rows) == 0:
            return
        still = rows[
            lies_on_background(
                placed[rows],
                T_odom_sensor[:3, 3],
                local_map.coarse,
                _BENT * self._slack_m,
                up=T_odom_sensor[:3, 2],
            )
        ]
        seed[still] = 0.0
        known[still] = True

    def _leave_background(
        self, value: F32, seed: NDArray[np.bool_], placed: F32, sensor: F64, local_map: LocalMap
    ) -> None:
        """Set the value (M,) of floors and walls to 0 where only their surroundings move."""
        rows = np.flatnonzero((value > 0.0) & ~seed)
        if len(rows):
            still = lies_on_background(placed[rows], sensor, local_map.coarse, self._slack_m)
            value[rows[still]] = 0.0

    def _grown(
        self,
        grid: objects.Cells,
        shape: objects.Shape,
        group: NDArray[np.int32],
        seed: F32,
        known: NDArray[np.bool_],
        wall: NDArray[np.bool_],
    ) -> F32:
        """P(dynamic) per cell: that of the seeds in groups, and of what hangs on them."""
        seeds = group >= 0
        value = np.where(seeds, seed, np.float32(0.0))
        size = np.bincount(group[seeds])
        taken, passable = objects.complete(grid, shape, group, known, wall, self._config)
        value[taken] = _SURE * self._config.fade
        budget = (self._config.growth_share * size).astype(np.int64)
        grown: F32
        grown, _ = cells.grow(
            grid.keys,
            grid.table,
            grid.slots,
            value,
            group,
            budget,
            passable & ~taken,
            self._config.growth,
            self._config.fade,
        )
        return grown


def _mean_per_cell(values: F32, cell: NDArray[np.int32], count: int) -> F32:
    """Mean of the values (N,) that are not negative in each of `count` cells; 0 where none is."""
    given = (values >= 0.0) & (cell >= 0)
    total = np.bincount(cell[given], weights=values[given], minlength=count)
    number = np.bincount(cell[given], minlength=count)
    return (total / np.maximum(1, number)).astype(np.float32)
