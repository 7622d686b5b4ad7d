# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What moves in a street: vehicles, cyclists, people, animals, kept around the sensor's way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.bodies.animals import make_animal
from hybridreg_ros.data.bodies.cloth import make_cloth
from hybridreg_ros.data.bodies.humans import human_rig, make_human
from hybridreg_ros.data.streets import vehicles, vehicles_drive

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.bodies.rig import Rig
    from hybridreg_ros.data.meshes.scene import Mover
    from hybridreg_ros.data.streets.layout import Layout
    from hybridreg_ros.data.streets.nature import Terrain

    F64 = NDArray[np.float64]

_STAYING = ('gesture', 'turn', 'reach', 'crouch', 'dance', 'bend')


@dataclass(frozen=True, eq=False)
class Accompanying:
    """A way beside the centre line that stays around the sensor for ever.

    Whoever leaves the window of 2 `reach_m` about the sensor comes in again at its other end.

    Attributes:
        terrain: the ground with the centre line.
        offset_m: distance to the left of the centre line; it weaves a little.
        ahead_m: place relative to the sensor at time 0, along the centre line.
        speed_mps: speed on the ground, negative against the centre line.
        ego_start_m: place of the sensor on the centre line at time 0.
        ego_speed_mps: speed of the sensor.
        reach_m: half length of the window.
        weave: amplitude (m), wavelength (m) and phase of the weaving.
    """

    terrain: Terrain
    offset_m: float
    ahead_m: float
    speed_mps: float
    ego_start_m: float
    ego_speed_mps: float
    reach_m: float
    weave: tuple[float, float, float] = (0.0, 10.0, 0.0)

    def at(self, distance_m: float) -> tuple[F64, float]:
        """Place (2,), metres, and heading, radians, after a distance travelled."""
        time_s = distance_m / max(abs(self.speed_mps), 1e-6)
        run = self.ahead_m + (self.speed_mps - self.ego_speed_mps) * time_s + self.reach_m
        lap = run % (2.0 * self.reach_m) - self.reach_m
        s = self.ego_start_m + self.ego_speed_mps * time_s + lap
        place, heading = self.terrain.centre.at(s)
        size, wave, phase = self.weave
        d = self.offset_m + size * np.sin(s / wave + phase)
        left = np.array([-np.sin(heading), np.cos(heading)])
        turn = np.arctan(size / wave * np.cos(s / wave + phase))
        back = 0.0 if self.speed_mps >= 0.0 else np.pi
        return place + d * left, heading + float(turn) + back


@dataclass(frozen=True)
class Ride:
    """How the sensor travels: place on the centre line at time 0, speed, offset to the left."""

    start_m: float
    speed_mps: float
    offset_m: float


@dataclass(frozen=True)
class Crowd:
    """How much moves.

    Attributes:
        people: walking.
        staying: people who stay in one place but move.
        vehicles: driving.
        cyclists: riding.
        animals: walking.
        near_m: half length of the window in which people are.
    """

    people: int
    staying: int
    vehicles: int
    cyclists: int
    animals: int
    near_m: float


def random_crowd(rng: np.random.Generator, low: float, high: float) -> Crowd:
    """A crowd that may give a share of moving points between two bounds."""
    if high <= 0.0:
        return Crowd(0, 0, 0, 0, 0, 20.0)
    if low < 0.25:
        near = float(rng.uniform(7.0, 18.0))
        return Crowd(
            int(rng.integers(8, 24)),
            int(rng.integers(1, 6)),
            int(rng.integers(2, 8)),
            int(rng.integers(0, 5)),
            int(rng.integers(0, 3)),
            near,
        )
    near = float(rng.uniform(4.5, 9.0))
    return Crowd(
        int(rng.integers(24, 52)),
        int(rng.integers(4, 12)),
        int(rng.integers(5, 12)),
        int(rng.integers(1, 6)),
        int(rng.integers(0, 5)),
        near,
    )


def populate(
    rng: np.random.Generator, layout: Layout, ride: Ride, crowd: Crowd, *, spread_m: float = 0.0
) -> list[Mover]:
    """Movers of a crowd around the sensor's way.

    Args:
        rng: source of everything random.
        layout: where things may move.
        ride: the sensor's way, which is kept free.
        crowd: how many of each.
        spread_m: length of the centre line over which those who stay are spread; 0 = the window
            around the place at time 0.
    """
    rigs = [human_rig(rng, coarse=True) for _ in range(min(crowd.people + crowd.staying, 8))]
    movers = [_walker(rng, layout, ride, crowd.near_m, rigs) for _ in range(crowd.people)]
    for _ in range(crowd.staying):
        s, d = _free_spot(rng, layout, ride, crowd.near_m, spread_m)
        place, heading = layout.terrain.at(s, d)
        movers.append(
            make_human(
                rng,
                place,
                heading + rng.uniform(0.0, 6.3),
                activity=str(rng.choice(_STAYING)),
                ground=layout.terrain.height,
                rig=rigs[rng.integers(len(rigs))],
            )
        )
    movers += _traffic(rng, layout, ride, crowd)
    for _ in range(crowd.animals):
        way = _way(rng, layout, ride, crowd.near_m, rng.uniform(0.6, 2.0))
        movers.append(animal_along(rng, layout, way))
    if rng.random() < 0.3 and crowd.people:
        s, d = _free_spot(rng, layout, ride, crowd.near_m, spread_m)
        place, heading = layout.terrain.at(s, d)
        movers.append(
            make_cloth(rng, place + np.array([0.0, 0.0, 2.4]), heading + rng.uniform(0, 3))
        )
    return movers


