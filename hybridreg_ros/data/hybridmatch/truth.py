# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What only the generator knows of a pair: how each point moved, and how well it was measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.se3 import apply, inverse, kabsch
from hybridreg_ros.data.pair import Label

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.meshes.scene import Mover
    from hybridreg_ros.data.pair import PointPair

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Truth:
    """How a pair came about.

    Attributes:
        movers: of the scene; instance k is mover k - 1.
        times_s: of the movers in the source and in the target.
        T_world_source: (4, 4) pose of the source sensor.
        sigma_m: (N,) float32 standard deviation of the error of each source point.
        seen: (N,) bool static source points whose true place the target shows: the overlap.
    """

    movers: tuple[Mover, ...]
    times_s: tuple[float, float]
    T_world_source: F64
    sigma_m: F32
    seen: NDArray[np.bool_]

    def flow(self, pair: PointPair) -> F64:
        """How far each source point (N, 3) moves in the world until the target, source frame.

        Exact for what is rigid; a deforming thing moves as its vertex nearest to the point.
        """
        flow = np.zeros((len(pair.source), 3))
        for number in np.unique(pair.source_instance[pair.source_label > 0]):
            mover = self.movers[int(number) - 1]
            rows = np.flatnonzero(pair.source_instance == number)
            before, after = (mover.mesh_at(t).vertices.astype(np.float64) for t in self.times_s)
            place: F64 = np.asarray(
                apply(self.T_world_source, pair.source[rows].astype(np.float64))
            )
            if mover.label == Label.MOVING_RIGID:
                flow[rows] = apply(kabsch(before, after), place) - place
            else:
                flow[rows] = (after - before)[_nearest(before, place)]
        turned: F64 = flow @ inverse(self.T_world_source)[:3, :3].T
        return turned


def _nearest(vertices: F64, points: F64) -> NDArray[np.int64]:
    """Row of the nearest of some vertices (V, 3) for each point (N, 3)."""
    rows = [
        ((part[:, None] - vertices[None]) ** 2).sum(-1).argmin(1)
        for part in np.array_split(points, max(1, len(points) // 256))
    ]
    return np.concatenate(rows)
