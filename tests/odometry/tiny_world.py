# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A small world of boxes and balls, and two sensors that cast rays into it (numpy only)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import Scan

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Box:
    """Axis-aligned box; `inside` means that it is seen from within (a room)."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    inside: bool = False


@dataclass(frozen=True)
class Ball:
    """A ball that moves evenly: centre at time 0 and velocity."""

    centre: tuple[float, float, float]
    radius: float
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)


ROOM = (
    Box((-5.0, -4.0, 0.0), (5.0, 4.0, 3.0), inside=True),
    Box((2.0, 1.0, 0.0), (3.0, 2.2, 1.4)),
    Box((-3.5, -3.0, 0.0), (-2.0, -2.2, 2.2)),
    Box((-1.0, 2.8, 0.0), (0.5, 4.0, 1.0)),
    Box((3.2, -3.0, 0.0), (4.0, -1.5, 2.0)),
    Ball((-3.0, 2.0, 1.0), 0.7),
    Ball((1.0, -2.5, 1.2), 0.5),
)


def lidar_rays(columns: int = 240, rows: int = 24) -> F64:
    """Unit directions (R, 3) of a spinning lidar, z up."""
    azimuth = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    elevation = np.deg2rad(np.linspace(-35.0, 30.0, rows))
    a, e = np.meshgrid(azimuth, elevation)
    flat = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
    return flat.reshape(-1, 3)


def depth_rays(width: int = 120, height: int = 90) -> F64:
    """Unit directions (R, 3) of a depth camera that looks along x, z up."""
    u, v = np.meshgrid(np.linspace(-0.6, 0.6, width), np.linspace(-0.45, 0.45, height))
    rays = np.stack([np.ones_like(u), -u, -v], axis=-1).reshape(-1, 3)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _box_range(box: Box, origin: F64, rays: F64) -> F64:
    with np.errstate(divide='ignore', invalid='ignore'):
        to_low = (np.array(box.low) - origin) / rays
        to_high = (np.array(box.high) - origin) / rays
    enter = np.minimum(to_low, to_high).max(axis=1)
    leave = np.maximum(to_low, to_high).min(axis=1)
    hit = leave if box.inside else enter
    return np.where((leave >= enter) & (hit > 1e-6), hit, np.inf)


def _ball_range(ball: Ball, origin: F64, rays: F64, time_s: float) -> F64:
    centre = np.array(ball.centre) + time_s * np.array(ball.velocity) - origin
    along = rays @ centre
    inside = along**2 - centre @ centre + ball.radius**2
    hit = along - np.sqrt(np.maximum(inside, 0.0))
    return np.where((inside > 0.0) & (hit > 1e-6), hit, np.inf)


def cast(
    world: tuple[Box | Ball, ...],
    T_world_sensor: F64,
    rays: F64,
    time_s: float = 0.0,
    seed: int = 0,
    noise_m: float = 0.005,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Points (N, 3) in the sensor frame, and which belong to a ball that moves."""
    directions = rays @ T_world_sensor[:3, :3].T
    origin = T_world_sensor[:3, 3]
    ranges = np.stack(
        [
            _box_range(thing, origin, directions)
            if isinstance(thing, Box)
            else _ball_range(thing, origin, directions, time_s)
            for thing in world
        ]
    )
    nearest = ranges.argmin(axis=0)
    distance = ranges.min(axis=0)
    distance = distance + np.random.default_rng(seed).normal(0.0, noise_m, len(rays))
    moves = np.array([isinstance(t, Ball) and any(t.velocity) for t in world])
    hit = np.isfinite(distance)
    return (rays * distance[:, None])[hit].astype(np.float32), moves[nearest][hit]


def pose(x: float, y: float, yaw_deg: float, z: float = 1.2) -> F64:
    """Sensor pose in the world."""
    return se3.transform(
        se3.so3_exp(np.array([0.0, 0.0, np.deg2rad(yaw_deg)])), np.array([x, y, z])
    )


def walk(count: int, step_m: float = 0.08, turn_deg: float = 2.0) -> list[F64]:
    """Poses of a walk along a gentle curve that starts at (-1, -0.5)."""
    poses = [pose(-1.0, -0.5, 0.0)]
    forward = se3.transform(
        se3.so3_exp(np.array([0.0, 0.0, np.deg2rad(turn_deg)])), np.array([step_m, 0.0, 0.0])
    )
    while len(poses) < count:
        poses.append(poses[-1] @ forward)
    return poses


def scans(
    poses: list[F64],
    rays: F64,
    world: tuple[Box | Ball, ...] = ROOM,
    start_s: float = 100.0,
    period_s: float = 0.1,
) -> list[Scan]:
    """One scan per pose, at an even rate."""
    return [
        Scan(
            cast(world, T, rays, k * period_s, seed=k)[0],
            stamp=start_s + k * period_s,
            frame_id='sensor',
        )
        for k, T in enumerate(poses)
    ]