def clear_offset(
    rng: np.random.Generator, bands: tuple[tuple[float, float], ...], ego: float, gap: float
) -> float:
    """A random offset in one of some bands, at least `gap` away from the sensor's way."""
    offset = 0.0
    for _ in range(20):
        low, high = bands[rng.integers(len(bands))]
        offset = float(rng.uniform(low, high))
        if abs(offset - ego) > gap:
            return offset
    return ego + gap if offset >= ego else ego - gap


def _free_spot(
    rng: np.random.Generator, layout: Layout, ride: Ride, near_m: float, spread_m: float
) -> tuple[float, float]:
    reach = (0.0, spread_m) if spread_m else (-near_m, near_m)
    s = ride.start_m + rng.uniform(*reach)
    return float(np.clip(s, 0.0, layout.terrain.centre.length_m)), clear_offset(
        rng, layout.stands, ride.offset_m, 1.1
    )


def _way(
    rng: np.random.Generator, layout: Layout, ride: Ride, near_m: float, speed: float
) -> Accompanying:
    offset = clear_offset(rng, layout.walks, ride.offset_m, 0.95)
    sign = 1.0 if rng.random() < 0.5 else -1.0
    weave = (float(rng.uniform(0.0, 0.12)), float(rng.uniform(2.0, 8.0)), float(rng.uniform(0, 6)))
    return Accompanying(
        layout.terrain,
        offset,
        float(rng.uniform(-near_m, near_m)),
        sign * speed,
        ride.start_m,
        ride.speed_mps,
        near_m,
        weave,
    )


def _walker(
    rng: np.random.Generator, layout: Layout, ride: Ride, near_m: float, rigs: list[Rig]
) -> Mover:
    speed = float(rng.uniform(0.7, 1.8)) if rng.random() < 0.9 else float(rng.uniform(2.4, 3.8))
    way = _way(rng, layout, ride, near_m, speed)
    place, heading = way.at(0.0)
    start = np.array([*place, layout.terrain.height(*place)])
    return make_human(
        rng,
        start,
        heading,
        activity='walk' if speed < 2.0 else 'run',
        track=way,
        speed_mps=speed,
        ground=layout.terrain.height,
        rig=rigs[rng.integers(len(rigs))],
    )


def animal_along(rng: np.random.Generator, layout: Layout, way: Accompanying) -> Mover:
    """An animal that walks or trots along a way over the terrain."""
    place, heading = way.at(0.0)
    start = np.array([*place, layout.terrain.height(*place)])
    return make_animal(
        rng,
        start,
        heading,
        activity=str(rng.choice(['walk', 'trot'])),
        track=way,
        ground=layout.terrain.height,
    )


def _traffic(rng: np.random.Generator, layout: Layout, ride: Ride, crowd: Crowd) -> list[Mover]:
    """Vehicles in lanes that the sensor does not use, or before and behind it; cyclists; carts."""
    movers: list[Mover] = []
    height = layout.terrain.height
    used: list[tuple[float, float]] = []
    for _ in range(crowd.vehicles):
        kind = (
            'forklift'
            if layout.indoor
            else str(rng.choice(['car', 'van', 'lorry', 'bus'], p=[0.55, 0.2, 0.15, 0.1]))
        )
        lane = float(rng.choice(layout.lanes)) if layout.lanes else 0.0
        if not layout.lanes:
            break
        same = abs(lane - ride.offset_m) < 2.4
        ahead = float(rng.uniform(-30.0, 30.0))
        if same:
            ahead = float(rng.choice([-1.0, 1.0]) * rng.uniform(8.0, 30.0))
        if any(lane == other and abs(ahead - place) < 9.0 for other, place in used):
            continue
        used.append((lane, ahead))
        mesh = vehicles.make_vehicle(rng, kind)
        speed = ride.speed_mps if same else float(rng.uniform(2.0, 12.0))
        if layout.indoor:
            speed = ride.speed_mps if same else float(rng.uniform(0.8, 2.5))
        towards = -speed if lane > 0.3 and not same else speed
        way = Accompanying(
            layout.terrain, lane, ahead, towards, ride.start_m, ride.speed_mps, 45.0
        )
        movers.append(vehicles_drive.drive(mesh, way, abs(towards), height, kind))
    for _ in range(crowd.cyclists):
        speed = float(rng.uniform(2.0, 6.0))
        way = _way(rng, layout, ride, max(crowd.near_m, 12.0), speed)
        rider = human_rig(rng, load=False, coarse=True)
        movers += vehicles_drive.make_cyclist(rng, way, height, speed_mps=speed, rig=rider)
    for _ in range(int(rng.integers(0, 3)) if crowd.people else 0):
        speed = float(rng.uniform(0.5, 1.5))
        way = _way(rng, layout, ride, crowd.near_m, speed)
        movers.append(vehicles_drive.drive(vehicles.cart(rng), way, speed, height, 'cart'))
    return movers
