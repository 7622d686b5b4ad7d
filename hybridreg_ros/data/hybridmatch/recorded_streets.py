# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Street pairs as recorded: whole lidar scans with all of the ground, in which little moves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.se3 import so3_exp, transform
from hybridreg_ros.data.hybridmatch.recorded import (
    GAP_S,
    PAIRS_A_SCENE,
    REACH_M,
    Bodies,
    Kind,
    Shot,
    recorded_samples,
    shot_times,
    unit_shares,
    who_moves,
    with_standing,
)
from hybridreg_ros.data.meshes.geometry import voxel_thin
from hybridreg_ros.data.meshes.raycast import Caster
from hybridreg_ros.data.sensors.lidar import SpinningLidar, random_lidar
from hybridreg_ros.data.sensors.lidar_pattern import PatternLidar, raster, rosette
from hybridreg_ros.data.sequences.frame import LIDAR_FRAME, SimulatedFrame
from hybridreg_ros.data.streets.outdoors import StreetPath, StreetWorld, make_street
from hybridreg_ros.data.streets.passers import passers

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from hybridreg_ros.data.hybridmatch.recorded import Unit
    from hybridreg_ros.data.hybridmatch.take import Sample
    from hybridreg_ros.data.streets.traffic import Ride

    F64 = NDArray[np.float64]

KIND = Kind('street-recorded', 0.3, 0.3, 0.04)
_MOST_MOVING = 0.018
_THIN_M = 0.06
_RAYS = (40_000, 131_072)
_REACH_FACTOR = (0.8, 2.2)
_DESKEW_ERROR = 0.03
_CLEAR_M, _CLEAR_AT = 1.2, 7
_TOP_SPEED_MPS = 28.0
_TILTED_SHARE, _TILT_DEG = 0.2, 25.0
_PLACES = {
    'street': 0.4,
    'road': 0.25,
    'car_park': 0.1,
    'park': 0.1,
    'square': 0.1,
    'warehouse': 0.05,
}
_AHEAD = {'rosette': rosette, 'raster': raster}
_MODELS = {
    'double64': 0.3,
    'even32': 0.13,
    'even16': 0.15,
    'wide64': 0.08,
    'narrow64': 0.08,
    'wide128': 0.05,
    'dome64': 0.03,
    'dense32': 0.03,
    'dense128': 0.04,
    'rosette': 0.07,
    'raster': 0.04,
}


@dataclass(frozen=True, eq=False)
class _Rig:
    """A lidar on its way.

    Attributes:
        lidar: the device.
        path: the way of what carries it.
        mount: (3, 3) rotation of the sensor on it.
    """

    lidar: SpinningLidar
    path: StreetPath
    mount: F64

    def pose_at(self, time_s: float) -> F64:
        """T_world_sensor (4, 4) at a time."""
        return self.path.pose_at(time_s) @ transform(self.mount, np.zeros(3))

    def places(self, times: F64) -> F64:
        """Sensor positions (N, 3) at times."""
        return np.stack([self.path.pose_at(t)[:3, 3] for t in times.tolist()])


def recorded_street(seed: int, count: int = PAIRS_A_SCENE) -> list[Sample]:
    """Pairs of a few scans of one random street, at most `count`.

    Args:
        seed: of everything.
        count: most pairs.
    """
    rng, world, rig, units = _scene(seed)
    longest = min(GAP_S[1], REACH_M / max(rig.path.ride.speed_mps, 0.1))
    times = shot_times(rng, longest)
    caster = _peopled(rng, Caster(world.scene), rig, units, times)
    shots = [_shot(rng, caster, rig, t, world.loss) for t in times.tolist()]
    return recorded_samples(rng, KIND, seed, shots, caster.scene.movers, count)


def recorded_frames(seed: int, times: F64, *, motorway: bool = False) -> Iterator[SimulatedFrame]:
    """Scans of one random street in a row: few movers, some metres away.

    Every other seed undoes the motion during each scan and leaves its times out, as recordings
    that were prepared for a benchmark do.

    Args:
        seed: of everything.
        times: (N,) stamps, seconds from the start.
        motorway: a road on which the sensor travels fast.
    """
    rng, world, rig, units = _scene(seed, float(times[-1]), motorway=motorway)
    caster = _peopled(rng, Caster(world.scene), rig, units, times)
    for time_s in times.tolist():
        lidar = rig.lidar
        if isinstance(lidar, PatternLidar):
            lidar = replace(lidar, phase_s=time_s)
        scan = lidar.scan(caster, time_s, rig.pose_at, rng, loss=world.loss)
        prepared = seed % 2 == 1
        yield SimulatedFrame(
            (scan.deskewed() if prepared else scan.points).reshape(-1, 3),
            scan.label.shape,
            None if prepared else np.tile(scan.times, len(scan.label)),
            time_s,
            rig.pose_at(time_s),
            scan.label.reshape(-1),
            scan.instance.reshape(-1),
            LIDAR_FRAME,
        )


