# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Small worlds of boxes, balls and half-spaces into which rays are cast exactly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Box:
    """Axis-aligned box; `inside` means that it is seen from within (a room)."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    inside: bool = False

    def ranges(self, origin: F64, rays: F64, time_s: float) -> F64:
        """Range (R,) at which each unit ray (R, 3) meets it, metres; inf = never."""
        with np.errstate(divide='ignore', invalid='ignore'):
            to_low = (np.array(self.low) - origin) / rays
            to_high = (np.array(self.high) - origin) / rays
        enter = np.minimum(to_low, to_high).max(axis=1)
        leave = np.maximum(to_low, to_high).min(axis=1)
        hit = leave if self.inside else enter
        return np.where((leave >= enter) & (hit > 1e-6), hit, np.inf)


@dataclass(frozen=True)
class Ball:
    """A ball that moves evenly: centre at time 0 and velocity; as `Box` otherwise."""

    centre: tuple[float, float, float]
    radius: float
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inside: bool = False

    def ranges(self, origin: F64, rays: F64, time_s: float) -> F64:
        """As `Box.ranges`."""
        centre = np.array(self.centre) + time_s * np.array(self.velocity) - origin
        along = rays @ centre
        under = along**2 - centre @ centre + self.radius**2
        half = np.sqrt(np.maximum(under, 0.0))
        hit = along + half if self.inside else along - half
        return np.where((under > 0.0) & (hit > 1e-6), hit, np.inf)


@dataclass(frozen=True)
class HalfSpace:
    """Solid ground below a plane through a point, with an upward normal."""

    point: tuple[float, float, float]
    normal: tuple[float, float, float]

    def ranges(self, origin: F64, rays: F64, time_s: float) -> F64:
        """As `Box.ranges`."""
        height = (origin - np.array(self.point)) @ np.array(self.normal)
        with np.errstate(divide='ignore', invalid='ignore'):
            hit = -height / (rays @ np.array(self.normal))
        return np.where(hit > 1e-6, hit, np.inf)


Thing = Box | Ball | HalfSpace


def lidar_rays(columns: int = 240, rows: int = 24, low: float = -35.0, high: float = 30.0) -> F64:
    """Unit directions (R, 3) of a spinning lidar, z up; lowest and highest ring in degrees."""
    azimuth = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    a, e = np.meshgrid(azimuth, np.deg2rad(np.linspace(low, high, rows)))
    flat = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
    return flat.reshape(-1, 3)


def depth_rays(width: int = 120, height: int = 90) -> F64:
    """Unit directions (R, 3) of a depth camera that looks along x, z up."""
    u, v = np.meshgrid(np.linspace(-0.6, 0.6, width), np.linspace(-0.45, 0.45, height))
    rays = np.stack([np.ones_like(u), -u, -v], axis=-1).reshape(-1, 3)
    unit: F64 = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return unit


def cast(
    world: tuple[Thing, ...],
    T_world_sensor: F64,
    rays: F64,
    time_s: float = 0.0,
    seed: int = 0,
    noise_m: float = 0.005,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Points (N, 3) in the sensor frame, and which belong to a ball that moves."""
    directions = rays @ T_world_sensor[:3, :3].T
    origin = T_world_sensor[:3, 3]
    ranges = np.stack([thing.ranges(origin, directions, time_s) for thing in world])
    nearest = ranges.argmin(axis=0)
    distance = ranges.min(axis=0)
    distance = distance + np.random.default_rng(seed).normal(0.0, noise_m, len(rays))
    moves = np.array([isinstance(t, Ball) and any(t.velocity) for t in world])
    hit = np.isfinite(distance)
    return (rays[hit] * distance[hit, None]).astype(np.float32), moves[nearest][hit]


def pose(x: float, y: float, yaw_deg: float, z: float = 1.2, pitch_deg: float = 0.0) -> F64:
    """Sensor pose (4, 4) in the world; pitch is positive upwards."""
    yaw = se3.so3_exp(np.array([0.0, 0.0, np.deg2rad(yaw_deg)]))
    pitch = se3.so3_exp(np.array([0.0, -np.deg2rad(pitch_deg), 0.0]))
    return se3.transform(yaw @ pitch, np.array([x, y, z]))
