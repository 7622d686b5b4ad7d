# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Far walls of a depth camera: surfaces in spite of noise that is deeper than a voxel."""

from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.odometry.map.local_map import LocalMap
from hybridreg_ros.odometry.preprocess import SensorModel, certainty
from hybridreg_ros.odometry.registration.kernels import PLANE, associate
from hybridreg_ros.odometry.registration.surfaces import unpaired

SENSOR = SensorModel('depth', 0.08, 0.2, 8.0, 0.04)
FAR_M = 5.6


def far_wall(seed: int) -> np.ndarray:
    """Scan (N, 3) of a wall across the view, noise 1.5 mm per squared metre, some of it wild."""
    rng = np.random.default_rng([seed, 17])
    across = np.stack(np.meshgrid(np.arange(-1.5, 1.5, 0.04), np.arange(-1.0, 1.0, 0.04)), -1)
    points = np.concatenate([across.reshape(-1, 2), np.full((across.size // 2, 1), FAR_M)], 1)
    noise = rng.normal(0.0, 0.0015 * FAR_M**2, len(points))
    wild = rng.random(len(points)) < 0.1
    return points * (1.0 + np.where(wild, 4.0 * noise, noise) / FAR_M)[:, None]


@pytest.mark.parametrize(('noisy', 'least', 'most'), [(False, 0.0, 0.3), (True, 0.85, 1.0)])
def test_far_wall_has_surfaces_when_points_count_by_what_was_measured(
    noisy: bool, least: float, most: float
) -> None:
    local_map = LocalMap(SENSOR.voxel_size_m, 8.0, noisy)
    for seed in range(20):
        scan = far_wall(seed)
        local_map.update(scan, np.zeros(3), certainty(scan, SENSOR))
    inner = far_wall(99)
    inner = inner[(np.abs(inner[:, :2]) < 0.6).all(axis=1)]
    found = unpaired(len(inner))
    associate(inner, np.eye(4), local_map.grids, local_map.updates, found)
    planes = found.kind == PLANE
    assert least <= planes.mean() <= most
    if noisy:
        assert np.median(np.abs(found.normal[planes, 2])) > 0.99
        assert abs(np.median(found.anchor[planes, 2]) - FAR_M) < 0.02