def _scene(
    seed: int, longest_s: float = 0.0, *, motorway: bool = False
) -> tuple[np.random.Generator, StreetWorld, _Rig, list[Unit]]:
    """A street, a lidar on its way for so long, and who could be about."""
    rng = np.random.default_rng([seed, 5])
    kind = 'road' if motorway else str(rng.choice(list(_PLACES), p=list(_PLACES.values())))
    travel_m = max(REACH_M + 5.0, _TOP_SPEED_MPS * longest_s)
    world = make_street(
        rng, kind, (0.0, 0.0), travel_m=travel_m, margin_m=float(rng.uniform(45.0, 80.0))
    )
    path = replace(world.path, ride=_ride(rng, world, motorway=motorway))
    rig = _Rig(_lidar(rng), path, _mount(rng))
    return rng, world, rig, passers(rng, world.layout, path.ride)


def _ride(rng: np.random.Generator, world: StreetWorld, *, motorway: bool) -> Ride:
    """The ride of a street at speeds as recorded: standing, walking, driving, on a fast road."""
    ride = world.path.ride
    if motorway:
        return replace(ride, speed_mps=float(rng.uniform(14.0, _TOP_SPEED_MPS)))
    if rng.random() < 0.15:
        return replace(ride, speed_mps=0.0)
    if world.kind != 'road' and (world.kind != 'street' or abs(ride.offset_m) >= 4.0):
        return ride
    fast = rng.random() < (0.6 if world.kind == 'road' else 0.1)
    return replace(ride, speed_mps=float(rng.uniform(*((14.0, 28.0) if fast else (2.0, 14.0)))))


def _lidar(rng: np.random.Generator) -> SpinningLidar:
    """A random usual device with 24,000 to 131,000 rays."""
    model = str(rng.choice(list(_MODELS), p=list(_MODELS.values())))
    if model in _AHEAD:
        return _AHEAD[model](rng)
    lidar = random_lidar(rng, model=model)
    lidar = replace(lidar, reach_m=lidar.reach_m * float(rng.uniform(*_REACH_FACTOR)))
    rays = np.exp(rng.uniform(*np.log(_RAYS)))
    return replace(lidar, columns=min(lidar.columns, int(rays / len(lidar.elevation_deg))))


def _mount(rng: np.random.Generator) -> F64:
    """Rotation (3, 3) of the sensor: level, or tilted about any level axis."""
    angle = np.deg2rad(rng.uniform(0.0, _TILT_DEG)) * (rng.random() < _TILTED_SHARE)
    along = rng.uniform(-np.pi, np.pi)
    return so3_exp(angle * np.array([np.cos(along), np.sin(along), 0.0]))


def _peopled(
    rng: np.random.Generator, caster: Caster, rig: _Rig, units: list[Unit], times: F64
) -> Caster:
    """The street with its movers, of which about half stand; none meets the sensor."""
    every = np.linspace(times[0], times[-1], _CLEAR_AT)
    places = rig.places(every)
    stand_s = rng.uniform(times[0], times[-1], len(units))
    may = np.ones((len(units), 2), np.bool_)
    for k, unit in enumerate(units):
        bodies = Bodies(unit)
        for n in range(len(unit)):
            may[k, 0] &= bodies.away_m(n, float(stand_s[k]), places) > _CLEAR_M
            for time_s, place in zip(every.tolist(), places, strict=True):
                may[k, 1] &= bodies.away_m(n, time_s, place[None]) > _CLEAR_M
    everyone = caster.peopled(tuple(mover for unit in units for mover in unit))
    share = np.zeros(len(units))
    for time_s in (float(times[0]), float(times[-1])) if units else ():
        coarse = replace(rig.lidar, columns=max(rig.lidar.columns // 8, 64))
        scan = coarse.scan(everyone, time_s, rig.pose_at, np.random.default_rng(0))
        seen = int(np.isfinite(scan.true[..., 0]).sum())
        share = np.maximum(share, unit_shares(units, scan.instance, seen))
    kept, moves = who_moves(rng, units, share, may, _MOST_MOVING)
    return caster.peopled(with_standing(units, kept, moves, stand_s))


def _shot(
    rng: np.random.Generator, caster: Caster, rig: _Rig, time_s: float, loss: NDArray[np.float32]
) -> Shot:
    """One scan on the move, deskewed with a slightly wrong velocity."""
    lidar = rig.lidar
    if isinstance(lidar, PatternLidar):
        lidar = replace(lidar, phase_s=time_s + float(rng.uniform(0.0, 100.0)))
    scan = lidar.scan(caster, time_s, rig.pose_at, rng, loss=loss)
    wrong = np.float32(1.0 + rng.normal(0.0, _DESKEW_ERROR))
    raw, best = scan.points.reshape(-1, 3), scan.deskewed().reshape(-1, 3)
    rows = np.flatnonzero(np.isfinite(raw[:, 0]))
    skew = best[rows] - raw[rows]
    points = raw[rows] + wrong * skew
    thin = voxel_thin(points, _THIN_M)
    rows, points, skew = rows[thin], points[thin], skew[thin]
    sigma = np.hypot(
        lidar.sigma_m(np.linalg.norm(points, axis=1)),
        _DESKEW_ERROR * np.linalg.norm(skew, axis=1),
    )
    return Shot(
        points,
        scan.true.reshape(-1, 3)[rows],
        scan.instance.reshape(-1)[rows],
        sigma.astype(np.float32),
        rig.pose_at(time_s),
        time_s,
    )
