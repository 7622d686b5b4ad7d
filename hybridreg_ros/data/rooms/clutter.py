# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Free-form clutter: a pool of shapes, dropped on surfaces and hung in mid-air."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.meshes.csg import free_form
from hybridreg_ros.data.meshes.geometry import fitted, moved, random_rotation, turned

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.data.meshes.scene import Mesh
    from hybridreg_ros.data.rooms.floor import FloorGrid
    from hybridreg_ros.data.rooms.furniture import Surface

    F64 = NDArray[np.float64]


class ClutterPool:
    """A set of free-form shapes of one room; each use is stretched and turned anew."""

    def __init__(self, rng: np.random.Generator, count: int = 16) -> None:
        self._shapes = [free_form(rng, 1.0) for _ in range(count)]

    def take(self, rng: np.random.Generator, size_m: float) -> Mesh:
        """A shape standing on z = 0 about the origin, its longest side `size_m`."""
        mesh = self._shapes[rng.integers(len(self._shapes))]
        if rng.random() < 0.5:
            mesh = moved(mesh, R=random_rotation(rng))
        extent = np.ptp(mesh.vertices, axis=0) * rng.uniform(0.6, 1.4, 3)
        mesh = fitted(mesh, size_m * extent / extent.max())
        return turned(mesh, rng.uniform(0.0, 2.0 * np.pi))

    def on_surface(
        self, rng: np.random.Generator, surface: Surface, count: int
    ) -> list[tuple[Mesh, F64]]:
        """Up to `count` shapes side by side on a surface, with their places (3,) on it.

        The meshes are in the frame of the piece that owns the surface.
        """
        spots: list[tuple[float, float, float]] = []
        things: list[tuple[Mesh, F64]] = []
        widest = min(0.45, 0.7 * max(surface.width, surface.depth), surface.headroom)
        for _ in range(3 * count):
            if len(things) == count:
                break
            size = float(np.exp(rng.uniform(np.log(0.05), np.log(max(widest, 0.06)))))
            mesh = self.take(rng, size)
            r = 0.5 * float(np.hypot(*np.ptp(mesh.vertices[:, :2], axis=0)))
            room = np.array([0.5 * surface.width - 0.6 * r, 0.5 * surface.depth - 0.6 * r])
            if (room <= 0.0).any():
                continue
            x, y = rng.uniform(-room, room)
            if any(np.hypot(x - a, y - b) < 0.8 * (r + c) for a, b, c in spots):
                continue
            spots.append((x, y, r))
            place = np.array([surface.x + x, surface.y + y, surface.z])
            things.append((moved(mesh, place), place))
        return things


class Boxes:
    """Axis-aligned bounds of everything placed so far, to keep mid-air things apart."""

    def __init__(self) -> None:
        self._low: list[F64] = []
        self._high: list[F64] = []
        self._corners: tuple[F64, F64] | None = None

    def add(self, meshes: Sequence[Mesh]) -> None:
        """Remember the bounds of meshes (world frame)."""
        self._corners = None
        for mesh in meshes:
            self._low.append(mesh.vertices.min(0).astype(np.float64))
            self._high.append(mesh.vertices.max(0).astype(np.float64))

    def add_ball(self, centre: F64, radius_m: float) -> None:
        """Remember a ball."""
        self._corners = None
        self._low.append(centre - radius_m)
        self._high.append(centre + radius_m)

    def bounds(self) -> list[tuple[F64, F64]]:
        """Lowest and highest corner of everything remembered."""
        return list(zip(self._low, self._high, strict=True))

    def free(self, centre: F64, radius_m: float) -> bool:
        """True when a ball touches no bounds."""
        if not self._low:
            return True
        if self._corners is None:
            self._corners = np.array(self._low), np.array(self._high)
        low, high = self._corners
        apart = np.minimum(np.maximum(centre, low), high) - centre
        return bool((np.linalg.norm(apart, axis=1) > radius_m).all())


def mid_air_spot(
    rng: np.random.Generator,
    floor: FloorGrid,
    boxes: Boxes,
    radius_m: float,
    around: tuple[F64, float] | None = None,
    height_m: tuple[float, float] = (0.1, 2.5),
) -> F64 | None:
    """A free place (3,) for a ball inside the room, or None after 12 tries.

    Args:
        rng: source of randomness.
        floor: what is room and what is not.
        boxes: what is taken.
        radius_m: radius of the ball.
        around: centre (2,) and reach in metres, or None for the whole room.
        height_m: lowest and highest centre.
    """
    low = floor.low
    high = low + np.array(floor.taken.shape) * 0.05
    for _ in range(12):
        if around is None:
            xy = rng.uniform(low, high)
        else:
            angle, reach = rng.uniform(0.0, 2.0 * np.pi), around[1] * np.sqrt(rng.random())
            xy = around[0] + reach * np.array([np.cos(angle), np.sin(angle)])
        spot = np.array([*xy, rng.uniform(*height_m)])
        if np.isinf(floor.top_at(spot[:2])) or not boxes.free(spot, radius_m):
            continue
        boxes.add_ball(spot, radius_m)
        return spot
    return None
