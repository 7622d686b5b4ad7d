# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""From cells that surely move to whole things: surfaces and convex parts vote as one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.odometry.dynamics import segments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import DynamicsConfig

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]
    Mask = NDArray[np.bool_]

_STEP = 0.35
"""Largest offset between neighbouring cells of one smooth surface, in cells."""
_ANY = -2.0
"""No limit on how far a surface bends."""


@dataclass(frozen=True, eq=False)
class Cells:
    """The occupied cells of one scan.

    Attributes:
        table: (C,) int64 hash table of cell keys.
        slots: (C,) int32, cell of each table entry.
        keys: (M,) int64.
        counts: (M,) points per cell.
        size_m: edge of a cell.
    """

    table: NDArray[np.int64]
    slots: NDArray[np.int32]
    keys: NDArray[np.int64]
    counts: NDArray[Any]
    size_m: float

    @property
    def index(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]:
        """Keys, table and slots, as the kernels take them."""
        return self.keys, self.table, self.slots


@dataclass(frozen=True, eq=False)
class Shape:
    """How the surface runs through the cells.

    Attributes:
        centre: (M, 3) mean point, metres, sensor at the origin, odom axes.
        normal: (M, 3) unit, towards the sensor.
        flat: (M,) bool, whether the normal means anything.
    """

    centre: F64
    normal: F64
    flat: Mask

    def parts(
        self, grid: Cells, member: Mask, bend: float, fold: float
    ) -> tuple[NDArray[np.int32], int]:
        """Connected parts of member cells (M,), and how many; see `segments.divide`."""
        part, number = segments.divide(
            *grid.index,
            member,
            self.centre,
            self.normal,
            self.flat,
            bend,
            _STEP * grid.size_m,
            fold,
        )
        return part, int(number)


def confirmed(grid: Cells, seed: Mask, config: DynamicsConfig) -> NDArray[np.int32]:
    """Group (M,) of each seed in a connected group large enough to be a thing; else -1."""
    group: NDArray[np.int32] = segments.groups(grid.keys, grid.table, grid.slots, seed)
    if seed.any():
        points = np.bincount(group[seed], weights=grid.counts[seed])
        size = np.bincount(group[seed])
        thing = (points >= config.min_cluster_points) & (size >= config.min_seed_cells)
        group[seed & ~thing[group]] = -1
    return group


def complete(
    grid: Cells,
    shape: Shape,
    group: NDArray[np.int32],
    known: Mask,
    wall: Mask,
    config: DynamicsConfig,
) -> tuple[Mask, Mask]:
    """Cells of whole things that move.

    A smooth surface (a floor, the side of a box) moves as one: it is taken whole when enough of
    its cells that were seen before are seeds, and is out of bounds when it is large and they are
    not: that keeps motion from spreading over a floor that no scan has seen yet. What is left
    falls into parts where surfaces fold inwards, since things touch there; each part votes again.

    Args:
        grid: the cells.
        shape: their surfaces.
        group: (M,) of the seeds, -1 for other cells.
        known: (M,) cells that stand on what an earlier scan saw and are no seeds.
        wall: (M,) cells on large planes of the map.
        config: settings.

    Returns:
        (M,) cells that move and are no seeds, and (M,) cells over which motion may spread.
    """
    seed = group >= 0
    bend = float(np.cos(np.deg2rad(config.bend_deg)))
    surface, count = shape.parts(grid, shape.flat, bend, 0.0)
    size = _tally(surface, count, np.ones(len(seed), np.bool_))
    moving, share = _votes(surface, count, seed, known)
    whole = (moving >= config.min_seed_cells) & (share >= config.surface_share)
    taken = _spread(surface, whole)
    free = ~_spread(surface, (size >= config.surface_cells) & ~whole)
    free &= ~wall | seed | taken
    part, count = shape.parts(grid, free, _ANY, config.fold)
    moving, share = _votes(part, count, seed | taken, known & ~taken)
    whole = (moving >= config.min_object_cells) & (share >= config.object_share)
    taken |= _spread(part, whole)
    return taken & ~seed, free & ~wall


def _tally(part: NDArray[np.int32], count: int, member: Mask) -> NDArray[np.int64]:
    """How many member cells each part has (count,)."""
    found: NDArray[np.int64] = np.bincount(part[member & (part >= 0)], minlength=count)
    return found


def _votes(
    part: NDArray[np.int32], count: int, seed: Mask, known: Mask
) -> tuple[NDArray[np.int64], F64]:
    """Seeds of each part (count,), and their share of its cells that were seen before."""
    moving = _tally(part, count, seed)
    still = _tally(part, count, known & ~seed)
    share: F64 = moving / np.maximum(1, moving + still)
    return moving, share


def _spread(part: NDArray[np.int32], chosen: Mask) -> Mask:
    """Cells (M,) of the chosen parts."""
    inside = part >= 0
    out = np.zeros(len(part), np.bool_)
    out[inside] = chosen[part[inside]]
    return out
