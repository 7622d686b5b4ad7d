# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Who is about in a street as recordings show it: few, some metres away, alone or in groups."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.bodies.humans import human_rig, make_human
from hybridreg_ros.data.bodies.track import straight_track
from hybridreg_ros.data.streets import vehicles, vehicles_drive
from hybridreg_ros.data.streets.traffic import Accompanying, Ride, animal_along, clear_offset

if TYPE_CHECKING:
    from hybridreg_ros.data.bodies.rig import Rig
    from hybridreg_ros.data.meshes.scene import Mover
    from hybridreg_ros.data.streets.layout import Layout

    Unit = tuple[Mover, ...]

_REACH_M = 55.0
_GAP_M = 12.0
_PAUSING = ('gesture', 'turn', 'reach', 'bend', 'crouch')


def passers(rng: np.random.Generator, layout: Layout, ride: Ride) -> list[Unit]:
    """People, cycles, vehicles and animals around the sensor at time 0 and some seconds after.

    Args:
        rng: source of everything random.
        layout: where things may move.
        ride: the sensor's way.

    Returns:
        Movers in units that belong together, such as a cycle and its rider.
    """
    rigs = [human_rig(rng, coarse=True) for _ in range(int(rng.integers(2, 6)))]
    units: list[Unit] = []
    for _ in range(int(rng.integers(1, 6))):
        pauses = rng.random() < 0.25
        units += (_pausing if pauses else _walking)(rng, layout, ride, rigs)
    for _ in range(int(rng.choice([0, 1, 2, 3], p=[0.5, 0.25, 0.15, 0.1]))):
        units.append((_crossing(rng, layout, ride, rigs),))
    for _ in range(int(rng.choice([0, 1, 2], p=[0.45, 0.35, 0.2]))):
        units.append(_cyclist(rng, layout, ride))
    if rng.random() < 0.25:
        units.append(_pushing(rng, layout, ride, rigs))
    if rng.random() < 0.25:
        way = _way(rng, layout, ride, float(rng.uniform(0.6, 2.5)))
        units.append((animal_along(rng, layout, way),))
    return units + _vehicles(rng, layout, ride)


def _ahead(rng: np.random.Generator, low_m: float = 3.0, high_m: float = 35.0) -> float:
    """A place before (two of three) or behind the sensor, evenly over the logarithm, metres."""
    away = float(np.exp(rng.uniform(np.log(low_m), np.log(high_m))))
    return away if rng.random() < 2 / 3 else -away


def _way(
    rng: np.random.Generator,
    layout: Layout,
    ride: Ride,
    speed_mps: float,
    ahead_m: float | None = None,
) -> Accompanying:
    offset = clear_offset(rng, layout.walks, ride.offset_m, 1.0)
    weave = (float(rng.uniform(0.0, 0.15)), float(rng.uniform(2.0, 8.0)), float(rng.uniform(0, 6)))
    sign = 1.0 if rng.random() < 0.5 else -1.0
    ahead = _ahead(rng) if ahead_m is None else ahead_m
    return Accompanying(
        layout.terrain,
        offset,
        ahead,
        sign * speed_mps,
        ride.start_m,
        ride.speed_mps,
        _REACH_M,
        weave,
    )


def _walker(rng: np.random.Generator, layout: Layout, way: Accompanying, rigs: list[Rig]) -> Mover:
    place, heading = way.at(0.0)
    start = np.array([*place, layout.terrain.height(*place)])
    speed = abs(way.speed_mps)
    return make_human(
        rng,
        start,
        heading,
        activity='walk' if speed < 2.2 else 'run',
        track=way,
        speed_mps=speed,
        ground=layout.terrain.height,
        rig=rigs[rng.integers(len(rigs))],
    )


