# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Ten places that hold a pose badly: nothing along a direction, a repeating pattern, a lie."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.benchmark.analytic_world import (
    Ball,
    Box,
    HalfSpace,
    cast,
    depth_rays,
    lidar_rays,
    pose,
)
from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import Scan

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hybridreg_ros.benchmark.analytic_world import Thing
    from hybridreg_ros.odometry.result import OdometryResult

    F64 = NDArray[np.float64]

WRONG_M, WRONG_DEG = 0.2, 2.0
"""A pose farther off than this is wrong."""
GATE = 0.7
"""Confidence from which a pose is believed."""
PERIOD_S = 0.1
_FAR = 500.0
_RANGE_M = {'depth': 8.0, 'lidar': 80.0}


@dataclass(frozen=True)
class Place:
    """One place and the way of a sensor through it.

    Attributes:
        name: of the place.
        way: pose (4, 4) of the sensor after some seconds.
        world: what is there, by seconds.
        rays: (R, 3) unit directions, sensor frame.
        kind: depth or lidar.
        scans: how many are taken.
    """

    name: str
    way: Callable[[float], F64]
    world: Callable[[float], tuple[Thing, ...]]
    rays: F64
    kind: str = 'lidar'
    scans: int = 40

    def clouds(self) -> list[tuple[Scan, F64]]:
        """Its scans, each with the true pose (4, 4) relative to the first one."""
        start = se3.inverse(self.way(0.0))
        made = []
        for k in range(self.scans):
            t = k * PERIOD_S
            T, noise_m = self.way(t), 0.003 if self.kind == 'depth' else 0.01
            points, _ = cast(self.world(t), T, self.rays, t, seed=k, noise_m=noise_m)
            near = points[np.linalg.norm(points, axis=1) < _RANGE_M[self.kind]]
            made.append((Scan(near, stamp=100.0 + t, frame_id='sensor'), start @ T))
        return made


@dataclass
class Score:
    """How the poses at a place were, and what was said of them.

    Attributes:
        errors: position error of each scan but the first, metres.
        sigmas: error of each in standard deviations along the worst of six axes.
        wrong: whether each is off by more than WRONG_M or WRONG_DEG.
        confidences: reported of each.
    """

    errors: list[float] = field(default_factory=list)
    sigmas: list[float] = field(default_factory=list)
    wrong: list[bool] = field(default_factory=list)
    confidences: list[float] = field(default_factory=list)

    def add(self, result: OdometryResult, truth: F64) -> None:
        """Score one scan by its true pose (4, 4)."""
        off = se3.inverse(truth) @ result.pose
        error = np.concatenate(
            [result.pose[:3, 3] - truth[:3, 3], truth[:3, :3] @ se3.so3_log(off[:3, :3])]
        )
        self.errors.append(float(np.linalg.norm(error[:3])))
        self.sigmas.append(float((np.abs(error) / np.sqrt(np.diag(result.covariance))).max()))
        turn_deg = se3.rotation_angle_deg(off[:3, :3])
        self.wrong.append(self.errors[-1] > WRONG_M or turn_deg > WRONG_DEG)
        self.confidences.append(result.confidence)

    @property
    def wrong_above_gate(self) -> int:
        """Number of wrong poses that are to be believed."""
        return int(np.sum(np.array(self.wrong) & (np.array(self.confidences) >= GATE)))

    @property
    def within_3_sigma(self) -> float:
        """Share of the poses whose error is within three standard deviations along every axis."""
        return float(np.mean(np.array(self.sigmas) <= 3.0))


def _ahead(speed: float, z: float = 1.2) -> Callable[[float], F64]:
    """Way along x with a speed (m/s) that varies by a tenth, and a sensor that sways."""

    def way(t: float) -> F64:
        x = speed * (t - 0.1 * (np.cos(t) - 1.0))
        return pose(x, 0.02 * np.sin(2.0 * t), np.sin(1.5 * t), z)

    return way


def _up_stairs(t: float) -> F64:
    x = 0.5 * t
    return pose(x, 0.01 * np.sin(2.0 * t), np.sin(t), 1.2 + x * 0.17 / 0.28)


def _up_ramp(t: float) -> F64:
    x, slope = 1.5 * t, np.rad2deg(np.arctan(0.15))
    on_it = np.clip((x - 2.5) / 1.0, 0.0, 1.0)
    return pose(x, 0.0, 0.5 * np.sin(t), 1.2 + 0.15 * max(0.0, x - 3.0), on_it * slope)


def _always(*things: Thing) -> Callable[[float], tuple[Thing, ...]]:
    return lambda _: things


