# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Floor plans: outlines of rooms, and a grid of what is still free on the floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]
    Corner = NDArray[np.floating]

_CELL_M = 0.05


@dataclass(frozen=True, eq=False)
class Plan:
    """Shape of a room before anything stands in it.

    Attributes:
        kind: room, corridor, office or hall.
        outline: (K, 2) corners, counter-clockwise, metres.
        height_m: floor to ceiling.
    """

    kind: str
    outline: F64
    height_m: float


def random_plan(rng: np.random.Generator, kind: str | None = None) -> Plan:
    """Random outline: a rectangle with notches, chamfers and skewed walls, about the origin."""
    kind = kind or str(
        rng.choice(['room', 'corridor', 'office', 'hall'], p=[0.6, 0.1, 0.18, 0.12])
    )
    low, high, height = {
        'room': ((2.6, 3.0), (5.5, 7.5), (2.2, 3.2)),
        'corridor': ((1.7, 6.0), (3.0, 14.0), (2.2, 3.2)),
        'office': ((6.0, 6.0), (12.0, 14.0), (2.5, 3.6)),
        'hall': ((9.0, 8.0), (18.0, 16.0), (3.5, 7.0)),
    }[kind]
    w, d = rng.uniform(low, high)
    corners = np.array([[-w, -d], [w, -d], [w, d], [-w, d]]) * 0.5
    outline: list[NDArray[np.float64]] = []
    for k, corner in enumerate(corners):
        inward = -np.sign(corner)
        cut = inward * rng.uniform([0.4, 0.4], [0.45 * w, 0.45 * d])
        along_x, along_y = corner + cut * [1.0, 0.0], corner + cut * [0.0, 1.0]
        first, last = (along_y, along_x) if k % 2 == 0 else (along_x, along_y)
        pick = rng.random()
        if pick < 0.55:
            outline.append(corner)
        elif pick < 0.85:
            outline += [first, corner + cut, last]
        else:
            small = 0.5 * rng.uniform(0.3, 1.0)
            outline += [corner + small * (first - corner), corner + small * (last - corner)]
    points = np.array(outline)
    if rng.random() < 0.2:
        points = points + rng.normal(0.0, 0.12, points.shape)
    return Plan(kind, points, float(rng.uniform(*height)))


def inside(outline: F64, points: NDArray[np.floating]) -> NDArray[np.bool_]:
    """True for points (N, 2) inside an outline (K, 2) (even-odd rule)."""
    result = np.zeros(len(points), np.bool_)
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        cross = (a[1] > points[:, 1]) != (b[1] > points[:, 1])
        slope = (b[0] - a[0]) / (b[1] - a[1]) if b[1] != a[1] else 0.0
        result ^= cross & (points[:, 0] < a[0] + slope * (points[:, 1] - a[1]))
    return result


class FloorGrid:
    """Which 5 cm cells of the floor are taken.

    Attributes:
        low: (2,) corner of the grid, metres.
        taken: (nx, ny) bool; cells outside the outline are taken.
        top: (nx, ny) float32 height of what stands there, metres; outside it is infinite.
    """

    def __init__(self, outline: F64) -> None:
        self.low = outline.min(0) - 0.2
        n = np.ceil((outline.max(0) + 0.2 - self.low) / _CELL_M).astype(int)
        ij = np.stack(np.meshgrid(*(np.arange(k) for k in n), indexing='ij'), -1)
        centres = self.low + (ij + 0.5) * _CELL_M
        room = inside(outline, centres.reshape(-1, 2)).reshape(tuple(n))
        self.taken = ~room
        self.top = np.where(room, 0.0, np.inf).astype(np.float32)

    def _cells(self, points: F64) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        ij = np.floor((points - self.low) / _CELL_M).astype(np.int64)
        ij = np.clip(ij, 0, np.array(self.taken.shape) - 1)
        return ij[:, 0], ij[:, 1]

    def _footprint(
        self, low: Corner, high: Corner, at: F64, yaw_rad: float, margin_m: float, step_m: float
    ) -> F64:
        """Sample points (N, 2) of a turned rectangle with corners low, high in its own frame."""
        size = np.maximum(high - low + 2.0 * margin_m, step_m)
        n = np.ceil(size / step_m).astype(int) + 1
        axes = [low[k] - margin_m + np.linspace(0.0, size[k], n[k]) for k in (0, 1)]
        x, y = np.meshgrid(*axes, indexing='ij')
        c, s = np.cos(yaw_rad), np.sin(yaw_rad)
        return np.stack([c * x - s * y + at[0], s * x + c * y + at[1]], -1).reshape(-1, 2)

    def fits(
        self, low: Corner, high: Corner, at: F64, yaw_rad: float = 0.0, margin_m: float = 0.02
    ) -> bool:
        """True when a turned rectangle (corners (2,), (2,) in its own frame) is free."""
        cells = self._cells(self._footprint(low, high, at, yaw_rad, margin_m, 0.08))
        return not self.taken[cells].any()

    def take(self, low: Corner, high: Corner, at: F64, yaw_rad: float, top_m: float) -> None:
        """Mark a turned rectangle as taken up to a height."""
        cells = self._cells(self._footprint(low, high, at, yaw_rad, 0.0, 0.04))
        self.taken[cells] = True
        self.top[cells] = np.maximum(self.top[cells], np.float32(top_m))

    def clear_spots(self, radius_m: float, below_m: float = 0.0) -> F64:
        """Centres (N, 2) of cells with nothing higher than `below_m` within a square radius."""
        high = np.pad(self.top > below_m, 1, constant_values=True)
        r = max(1, round(radius_m / _CELL_M))
        total = np.pad(high, ((r, r), (r, r)), constant_values=True).cumsum(0).cumsum(1)
        total = np.pad(total, ((1, 0), (1, 0)))
        k = 2 * r + 1
        count = total[k:, k:] - total[:-k, k:] - total[k:, :-k] + total[:-k, :-k]
        i, j = np.nonzero(count[1:-1, 1:-1] == 0)
        centres: F64 = self.low + (np.stack([i, j], 1) + 0.5) * _CELL_M
        return centres

    def top_at(self, point: F64) -> float:
        """Height of what stands at a point (2,), metres; infinite outside the room."""
        ij = np.floor((point - self.low) / _CELL_M).astype(np.int64)
        if (ij < 0).any() or (ij >= self.top.shape).any():
            return float('inf')
        return float(self.top[ij[0], ij[1]])
