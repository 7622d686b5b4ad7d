# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Vehicles on the ground: driven along a way, parked, and cyclists on their cycles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.se3 import transform
from hybridreg_ros.data.bodies.humans import human_rig
from hybridreg_ros.data.bodies.humans_motion import BONES
from hybridreg_ros.data.bodies.rig import Pose, RigidMover, SkinnedMover
from hybridreg_ros.data.meshes.geometry import cross, moved, rot_x
from hybridreg_ros.data.meshes.scene import merge
from hybridreg_ros.data.meshes.shapes import box, torus, tube

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hybridreg_ros.data.bodies.rig import Rig
    from hybridreg_ros.data.bodies.track import Way
    from hybridreg_ros.data.meshes.scene import Mesh

    F64 = NDArray[np.float64]
    Ground = Callable[[float, float], float]


def drive(
    mesh: Mesh, track: Way, speed_mps: float, ground: Ground, kind: str, *, offset_m: float = 0.0
) -> RigidMover:
    """A vehicle driven along a track, tilted as the ground below its axles.

    Args:
        mesh: as `make_vehicle` gives it.
        track: its path, metres.
        speed_mps: its speed.
        ground: height at (x, y), metres.
        kind: what it is.
        offset_m: distance along the track at time 0.
    """
    reach = 0.3 * float(np.ptp(mesh.vertices[:, 0]))

    def pose_at(time_s: float) -> F64:
        s = offset_m + speed_mps * time_s
        place, heading = track.at(s)
        return ground_pose(place, heading, ground, reach)

    return RigidMover(mesh, pose_at, kind)


def ground_pose(place: F64, heading_rad: float, ground: Ground, reach_m: float) -> F64:
    """T_world_vehicle (4, 4) of something that stands on four points of the ground."""
    ahead = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    left = np.array([-ahead[1], ahead[0]])
    front, back = (ground(*(place + k * reach_m * ahead)) for k in (1.0, -1.0))
    west, east = (ground(*(place + k * 0.75 * left)) for k in (1.0, -1.0))
    x = np.array([*(2.0 * reach_m * ahead), front - back])
    y = np.array([*(1.5 * left), west - east])
    x /= np.linalg.norm(x)
    z = cross(x, y)
    z /= np.linalg.norm(z)
    height = 0.25 * (front + back + west + east)
    R = np.stack([x, cross(z, x), z], axis=1)
    return transform(R, np.array([place[0], place[1], height]))


def make_cycle(rng: np.random.Generator) -> Mesh:
    """Frame, wheels and handlebar of a bicycle, or of something like a moped."""
    r = rng.uniform(0.28, 0.36)
    wheel = moved(torus(r, 0.025, 18, 6), (0.0, 0.0, 0.0), rot_x(np.pi / 2.0))
    base = rng.uniform(0.95, 1.1)
    back, front = np.array([-0.45 * base, 0.0, r]), np.array([0.55 * base, 0.0, r])
    seat, bar = np.array([-0.22, 0.0, 0.88]), np.array([0.42, 0.0, 0.98])
    pedal = np.array([-0.03, 0.0, 0.3])
    pairs = [(back, seat), (back, pedal), (pedal, seat), (pedal, bar), (seat, bar), (front, bar)]
    thick = rng.uniform(0.018, 0.03)
    parts = [tube(np.stack(p), thick, 6) for p in pairs]
    parts += [moved(wheel, back), moved(wheel, front)]
    parts.append(box((0.25, 0.14, 0.06), seat + np.array([0.0, 0.0, 0.04])))
    parts.append(box((0.05, 0.58, 0.04), bar))
    if rng.random() < 0.25:
        parts.append(box((0.7, 0.3, 0.45), (0.0, 0.0, 0.5)))
    if rng.random() < 0.25:
        parts.append(box((0.4, 0.4, 0.3), (-0.55, 0.0, 0.95)))
    return merge(parts)


@dataclass(frozen=True, eq=False)
class _Pedalling:
    """Pose of a rider as a function of the time.

    Attributes:
        ride: motion of the cycle.
        track: its path.
        offset_m: distance along the track at time 0.
        speed_mps: its speed.
        lean_rad: forward lean of the back.
        sole_m: height of the lower pedal above the ground.
        phase: of the pedals, radians.
    """

    ride: RigidMover
    track: Way
    offset_m: float
    speed_mps: float
    lean_rad: float
    sole_m: float
    phase: float

    def __call__(self, time_s: float) -> Pose:
        T = self.ride.pose_at(time_s)
        _, heading = self.track.at(self.offset_m + self.speed_mps * time_s)
        turn = self.phase + self.speed_mps * time_s / 0.9
        angles = np.zeros((BONES, 3))
        for thigh, p in ((11, turn), (14, turn + np.pi)):
            angles[thigh, 1] = -0.85 - 0.42 * np.sin(p)
            angles[thigh + 1, 1] = 0.95 + 0.5 * np.sin(p + 0.5)
        angles[1, 1], angles[2, 1] = 0.6 * self.lean_rad, 0.4 * self.lean_rad
        angles[[5, 8], 1] = -0.95
        angles[[6, 9], 1] = -0.35
        angles[4, 1] = -0.5 * self.lean_rad
        back = T[:3, :3] @ np.array([-0.25, 0.0, self.sole_m])
        return Pose(angles, T[:3, 3] + back, heading)


def make_cyclist(
    rng: np.random.Generator,
    track: Way,
    ground: Ground,
    *,
    offset_m: float = 0.0,
    speed_mps: float | None = None,
    rig: Rig | None = None,
) -> tuple[RigidMover, SkinnedMover]:
    """A cycle and its rider, two movers on one track; arguments as for `drive`."""
    speed = float(rng.uniform(2.0, 7.0)) if speed_mps is None else speed_mps
    cycle = make_cycle(rng)
    ride = drive(cycle, track, speed, ground, 'cycle', offset_m=offset_m)
    person = rig or human_rig(rng, load=False)
    hip = float(person.joints[0, 2])
    sole = max(0.93 - 0.62 * hip, 0.1)
    motion = _Pedalling(
        ride,
        track,
        offset_m,
        speed,
        float(rng.uniform(0.2, 0.8)),
        sole,
        float(rng.uniform(0.0, 6.3)),
    )
    return replace(ride, kind='cycle'), SkinnedMover(person, motion, speed, 'cyclist')


def parked(
    rng: np.random.Generator, mesh: Mesh, place: F64, heading_rad: float, ground: Ground
) -> Mesh:
    """World-frame mesh of a vehicle that stands at a place (2,), not quite straight."""
    T = ground_pose(place, heading_rad + rng.normal(0.0, 0.04), ground, 1.2)
    return moved(mesh, T[:3, 3], T[:3, :3])