def _lift(t: float) -> tuple[Thing, ...]:
    """A cabin whose door closes, and opens again on another floor: its walls hold the pose."""
    shut = float(np.clip((t - 0.6) / 0.6, 0.0, 1.0) - np.clip((t - 2.6) / 0.6, 0.0, 1.0))
    door = Box((0.9, -0.8 + 1.6 * (1.0 - shut), 0.0), (0.95, 0.8 + 1.6 * (1.0 - shut), 2.3))
    cabin = (
        Box((-0.8, -0.9, -0.1), (0.8, -0.8, 2.4)),
        Box((-0.8, 0.8, -0.1), (0.8, 0.9, 2.4)),
        Box((-0.9, -0.9, -0.1), (-0.8, 0.9, 2.4)),
        Box((-0.9, -0.9, -0.1), (0.9, 0.9, 0.0)),
        Box((-0.9, -0.9, 2.3), (0.9, 0.9, 2.4)),
    )
    ground = Box((0.9, -5.0, 0.0), (9.0, 5.0, 3.0), inside=True)
    upper = Box((0.9, -2.0, 0.0), (5.0, 9.0, 2.6), inside=True)
    hall = (ground, Box((5.0, 1.0, 0.0), (6.0, 2.0, 2.0)))
    floor = hall if t < 1.5 else (upper, Box((3.0, -1.5, 0.0), (3.5, -0.5, 1.0)))
    outside = tuple(_behind_door(thing) for thing in floor)
    return (*cabin, door, *outside)


def _behind_door(thing: Thing) -> Thing:
    """A hall reaches into the cabin, so that its near wall does not stand in the door."""
    if isinstance(thing, Box) and thing.inside:
        return Box((-2.0, *thing.low[1:]), thing.high, inside=True)
    return thing


def _fence() -> tuple[Thing, ...]:
    posts = (Box((0.5 * k, 2.0, 0.0), (0.5 * k + 0.12, 2.05, 1.8)) for k in range(-16, 36))
    return (HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), *posts)


def _stairs() -> tuple[Thing, ...]:
    steps = (
        Box((0.28 * k, -0.8, 0.17 * k - 9.0), (0.28 * (k + 1), 0.8, 0.17 * k))
        for k in range(-25, 45)
    )
    walls = Box((-_FAR, -0.8, -_FAR), (_FAR, 0.8, _FAR), inside=True)
    return (walls, *steps)


def all_places() -> tuple[Place, ...]:
    """The ten places."""
    rings = lidar_rays(360, 16, -15.0, 15.0)
    ground = HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    tunnel = Box((-_FAR, -2.0, 0.0), (_FAR, 2.0, 3.0), inside=True)
    rails = (
        ground,
        Box((-_FAR, -0.79, -1.0), (_FAR, -0.72, 0.17)),
        Box((-_FAR, 0.72, -1.0), (_FAR, 0.79, 0.17)),
        Box((-_FAR, 4.0, -1.0), (_FAR, 4.2, 2.5)),
    )
    corridor = Box((-_FAR, -1.0, 0.0), (_FAR, 1.0, 2.5), inside=True)
    wall = Box((-_FAR, 1.5, -_FAR), (_FAR, 2.0, _FAR))
    hall = Ball((0.0, 0.0, 1.2), 8.0, inside=True)
    slope = np.array([-0.15, 0.0, 1.0]) / np.hypot(0.15, 1.0)
    ramp = (
        ground,
        HalfSpace((3.0, 0.0, 0.0), (float(slope[0]), 0.0, float(slope[2]))),
        Box((-_FAR, -_FAR, -_FAR), (_FAR, -3.0, _FAR)),
        Box((-_FAR, 3.0, -_FAR), (_FAR, _FAR, _FAR)),
    )
    sideways = pose(0.0, 0.0, 90.0, 0.0)
    drive = _ahead(2.0)
    return (
        Place('tunnel', drive, _always(tunnel), rings),
        Place('rails', drive, _always(*rails), rings),
        Place('corridor', _ahead(0.8), _always(corridor), depth_rays(), 'depth'),
        Place('field', drive, _always(ground), rings),
        Place('wall', lambda t: _ahead(0.5)(t) @ sideways, _always(wall), depth_rays(), 'depth'),
        Place('hall', lambda t: pose(0.2 * t, 0.0, 20.0 * t), _always(hall), rings),
        Place('fence', drive, _always(*_fence()), rings),
        Place('stairs', _up_stairs, _always(*_stairs()), depth_rays(), 'depth'),
        Place('ramp', _up_ramp, _always(*ramp), lidar_rays(720, 8, -15.0, 15.0)),
        Place('lift', lambda t: pose(0.0, 0.0, 8.0 * t), _lift, lidar_rays(360, 24), 'lidar'),
    )
