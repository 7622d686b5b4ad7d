# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which points move: free-space test against earlier scans, memory, growth to whole objects."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry import align, cells
from hybridreg_ros.odometry.rangeimage import FRONT, ON, RangeImage

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import DynamicsConfig
    from hybridreg_ros.odometry.localmap import LocalMap
    from hybridreg_ros.odometry.preprocess import Cloud, SensorModel

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

_SURE = 0.95
"""P(dynamic) of a cell that stands in space seen free."""


@dataclass(frozen=True, eq=False)
class _Past:
    """An earlier scan: what it saw, and some of its points to look for later."""

    stamp: int
    image: RangeImage
    points: F32


@dataclass(frozen=True, eq=False)
class _Grid:
    """Cells of the last scan and their P(dynamic), odom frame."""

    table: NDArray[np.int64]
    slots: NDArray[np.int32]
    value: F32


class Dynamics:
    """Per-point P(dynamic) without a network; sharpened by one when there is one.

    A point that stands where two earlier scans saw through is something that came: a seed. Seeds
    grow over connected cells to whole objects, but not over large planes of the map (floors,
    walls). A cell that was dynamic keeps a fading part of it. A point in a direction or behind a
    surface where no scan saw anything is new, not dynamic.

    Args:
        config: settings.
        sensor: voxel size.
    """

    def __init__(self, config: DynamicsConfig, sensor: SensorModel) -> None:
        self._config = config
        self._size_m = config.cell * sensor.voxel_size_m
        self._slack_m = config.tolerance * sensor.voxel_size_m
        self._past: deque[_Past] = deque(maxlen=config.memory)
        self._grid: _Grid | None = None

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

    def update(
        self,
        cloud: Cloud,
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
            (N,) float32 in [0, 1]; 0 outside the range limits.
        """
        usable = np.flatnonzero(cloud.usable)
        points = cloud.points[usable]
        placed = se3.apply(T_odom_sensor, points)
        table, slots, keys, counts, cell = cells.occupied(placed, self._size_m)
        inside = np.flatnonzero(cell >= 0)
        first = np.zeros(len(keys), np.int64)
        first[cell[inside][::-1]] = inside[::-1]
        remembered = self._remembered(placed[first], spread=False)
        seed = self._seeds(points[first], T_odom_sensor, remembered)
        if uncertainty is not None:
            whole = np.full(len(cloud.points), -1.0, np.float32)
            whole[cloud.map_rows] = uncertainty
            vote = _mean_per_cell(whole[usable], cell, len(keys))
            seed = self._with_network(seed, vote, points[first], T_odom_sensor)
        value = self._objects(keys, table, slots, counts, seed, placed[first], local_map)
        # Memory comes after the growth and does not spread: else it would creep over everything.
        value = np.maximum(value, self._config.decay * remembered)
        self._grid = _Grid(table, slots, value)
        out = np.zeros(len(cloud.points), np.float32)
        out[usable[inside]] = value[cell[inside]]
        return out

    def remember(self, image: RangeImage, points: F32, stamp: int) -> None:
        """Keep a scan for later tests when the last one kept is old enough.

        Args:
            image: what the scan saw.
            points: (K, 3) float32, thinned static points, odom frame, metres.
            stamp: ns.
        """
        if self._past and abs(stamp - self._past[-1].stamp) < self._config.spacing_s * NS_PER_S:
            return
        self._past.append(_Past(stamp, image, points))

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
                self._config.tolerance_share,
                strict=True,
            )
            gone.append(past.points[stand == FRONT])
        return np.concatenate(gone)

    def clear(self) -> None:
        """Forget everything."""
        self._past.clear()
        self._grid = None

    def _oldest_and_newest(self) -> Iterable[_Past]:
        return {id(p): p for p in (*list(self._past)[:1], *list(self._past)[-1:])}.values()

    def _seeds(self, points: F32, T_odom_sensor: F64, remembered: F32) -> F32:
        """P(dynamic) per point from free space, with hysteresis in time."""
        front = np.zeros(len(points), np.int32)
        on = np.zeros(len(points), np.int32)
        for past in self._past:
            stand = past.image.stand(
                points, T_odom_sensor, self._slack_m, self._config.tolerance_share, strict=True
            )
            front += stand == FRONT
            on += stand == ON
        share = front / np.maximum(1, front + on)
        came = (front >= 2) & (share >= self._config.enter_share)
        stays = (front >= 2) & (share >= self._config.stay_share) & (remembered >= 0.5)
        return np.where(came | stays, _SURE, 0.0).astype(np.float32)

    def _with_network(self, seed: F32, uncertainty: F32, points: F32, T_odom_sensor: F64) -> F32:
        """Let the network speak for points in directions that the last scan kept has seen."""
        if not self._past:
            return seed
        stand = self._past[-1].image.stand(
            points, T_odom_sensor, self._slack_m, self._config.tolerance_share, strict=True
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

    def _on_large_plane(self, placed: F64, local_map: LocalMap) -> NDArray[np.bool_]:
        """Which points (K, 3), odom frame, lie on a plane of the map one coarse voxel large."""
        level, n = local_map.coarse, len(placed)
        kind, variance = np.zeros(n, np.int8), np.zeros(n)
        anchor, normal = np.zeros((n, 3)), np.zeros((n, 3))
        align.associate(
            placed, np.eye(3), np.zeros(3), level.grid, level.grid, local_map.updates,
            kind, anchor, normal, variance,
        )  # fmt: skip
        off = np.abs(np.einsum('ij,ij->i', placed - anchor, normal))
        thin = variance < (self._slack_m) ** 2
        on: NDArray[np.bool_] = (kind == align.PLANE) & thin & (off < self._slack_m)
        return on

    def _objects(
        self,
        keys: NDArray[np.int64],
        table: NDArray[np.int64],
        slots: NDArray[np.int32],
        counts: NDArray[np.int32],
        seed: F32,
        placed: F32,
        local_map: LocalMap,
    ) -> F32:
        """P(dynamic) per cell: seeds in groups large enough to be a thing, grown over it."""
        value = np.zeros_like(seed)
        member = seed >= 0.5
        if not member.any():
            return value
        group = cells.groups(keys, table, slots, member)
        points = np.bincount(group[member], weights=counts[member])
        size = np.bincount(group[member])
        thing = (points >= self._config.min_cluster_points) & (size >= self._config.min_seed_cells)
        group[member & ~thing[group]] = -1
        value[group >= 0] = seed[group >= 0]
        if not thing.any():
            return value
        passable = ~self._on_large_plane(placed.astype(np.float64), local_map)
        budget = (self._config.growth_share * size).astype(np.int64)
        cells.grow(
            keys, table, slots, value, group, budget, passable,
            self._config.growth, self._config.fade,
        )  # fmt: skip
        return value


def _mean_per_cell(values: F32, cell: NDArray[np.int32], count: int) -> F32:
    """Mean of the values (N,) that are not negative in each of `count` cells; 0 where none is."""
    given = (values >= 0.0) & (cell >= 0)
    total = np.bincount(cell[given], weights=values[given], minlength=count)
    number = np.bincount(cell[given], minlength=count)
    return (total / np.maximum(1, number)).astype(np.float32)
