# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rings of a lidar travel along with it: they must not hold its pose where it was."""

from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import Scan
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.map.local_map import LocalMap, VoxelLevel
from hybridreg_ros.odometry.map.planes import buffer, fit_around
from hybridreg_ros.odometry.registration.kernels import PLANE, associate, measure
from hybridreg_ros.odometry.registration.surfaces import unpaired

HEIGHT_M = 1.2
RINGS_M = np.arange(-1.0, 4.0, 0.7)
STEP_M = 0.07


def some_trunks(seed: int, count: int) -> np.ndarray:
    """Tree trunks: x, y of the axis and radius, (count, 3), metres."""
    low, high = [-14.0, -14.0, 0.12], [14.0, 14.0, 0.35]
    return np.random.default_rng(seed).uniform(low, high, (count, 3))


TRUNKS = some_trunks(3, 12)


def ring_scan(
    x_m: float, seed: int, trunks: np.ndarray = TRUNKS, height_m: float = HEIGHT_M
) -> np.ndarray:
    """What 16 rings see from a place on flat ground between tree trunks, (N, 3), metres."""
    rng = np.random.default_rng([seed, 5])
    elevation, azimuth = np.meshgrid(
        np.deg2rad(np.arange(-15.0, 16.0, 2.0)), np.deg2rad(np.arange(0.0, 360.0, 0.4))
    )
    flat = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    slope = np.tan(elevation)
    far = np.where(slope < 0.0, -height_m / np.minimum(slope, -1e-6), 60.0)  # horizontal range
    for cx, cy, radius in trunks - [x_m, 0.0, 0.0]:
        along = flat @ np.array([cx, cy])
        off = cx**2 + cy**2 - along**2
        hit = (along > 0.0) & (off < radius**2)
        far = np.where(hit, np.minimum(far, along - np.sqrt(np.maximum(radius**2 - off, 0))), far)
    beams = np.concatenate([flat * np.cos(elevation)[..., None], np.sin(elevation)[..., None]], -1)
    ranges = far / np.cos(elevation) + rng.normal(0.0, 0.015, far.shape)
    return (beams * ranges[..., None])[(far < 50.0) & (far > 0.5)].astype(np.float32)


@pytest.mark.parametrize('seed', range(3, 9))
def test_a_slow_sensor_with_few_rings_is_seen_to_move(seed: int) -> None:
    trunks = some_trunks(seed, 40)
    odometry = HybridOdometry(model=None)
    for k in range(12):
        scan = ring_scan(STEP_M * k, 100 * seed + k, trunks)
        result = odometry.step(Scan(scan, stamp=k * 100_000_000))
    moved = result.pose[:3, 3]
    assert abs(moved[0] - 11 * STEP_M) < 0.05 * 11 * STEP_M
    assert np.abs(moved[1:]).max() < 0.05
    assert se3.rotation_angle_deg(result.pose[:3, :3]) < 0.5


def test_one_ring_is_no_surface_and_two_rings_of_a_wall_are() -> None:
    rng = np.random.default_rng(1)
    y = np.arange(-1.0, 1.0, 0.02)
    one = np.stack([np.full_like(y, 5.0), y, np.full_like(y, -0.5)], axis=1)
    one *= 1.0 + rng.normal(0.0, 0.004, (len(y), 1))  # noise along the beam
    for rings, least, most in (([one], 0.0, 0.0), ([one, one * [1.0, 1.0, 0.3]], 0.9, 1.0)):
        wall = np.concatenate(rings)
        local_map = LocalMap(0.2, 100.0)
        local_map.update(wall, np.zeros(3))
        found = unpaired(len(wall))
        associate(wall, np.eye(4), local_map.grids, local_map.updates, found)
        assert least <= np.mean(found.kind == PLANE) <= most


def test_ground_between_far_rings_is_a_surface() -> None:
    scan = ring_scan(0.0, 1, np.zeros((0, 3)))
    ground = scan[np.hypot(scan[:, 0], scan[:, 1]) < 7.0]  # rings 0.7 to 1.4 m apart
    local_map = LocalMap(0.15, 100.0)
    local_map.update(scan, np.zeros(3))
    found = unpaired(len(ground))
    associate(ground.astype(np.float64), np.eye(4), local_map.grids, local_map.updates, found)
    planes = found.kind == PLANE
    assert planes.mean() > 0.8
    assert np.quantile(np.abs(found.normal[planes, 2]), 0.05) > 0.98


def test_points_between_far_rings_are_paired_with_the_wall_that_these_show() -> None:
    y = np.arange(-6.0, 6.0, 0.05)
    wall = np.concatenate([np.c_[np.full_like(y, 20.0), y, np.full_like(y, z)] for z in RINGS_M])
    local_map = LocalMap(0.2, 100.0)
    local_map.update(wall, np.zeros(3))
    between = wall[np.abs(wall[:, 1]) < 5.0] + [0.0, 0.0, 0.35]  # half way to the next ring
    found = unpaired(len(between))
    for off_m, paired in ((0.0, True), (0.05, True), (0.3, False)):
        associate(between - [off_m, 0, 0], np.eye(4), local_map.grids, local_map.updates, found)
        measure(between - [off_m, 0.0, 0.0], np.eye(4), found)
        assert (found.kind == PLANE).mean() > 0.8 if paired else (found.kind != PLANE).all()
        if paired:
            np.testing.assert_allclose(found.residual[found.kind == PLANE], off_m, atol=0.01)


def test_what_lies_off_a_plane_does_not_bend_it() -> None:
    rng = np.random.default_rng(2)
    ground = np.c_[rng.uniform(-2.0, 2.0, (1500, 2)), rng.normal(0.0, 0.01, 1500)]
    feet = np.c_[rng.normal([0.4, 0.0], 0.1, (40, 2)), rng.uniform(0.05, 0.4, 40)]
    level = VoxelLevel(0.8, 20)
    both = np.concatenate([ground, feet])
    level.add(both, np.ones(len(both)), np.array([0.0, 0.0, 1.5]), 0.0)
    n, _, _, nz, offset, variance = fit_around(0.0, 0.0, 0.0, level.grid, buffer(level.grid))
    assert n > 50
    assert abs(nz) > np.cos(np.deg2rad(1.5))
    assert abs(offset) < 0.01
    assert variance**0.5 < 0.02


def test_a_plane_keeps_its_variance_where_what_is_left_of_it_is_none() -> None:
    """Without the two points off a row of others there would be a line."""
    row = np.c_[np.linspace(-0.6, 0.6, 7), np.zeros((7, 2))]
    off = np.array([[0.0, 0.5, 0.15], [0.0, 0.5, -0.15]])
    level = VoxelLevel(0.8, 20)
    level.add(np.concatenate([row, off]), np.ones(9), np.array([0.0, 0.0, 1.5]), 0.0)
    n, _, _, nz, _, variance = fit_around(0.0, 0.0, 0.0, level.grid, buffer(level.grid))
    assert (n, abs(nz)) == (9, pytest.approx(1.0))
    assert variance == pytest.approx(2 * 0.15**2 / 9, rel=1e-3)
