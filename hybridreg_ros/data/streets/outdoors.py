# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Procedural streets, car parks, parks, warehouses and squares, with a way through them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.core.se3 import so3_exp, transform
from hybridreg_ros.data.meshes.scene import Scene
from hybridreg_ros.data.streets.layout import LAYOUTS
from hybridreg_ros.data.streets.road import road
from hybridreg_ros.data.streets.traffic import Ride, populate, random_crowd

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.streets.layout import Layout
    from hybridreg_ros.data.streets.nature import Terrain

    F64 = NDArray[np.float64]

KINDS = tuple(LAYOUTS)
_ALL = {**LAYOUTS, 'road': road}
_KIND_SHARE = (0.4, 0.18, 0.18, 0.1, 0.14)
_CROWDED_SHARE = (0.22, 0.2, 0.24, 0.12, 0.22)


@dataclass(frozen=True, eq=False)
class StreetPath:
    """The way of a sensor on a vehicle, a robot or a person along a centre line.

    Attributes:
        terrain: the ground with the centre line.
        ride: start, speed and offset.
        height_m: of the sensor above the ground.
        shake: (6, 3) amplitude (m, rad), rate (rad/s) and phase of the small motions about each
            axis: x, y, z, roll, pitch, yaw.
    """

    terrain: Terrain
    ride: Ride
    height_m: float
    shake: F64

    def pose_at(self, time_s: float) -> F64:
        """T_world_sensor (4, 4) at a time, seconds: x ahead, z up."""
        return self.pose_from(self.ride.start_m + self.ride.speed_mps * time_s, time_s)

    def pose_from(
        self, s_m: float, time_s: float = 0.0, *, offset_m: float = 0.0, turn_rad: float = 0.0
    ) -> F64:
        """T_world_sensor (4, 4) at a place of the centre line.

        Args:
            s_m: distance along the centre line.
            time_s: for the small motions.
            offset_m: further offset to the left.
            turn_rad: further turn about z.
        """
        d = self.ride.offset_m + offset_m
        place, heading = self.terrain.at(s_m, d)
        ahead, _ = self.terrain.at(s_m + 1.2, d)
        behind, _ = self.terrain.at(s_m - 1.2, d)
        rise = float(np.arctan2(ahead[2] - behind[2], 2.4))
        ground = 0.25 * (ahead[2] + behind[2]) + 0.5 * place[2]
        move = self.shake[:, 0] * np.sin(self.shake[:, 1] * time_s + self.shake[:, 2])
        R = so3_exp(np.array([0.0, 0.0, heading + turn_rad + move[5]]))
        R = R @ so3_exp(np.array([move[3], move[4] - rise * np.cos(turn_rad), 0.0]))
        return transform(R, np.array([place[0], place[1], ground + self.height_m]) + move[:3])


@dataclass(frozen=True, eq=False)
class StreetWorld:
    """A street with everything in it.

    Attributes:
        scene: static mesh and movers.
        path: the sensor's way; the world is populated around it at any time.
        kind: one of `KINDS`.
        loss: (F,) share of lost rays of each static triangle (glass).
        plane: (F,) number of the large flat part of each static triangle; 0 = none, 1 = ground.
        layout: terrain, and where things may move.
    """

    scene: Scene
    path: StreetPath
    kind: str
    loss: NDArray[np.float32]
    plane: NDArray[np.int32]
    layout: Layout


def make_street(
    rng: np.random.Generator,
    kind: str | None = None,
    moving_share_target: tuple[float, float] = (0.1, 0.3),
    *,
    travel_m: float = 40.0,
    margin_m: float = 45.0,
) -> StreetWorld:
    """Build a random outdoor scene (or a warehouse) and a way through it.

    Args:
        rng: source of everything random.
        kind: one of `KINDS`, or `road`, or None for a random one of `KINDS`.
        moving_share_target: lowest and highest share of moving points that a scan should have;
            the number of movers follows it, the share itself must be measured. (0, 0) = none.
        travel_m: distance that the sensor will travel from time 0.
        margin_m: length of the street before and behind that way.

    Raises:
        ConfigError: the kind is unknown, or the share or the distance is out of range.
    """
    low, high = moving_share_target
    kind = kind or str(rng.choice(KINDS, p=_KIND_SHARE if low < 0.25 else _CROWDED_SHARE))
    if kind not in _ALL:
        raise ConfigError(f'kind: expected one of {", ".join(_ALL)}, found {kind!r}')
    if not 0.0 <= low <= high <= 1.0:
        raise ConfigError(
            f'moving_share_target: expected 0 <= low <= high <= 1, found {moving_share_target}'
        )
    if not 0.0 <= travel_m <= 5000.0:
        raise ConfigError(f'travel_m: expected 0 to 5000, found {travel_m}')
    layout = _ALL[kind](rng, travel_m + 2.0 * margin_m)
    offset = float(rng.uniform(*layout.ego))
    fast = kind == 'road' or (kind == 'street' and abs(offset) < 4.0)
    if low >= 0.25 and (fast or rng.random() < 0.5):
        # So many moving points need people close by: a fair, a demonstration, a school run.
        near = ((offset + 1.0, offset + 4.0), (offset - 4.0, offset - 1.0))
        keep = tuple(v for v in layout.lanes if abs(v - offset) > 5.0)
        layout = replace(layout, walks=near, stands=near, lanes=keep)
        fast = False
    speed = float(rng.uniform(3.0, 12.0)) if fast else float(rng.uniform(0.5, 2.2))
    ride = Ride(margin_m, speed, offset)
    spread = travel_m if travel_m > 60.0 else 0.0
    movers = populate(rng, layout, ride, random_crowd(rng, low, high), spread_m=spread)
    static, loss, plane = layout.static.result()
    path = StreetPath(layout.terrain, ride, _height(rng, fast=fast), _shake(rng, fast=fast))
    return StreetWorld(Scene(static, tuple(movers)), path, kind, loss, plane, layout)


def _height(rng: np.random.Generator, *, fast: bool) -> float:
    """Sensor height: on a roof, or on a robot, a hand, a backpack."""
    return float(rng.uniform(1.5, 2.3)) if fast else float(rng.uniform(0.4, 1.9))


def _shake(rng: np.random.Generator, *, fast: bool) -> F64:
    """Small motions (6, 3) of the body that carries the sensor."""
    size = (
        np.array([0.01, 0.01, 0.015, 0.008, 0.008, 0.004])
        if fast
        else np.array([0.02, 0.025, 0.02, 0.02, 0.02, 0.03])
    )
    rate = rng.uniform(1.5, 9.0, 6)
    return np.stack([size * rng.uniform(0.3, 1.2, 6), rate, rng.uniform(0.0, 6.3, 6)], axis=1)
