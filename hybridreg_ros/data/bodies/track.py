# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tracks on the ground plane that bodies and vehicles follow, and smooth key-frame curves."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]


class Way(Protocol):
    """Anything that can be followed: a place and a heading for every distance travelled."""

    def at(self, distance_m: float) -> tuple[F64, float]:
        """Place (2,), metres, and heading, radians, after a distance travelled."""


@dataclass(frozen=True, eq=False)
class Track:
    """A polyline on the ground, addressed by the distance travelled along it.

    Attributes:
        points: (K, 2) float64, world frame, metres, K >= 2; a closed track repeats no point.
        closed: True when the track returns to its first point for ever; an open one goes
            straight on beyond its ends.
    """

    points: F64
    closed: bool = False
    distance: F64 = field(init=False)
    heading: F64 = field(init=False)

    def __post_init__(self) -> None:
        """Precompute arc length (K,) or (K + 1,) metres, and unwrapped headings, radians."""
        points = np.asarray(self.points, dtype=np.float64)
        if self.closed:
            points = np.concatenate([points, points[:1]])
        step = np.diff(points, axis=0)
        length = np.maximum(np.linalg.norm(step, axis=1), 1e-9)
        segment = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
        heading = np.concatenate([segment[:1], 0.5 * (segment[1:] + segment[:-1]), segment[-1:]])
        object.__setattr__(self, 'points', points)
        object.__setattr__(self, 'distance', np.concatenate([[0.0], np.cumsum(length)]))
        object.__setattr__(self, 'heading', heading)

    @property
    def length_m(self) -> float:
        """Length of the track (one lap of a closed one), metres."""
        return float(self.distance[-1])

    def at(self, distance_m: float) -> tuple[F64, float]:
        """Place (2,), metres, and heading, radians, after a distance travelled."""
        s = distance_m % self.length_m if self.closed else distance_m
        inside = min(max(s, 0.0), self.length_m)
        heading = float(np.interp(inside, self.distance, self.heading))
        place = np.array([np.interp(inside, self.distance, self.points[:, k]) for k in (0, 1)])
        if s != inside:
            place = place + (s - inside) * np.array([np.cos(heading), np.sin(heading)])
        return place, heading


def straight_track(start: F64, heading_rad: float, length_m: float = 10.0) -> Track:
    """Straight line from start (at least (2,)) that goes on for ever."""
    ahead = length_m * np.array([np.cos(heading_rad), np.sin(heading_rad)])
    return Track(np.stack([start[:2], start[:2] + ahead]))


def loop_track(
    rng: np.random.Generator, start: F64, heading_rad: float, reach_m: float = 1.5
) -> Track:
    """Irregular closed curve through `start`, first heading as asked, never repeating a shape.

    Args:
        rng: source of the shape.
        start: (2,) or (3,), metres.
        heading_rad: heading at the start.
        reach_m: half of the largest extent of the curve, metres.
    """
    phi = np.linspace(0.0, 2.0 * np.pi, 96, endpoint=False)
    radius = np.ones_like(phi)
    for k in (2, 3):
        radius += rng.uniform(0.0, 0.35 / k) * np.cos(k * phi + rng.uniform(0.0, 2.0 * np.pi))
    squash = rng.uniform(0.35, 1.0)
    curve = np.stack([radius * np.cos(phi), squash * radius * np.sin(phi)], axis=1)
    curve *= reach_m / np.abs(curve).max()
    curve = np.roll(curve, rng.integers(len(curve)), axis=0)
    if rng.random() < 0.5:
        curve[:, 1] *= -1.0
    ahead = curve[1] - curve[-1]
    turn = heading_rad - np.arctan2(ahead[1], ahead[0])
    c, s = np.cos(turn), np.sin(turn)
    curve = (curve - curve[0]) @ np.array([[c, s], [-s, c]]) + np.asarray(start)[:2]
    return Track(curve, closed=True)


def wander_track(
    rng: np.random.Generator, start: F64, heading_rad: float, length_m: float = 30.0
) -> Track:
    """Open, gently winding line whose heading changes by a slow random process."""
    count = max(int(length_m / 0.5), 4)
    knots = rng.normal(0.0, 0.35, count // 6 + 3)
    bend = np.interp(np.arange(count), np.linspace(0, count, len(knots)), knots)
    bend -= bend[0]
    heading = heading_rad + bend
    steps = 0.5 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    points = np.asarray(start)[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return Track(points)


@dataclass(frozen=True, eq=False)
class KeyFrames:
    """A periodic curve through key values, at rest for a moment at each key.

    Attributes:
        values: (K, ...) float64, K >= 1.
        step_s: seconds from one key to the next.
        phase_s: the first key's time, seconds.
    """

    values: F64
    step_s: float
    phase_s: float = 0.0

    def at(self, time_s: float) -> F64:
        """Value (...) at a time, eased between the two keys around it."""
        u = (time_s - self.phase_s) / self.step_s
        k = int(np.floor(u))
        x = u - k
        x = x * x * (3.0 - 2.0 * x)
        count = len(self.values)
        value: F64 = (1.0 - x) * self.values[k % count] + x * self.values[(k + 1) % count]
        return value
