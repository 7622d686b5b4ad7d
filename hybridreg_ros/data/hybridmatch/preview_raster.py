# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Drawing clouds into small images, nearest point in front; numpy only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.meshes.geometry import rot_x

if TYPE_CHECKING:
    from numpy.typing import NDArray

    U8 = NDArray[np.uint8]
    F64 = NDArray[np.float64]
    Floats = NDArray[np.floating]

LABEL_COLOURS = np.array([[165, 165, 165], [245, 150, 30], [215, 40, 60]])
"""Static, moving rigid, deforming."""
BLUE, ORANGE = np.array([40, 100, 200]), np.array([240, 140, 20])
_SIZE = (216, 162)
_STOPS = np.array([[48, 18, 59], [70, 110, 230], [40, 200, 180], [160, 250, 60], [250, 185, 55],
                   [230, 80, 15], [122, 4, 3]])  # fmt: skip


@dataclass(frozen=True, eq=False)
class Projection:
    """How points become pixels.

    Attributes:
        kind: 'camera' (z ahead), 'panorama' (x ahead, z up) or 'above' (orthographic).
        R: (3, 3) rotation applied first.
        centre: (3,) subtracted before it, metres.
        scale: pixels per unit: metre ('above') or tangent ('camera').
    """

    kind: str
    R: F64
    centre: F64
    scale: float

    @staticmethod
    def of(points: Floats) -> Projection:
        """The view of the sensor that took a cloud."""
        if is_panorama(points):
            return Projection('panorama', np.eye(3), np.zeros(3), 0.0)
        tangent = np.quantile(np.abs(points[:, 0]) / np.maximum(points[:, 2], 1e-3), 0.998)
        return Projection(
            'camera', np.eye(3), np.zeros(3), 0.48 * _SIZE[0] / max(float(tangent), 0.1)
        )

    @staticmethod
    def above(points: Floats) -> Projection:
        """From above: straight for a lidar, aslant from behind for a camera."""
        low, high = np.quantile(points, [0.03, 0.97], axis=0).astype(np.float64)
        centre = 0.5 * (low + high)
        if is_panorama(points):
            scale = 0.92 * min(np.array(_SIZE) / np.maximum(high - low, 1.0)[:2])
            R = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
            return Projection('above', R, centre, float(scale))
        reach = float(np.linalg.norm(high - low))
        return Projection('above', rot_x(0.75), centre, 0.8 * _SIZE[0] / reach)

    def depth(self, points: Floats) -> F64:
        """Distance (N,) from the viewer, metres."""
        p = (points.astype(np.float64) - self.centre) @ self.R.T
        return np.linalg.norm(p, axis=1) if self.kind == 'panorama' else p[:, 2]

    def pixels(self, points: Floats) -> F64:
        """Column and row (N, 2) of points."""
        p = (points.astype(np.float64) - self.centre) @ self.R.T
        middle = 0.5 * np.array(_SIZE)
        if self.kind == 'above':
            return p[:, :2] * self.scale + middle
        if self.kind == 'camera':
            return p[:, :2] / np.maximum(p[:, 2:], 1e-3) * self.scale + middle
        azimuth = -np.arctan2(p[:, 1], p[:, 0]) / np.pi
        up = np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1]))
        return np.stack([azimuth, -up / 0.6], 1) * middle * [0.99, 0.8] + middle


def is_panorama(points: Floats) -> bool:
    """Whether a cloud lies all around its sensor, as a lidar's does."""
    return bool((points[:, 2] <= 0.0).mean() > 0.05)


def depth_colours(depth: F64) -> NDArray[np.int64]:
    """Colours (N, 3) from near (blue) to far (red)."""
    low, high = np.quantile(depth, [0.01, 0.99])
    at = np.clip((depth - low) / max(high - low, 1e-6), 0.0, 1.0) * (len(_STOPS) - 1)
    return np.stack([np.interp(at, range(len(_STOPS)), stop) for stop in _STOPS.T], 1).astype(int)


def paint(view: Projection, points: Floats, colours: NDArray[np.integer]) -> U8:
    """Image (H, W, 3) of points (N, 3) with colours (N, 3), darker with the distance."""
    width, height = _SIZE
    depth = view.depth(points)
    low, high = np.quantile(depth, [0.02, 0.98])
    shade = 1.0 - 0.35 * np.clip((depth - low) / max(high - low, 1e-6), 0.0, 1.0)
    image = np.full((height, width, 3), 255, np.uint8)
    order = np.argsort(-depth, kind='stable')
    spot = np.floor(view.pixels(points)[order]).astype(np.int64)
    value = (colours * shade[:, None])[order].astype(np.uint8)
    for step in range(9):
        u, v = spot[:, 0] + step // 3 - 1, spot[:, 1] + step % 3 - 1
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        image[v[inside], u[inside]] = value[inside]
    return image


def occupied(points: Floats, others: Floats, cell_m: float) -> NDArray[np.bool_]:
    """Which points (N, 3) have one of `others` in their cell or beside it."""
    low = np.minimum(points.min(0), others.min(0)) - 2.0 * cell_m
    size = np.ceil((np.maximum(points.max(0), others.max(0)) - low) / cell_m).astype(np.int64) + 3

    def key(cell: NDArray[np.int64]) -> NDArray[np.int64]:
        flat: NDArray[np.int64] = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
        return flat

    full = np.unique(key(np.floor((others - low) / cell_m).astype(np.int64)))
    mine = key(np.floor((points - low) / cell_m).astype(np.int64))
    found = np.zeros(len(points), np.bool_)
    for step in range(27):
        i, j, k = step // 9 - 1, step // 3 % 3 - 1, step % 3 - 1
        found |= np.isin(mine + (i * size[1] + j) * size[2] + k, full)
    return found
