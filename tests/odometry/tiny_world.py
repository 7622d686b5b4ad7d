# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A small world of boxes and balls, and two sensors that cast rays into it (numpy only)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybridreg_ros.benchmark.analytic_world import (
    Ball,
    Box,
    cast,
    depth_rays,
    lidar_rays,
    pose,
)
from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import Scan

__all__ = ['ROOM', 'Ball', 'Box', 'cast', 'depth_rays', 'lidar_rays', 'pose', 'scans', 'walk']

F64 = NDArray[np.float64]


ROOM = (
    Box((-5.0, -4.0, 0.0), (5.0, 4.0, 3.0), inside=True),
    Box((2.0, 1.0, 0.0), (3.0, 2.2, 1.4)),
    Box((-3.5, -3.0, 0.0), (-2.0, -2.2, 2.2)),
    Box((-1.0, 2.8, 0.0), (0.5, 4.0, 1.0)),
    Box((3.2, -3.0, 0.0), (4.0, -1.5, 2.0)),
    Ball((-3.0, 2.0, 1.0), 0.7),
    Ball((1.0, -2.5, 1.2), 0.5),
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
