# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the sensor is follows from range and field of view, and again when the scene changes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros.benchmark.analytic_world import Box, HalfSpace, cast, lidar_rays, pose
from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import Scan
from hybridreg_ros.data.sensors.lidar_pattern import raster, rosette
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.preprocess import recognise_sensor

if TYPE_CHECKING:
    from collections.abc import Callable

    from hybridreg_ros.data.sensors.lidar_pattern import PatternLidar

ROAD = (
    HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    Box((-60.0, 6.0, 0.0), (12.0, 9.0, 5.0)),
    Box((16.0, 6.0, 0.0), (70.0, 9.0, 7.0)),
    Box((-60.0, -9.0, 0.0), (40.0, -7.0, 4.0)),
    Box((15.0, -3.0, 0.0), (19.0, -1.0, 1.6)),
    Box((30.0, 2.0, 0.0), (34.0, 4.0, 2.5)),
)


@pytest.mark.parametrize('make', [rosette, raster])
def test_a_lidar_that_looks_ahead_only_is_one(
    make: Callable[[np.random.Generator], PatternLidar],
) -> None:
    rays = make(np.random.default_rng(1)).directions().reshape(-1, 3).astype(np.float64)
    points, _ = cast(ROAD, pose(0.0, 0.0, 0.0, 1.8), rays)
    sensor = recognise_sensor(points[np.linalg.norm(points, axis=1) < 100.0], OdometryConfig())
    assert sensor.kind == 'lidar'
    assert sensor.max_range_m == 100.0


def test_a_cover_that_is_taken_off_leaves_no_fine_map() -> None:
    rays = lidar_rays(360, 24, -25.0, 10.0)
    way = [pose(0.3 * k, 0.0, 0.0, 1.8) for k in range(16)]
    odometry, off_m = HybridOdometry(), []
    for k, T in enumerate(way):
        x, y, z = T[:3, 3]
        cover = Box((x - 0.9, y - 0.9, z - 0.9), (x + 0.9, y + 0.9, z + 0.9), inside=True)
        points, _ = cast((cover,) if k < 5 else ROAD, T, rays, seed=k)
        result = odometry.step(Scan(points[np.linalg.norm(points, axis=1) < 100.0], stamp=k / 10))
        off_m.append(result.pose[:3, 3] - T[:3, 3])
    assert odometry._tracker is not None
    assert odometry._tracker.sensor.voxel_size_m > 0.15
    assert result.confidence > 0.7
    assert np.linalg.norm(off_m[-1] - off_m[-4]) < 0.1  # the way of the last scans is right
    assert se3.rotation_angle_deg(result.pose[:3, :3]) < 1.0
