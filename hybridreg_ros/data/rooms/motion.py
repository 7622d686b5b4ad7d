# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What happens in a room: a key figure, company, things flying around it, shifted furniture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.se3 import transform
from hybridreg_ros.data.bodies import movers
from hybridreg_ros.data.bodies.movers import RigidMover
from hybridreg_ros.data.bodies.track import KeyFrames
from hybridreg_ros.data.meshes.geometry import rot_z
from hybridreg_ros.data.meshes.scene import Scene
from hybridreg_ros.data.rooms.clutter import mid_air_spot
from hybridreg_ros.data.rooms.furnished import Background, background

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.meshes.scene import Mover
    from hybridreg_ros.data.rooms.furnished import Movable, Room

    F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Stage:
    """A room in which things move.

    Attributes:
        room: where it happens.
        background: what never moves.
        scene: background and movers; mover 0 is the key figure when there is one.
        key: (3,) place of the key figure's middle at time 0; the room's middle without one.
    """

    room: Room
    background: Background
    scene: Scene
    key: F64


@dataclass(frozen=True, eq=False)
class Path:
    """Smooth motion about a place: offsets and turns through random key values.

    Attributes:
        at: (3,) place, metres.
        yaw_rad: turn at rest.
        keys: (K, 4) offset x, y, z in metres and turn in radians.
    """

    at: F64
    yaw_rad: float
    keys: KeyFrames

    def __call__(self, time_s: float) -> F64:
        """T_world_object (4, 4) at a time."""
        x, y, z, turn = self.keys.at(time_s)
        return transform(rot_z(self.yaw_rad + turn), self.at + np.array([x, y, z]))


def set_stage(
    rng: np.random.Generator,
    room: Room,
    *,
    people: int,
    animals: int = 0,
    flying: int = 0,
    shifted: int = 0,
    reach_m: float = 3.0,
) -> Stage:
    """Let things happen in a room.

    Args:
        rng: source of everything random.
        room: a furnished room; its `boxes` are filled further.
        people: number of people, the first is the key figure.
        animals: number of animals.
        flying: number of rigid things that move around the key figure.
        shifted: number of pieces of furniture or clutter that are shifted slightly.
        reach_m: how far from the key figure the others and the flying things are.
    """
    spots = _spots(rng, room, people + animals, reach_m)
    movers: list[Mover] = []
    for k, spot in enumerate(spots):
        movers.append(_figure(rng, spot, animal=k >= people))
        room.boxes.add_ball(np.array([*spot, 0.9]), 0.6)
    centre = spots[0] if spots else _middle(room)
    nearest = sorted(room.movable, key=lambda m: float(np.linalg.norm(m.at[:2] - centre)))
    chosen = nearest[: 2 * shifted]
    chosen = [chosen[k] for k in rng.permutation(len(chosen))[:shifted]]
    movers += [_shift(rng, m) for m in chosen]
    movers += _flying(rng, room, centre, flying, reach_m)
    ground = background(room.parts, [m for m in room.movable if m not in chosen])
    key = np.array([*centre, rng.uniform(0.7, 1.3)])
    return Stage(room, ground, Scene(ground.mesh, tuple(movers)), key)


def _middle(room: Room) -> F64:
    spots = room.floor.clear_spots(0.2)
    middle: F64 = spots.mean(0) if len(spots) else room.plan.outline.mean(0)
    return middle


def _spots(rng: np.random.Generator, room: Room, count: int, reach_m: float) -> list[F64]:
    """Free places (2,) near each other, at least 0.5 m apart."""
    free = room.floor.clear_spots(0.3)
    if len(free) == 0:
        free = room.floor.clear_spots(0.15)
    chosen: list[F64] = []
    for _ in range(count):
        if len(free) == 0:
            break
        chosen.append(free[rng.integers(len(free))])
        away = np.linalg.norm(free - chosen[-1], axis=1)
        near = np.linalg.norm(free - chosen[0], axis=1) < reach_m
        free = free[(away > rng.uniform(0.7, 1.1)) & near]
    return chosen


def _figure(rng: np.random.Generator, spot: F64, *, animal: bool) -> Mover:
    """A person or an animal at a place."""
    start, heading = np.array([*spot, 0.0]), float(rng.uniform(0.0, 2.0 * np.pi))
    reach = float(rng.uniform(0.4, 1.0))
    if animal and hasattr(movers, 'make_animal'):
        return movers.make_animal(rng, start, heading, reach_m=reach)
    return movers.make_human(rng, start, heading, reach_m=reach)


def _keys(rng: np.random.Generator, low: F64, high: F64, step_s: float) -> KeyFrames:
    """Key values (8, 4) of alternating random sign, so that neighbours always differ."""
    size = rng.uniform(low, high, (8, 4))
    sign = np.where(np.arange(8)[:, None] % 2 == 0, 1.0, -1.0) * rng.choice([-1.0, 1.0], 4)
    return KeyFrames(size * sign, step_s, float(rng.uniform(0.0, step_s)))


def _shift(rng: np.random.Generator, thing: Movable) -> movers.RigidMover:
    """Furniture or clutter that is shifted slightly now and then."""
    low, high = np.array([0.02, 0.02, 0.0, 0.02]), np.array([0.1, 0.1, 0.0, 0.2])
    keys = _keys(rng, low, high, float(rng.uniform(1.0, 2.5)))
    return movers.RigidMover(thing.mesh, Path(thing.at, thing.yaw_rad, keys), 'shifted')


def _flying(
    rng: np.random.Generator, room: Room, centre: F64, count: int, reach_m: float
) -> list[Mover]:
    """Rigid things within some metres of a centre, 0.1 to 2.5 m high, each on its own path."""
    movers: list[Mover] = []
    top = min(2.5, room.plan.height_m - 0.2)
    for _ in range(count):
        size = float(np.exp(rng.uniform(np.log(0.15), np.log(1.0))))
        spot = mid_air_spot(
            rng, room.floor, room.boxes, 0.5 * size + 0.1, (centre, reach_m), (0.1, top)
        )
        if spot is None:
            continue
        swing = rng.uniform(0.05, 0.35)
        low, high = swing * np.array([0.4, 0.4, 0.0, 0.3]), swing * np.array([1.0, 1.0, 0.15, 3.0])
        keys = _keys(rng, low, high, float(rng.uniform(0.5, 2.0)))
        mesh = room.pool.take(rng, size)
        path = Path(spot - [0.0, 0.0, 0.5 * size], 0.0, keys)
        movers.append(RigidMover(mesh, path, 'flying'))
    return movers