def _walking(rng: np.random.Generator, layout: Layout, ride: Ride, rigs: list[Rig]) -> list[Unit]:
    """Somebody alone, or two to five who walk together."""
    count = int(rng.choice([1, 2, 3, 4, 5], p=[0.5, 0.25, 0.12, 0.08, 0.05]))
    runs = count == 1 and rng.random() < 0.1
    lead = _way(rng, layout, ride, float(rng.uniform(2.4, 3.8) if runs else rng.uniform(0.6, 1.7)))
    units: list[Unit] = []
    for k in range(count):
        beside, behind = 0.6 * (k % 2) + rng.normal(0.0, 0.1), 0.9 * (k // 2)
        way = Accompanying(
            lead.terrain,
            lead.offset_m + beside,
            lead.ahead_m - behind,
            lead.speed_mps,
            ride.start_m,
            ride.speed_mps,
            _REACH_M,
            lead.weave,
        )
        units.append((_walker(rng, layout, way, rigs),))
    return units


def _pausing(rng: np.random.Generator, layout: Layout, ride: Ride, rigs: list[Rig]) -> list[Unit]:
    """One to three who stay in a place, and move as people do who talk or wait."""
    s = ride.start_m + _ahead(rng)
    d = clear_offset(rng, layout.stands, ride.offset_m, 1.3)
    units: list[Unit] = []
    for k in range(int(rng.integers(1, 4))):
        place, heading = layout.terrain.at(s + 0.8 * k, d + float(rng.normal(0.0, 0.2)))
        units.append(
            (
                make_human(
                    rng,
                    place,
                    heading + rng.uniform(0.0, 6.3),
                    activity=str(rng.choice(_PAUSING)),
                    ground=layout.terrain.height,
                    rig=rigs[rng.integers(len(rigs))],
                ),
            )
        )
    return units


def _crossing(rng: np.random.Generator, layout: Layout, ride: Ride, rigs: list[Rig]) -> Mover:
    """Somebody who crosses the sensor's way, before or behind it."""
    sign = 1.0 if rng.random() < 0.5 else -1.0
    speed, when_s = float(rng.uniform(0.7, 1.8)), float(rng.uniform(0.0, 4.0))
    s = ride.start_m + ride.speed_mps * when_s + _ahead(rng, 4.0, 28.0)
    at = ride.offset_m + float(rng.uniform(-3.0, 3.0)) - sign * speed * when_s
    place, heading = layout.terrain.at(s, at)
    track = straight_track(place, heading + sign * 0.5 * np.pi + float(rng.normal(0.0, 0.3)))
    return make_human(
        rng,
        place,
        0.0,
        activity='walk',
        track=track,
        speed_mps=speed,
        ground=layout.terrain.height,
        rig=rigs[rng.integers(len(rigs))],
    )


def _cyclist(rng: np.random.Generator, layout: Layout, ride: Ride) -> Unit:
    """A cycle with its rider; some keep the sensor's speed before it."""
    speed = float(rng.uniform(2.0, 7.0))
    rider = human_rig(rng, load=False, coarse=True)
    if 2.0 < ride.speed_mps < 8.0 and rng.random() < 0.5:
        way = Accompanying(
            layout.terrain,
            ride.offset_m + float(rng.uniform(-1.0, 0.8)),
            float(rng.uniform(7.0, 25.0)),
            ride.speed_mps,
            ride.start_m,
            ride.speed_mps,
            _REACH_M,
        )
        speed = ride.speed_mps
    else:
        way = _way(rng, layout, ride, speed)
    return vehicles_drive.make_cyclist(rng, way, layout.terrain.height, speed_mps=speed, rig=rider)


def _pushing(rng: np.random.Generator, layout: Layout, ride: Ride, rigs: list[Rig]) -> Unit:
    """A trolley and who pushes it."""
    speed = float(rng.uniform(0.5, 1.4))
    way = _way(rng, layout, ride, speed)
    behind = 1.0 if way.speed_mps > 0.0 else -1.0
    after = Accompanying(
        way.terrain,
        way.offset_m,
        way.ahead_m - behind,
        way.speed_mps,
        ride.start_m,
        ride.speed_mps,
        _REACH_M,
        way.weave,
    )
    thing = vehicles_drive.drive(vehicles.cart(rng), way, speed, layout.terrain.height, 'cart')
    return thing, _walker(rng, layout, after, rigs)


def _vehicles(rng: np.random.Generator, layout: Layout, ride: Ride) -> list[Unit]:
    """Before and behind the sensor at its own speed, others that pass it."""
    units: list[Unit] = []
    used: list[tuple[float, float]] = []
    for _ in range(int(rng.integers(0, 4 + len(layout.lanes))) if layout.lanes else 0):
        lane = float(rng.choice(layout.lanes))
        same = abs(lane - ride.offset_m) < 2.4
        ahead = _ahead(rng, 9.0, 40.0) if same else float(rng.uniform(-35.0, 45.0))
        if any(lane == other and abs(ahead - place) < _GAP_M for other, place in used):
            continue
        used.append((lane, ahead))
        kind = (
            'forklift'
            if layout.indoor
            else str(rng.choice(['car', 'van', 'lorry', 'bus'], p=[0.66, 0.2, 0.09, 0.05]))
        )
        top = 2.5 if layout.indoor else max(15.0, 1.25 * ride.speed_mps)
        speed = float(rng.uniform(0.15, 1.0)) * top
        if same:
            speed = ride.speed_mps * float(rng.uniform(0.9, 1.1))
        elif lane > 0.3 and rng.random() < 0.85:
            speed = -speed
        way = Accompanying(
            layout.terrain, lane, ahead, speed, ride.start_m, ride.speed_mps, _REACH_M
        )
        mesh = vehicles.make_vehicle(rng, kind)
        units.append((vehicles_drive.drive(mesh, way, abs(speed), layout.terrain.height, kind),))
    return units
