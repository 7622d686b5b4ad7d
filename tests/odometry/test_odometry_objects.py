# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Means that thin a cloud, map points that average."""

from __future__ import annotations

import numpy as np

from hybridreg_ros.odometry.map.local_map import VoxelLevel
from hybridreg_ros.odometry.map.thinning import first_per_voxel, means_of, occupied, voxel_of
from hybridreg_ros.odometry.preprocess import SensorModel, certainty


def test_means_are_those_of_the_points_in_each_cube() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (500, 3)).astype(np.float32)
    table, slots, keys, rows, counts, cube = occupied(points, 0.5, np.ones(500, bool))
    means, numbers = means_of(points, cube, len(rows))
    assert counts.sum() == 500
    assert np.array_equal(counts, numbers)
    assert np.array_equal(rows, first_per_voxel(points, 0.5))
    assert np.array_equal(cube[rows], np.arange(len(rows)))
    assert len(np.unique(np.floor(points / 0.5), axis=0)) == len(keys)
    for k in range(len(rows)):
        np.testing.assert_allclose(means[k], points[cube == k].mean(axis=0), atol=1e-6)
    assert np.array_equal(voxel_of(points, 0.5, np.ones(500, bool), table, slots), cube)


def test_the_table_of_voxels_grows_and_points_left_out_stay_out() -> None:
    rng = np.random.default_rng(7)
    points = rng.uniform(-40, 40, (30_000, 3)).astype(np.float32)
    member = rng.uniform(size=30_000) < 0.7
    table, slots, keys, rows, counts, cube = occupied(points, 1.0, member)
    expected = np.unique(np.floor(points[member]), axis=0)
    assert len(keys) == len(expected) > 8192
    assert counts.sum() == member.sum()
    assert (cube[~member] == -1).all()
    assert np.array_equal(np.floor(points[rows])[cube[member]], np.floor(points[member]))
    assert np.array_equal(voxel_of(points, 1.0, member, table, slots), cube)


def test_map_points_average_what_is_measured_around_them() -> None:
    rng = np.random.default_rng(4)
    level = VoxelLevel(0.1, 4)
    for _ in range(25):
        place = np.array([[0.05, 0.05, 0.05]]) + rng.normal(0.0, 0.004, (1, 3))
        level.add(place, np.ones(1), np.zeros(3), 0.0)
    assert len(level.points()) == 1
    assert np.linalg.norm(level.points()[0] - 0.05) < 0.003


def test_far_points_of_a_depth_camera_count_less_and_those_of_a_lidar_do_not() -> None:
    points = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 4.0]])
    depth = certainty(points, SensorModel('depth', 0.05, 0.2, 8.0, 0.025))
    assert depth[0] > 0.9
    assert depth[1] < 0.05
    assert (certainty(points, SensorModel('lidar', 0.3, 0.5, 100.0, 0.15)) == 1.0).all()
