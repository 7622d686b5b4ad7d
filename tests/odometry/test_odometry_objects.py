# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Whole things from cells, means that thin a cloud, map points that average."""

from __future__ import annotations

import numpy as np

from hybridreg_ros.odometry.config import DynamicsConfig
from hybridreg_ros.odometry.dynamics import objects, segments
from hybridreg_ros.odometry.dynamics.classifier import Dynamics
from hybridreg_ros.odometry.map.local_map import VoxelLevel
from hybridreg_ros.odometry.map.thinning import first_per_voxel, means_of, occupied, voxel_of
from hybridreg_ros.odometry.preprocess import SensorModel, certainty
from hybridreg_ros.odometry.visibility.range_image import RangeImage, view_of

SIZE = 0.1
FLOOR_M, BOX_M = -1.0, 0.8


def scene() -> tuple[np.ndarray, np.ndarray]:
    """A floor 3 m by 3 m and the two visible sides and the top of a box on it; which is box."""
    flat = np.stack(np.meshgrid(np.arange(1, 4, 0.03), np.arange(-1.5, 1.5, 0.03)), -1)
    floor = np.c_[flat.reshape(-1, 2), np.full(flat.shape[0] * flat.shape[1], FLOOR_M)]
    under = (np.abs(floor[:, 0] - 2.4) < 0.4) & (np.abs(floor[:, 1]) < 0.4)
    grid = np.stack(np.meshgrid(np.arange(0, BOX_M, 0.03), np.arange(0, BOX_M, 0.03)), -1)
    a, b = grid.reshape(-1, 2).T
    front = np.c_[np.full(len(a), 2.0), a - 0.4, FLOOR_M + 0.03 + b]
    top = np.c_[2.0 + a, b - 0.4, np.full(len(a), FLOOR_M + 0.03 + BOX_M)]
    points = np.concatenate([floor[~under], front, top]).astype(np.float32)
    return points, np.arange(len(points)) >= (~under).sum()


def test_a_few_seeds_take_the_whole_box_and_leave_the_floor() -> None:
    points, box = scene()
    table, slots, keys, _, counts, cell = occupied(points, SIZE, np.ones(len(points), bool))
    grid = objects.Cells(table, slots, keys, counts, SIZE)
    shape = objects.Shape(*segments.normals(points, cell, *grid.index))
    of_box = np.bincount(cell, weights=box) / np.bincount(cell)
    config = DynamicsConfig()
    # The upper third of the front side came; the rest of the box overlaps where it was before.
    seed = (of_box == 1.0) & (shape.centre[:, 0] < 2.05) & (shape.centre[:, 2] > -0.5)
    group = objects.confirmed(grid, seed, config)
    known = ~seed
    taken, _ = objects.complete(grid, shape, group, known, np.zeros(len(keys), bool), config)
    moves = taken | (group >= 0)
    inside = (of_box == 1.0) & (shape.centre[:, 2] > FLOOR_M + 0.15)
    assert moves[inside].mean() > 0.9
    # Of the floor, at most the rim of cells that touch the box goes with it.
    off = np.abs(shape.centre[:, :2] - [2.4, 0.0]).max(axis=1)
    assert not moves[(of_box == 0.0) & (off > 0.4 + 2 * SIZE)].any()


def test_groups_that_are_too_small_are_no_things() -> None:
    points, _ = scene()
    table, slots, keys, _, counts, cell = occupied(points, SIZE, np.ones(len(points), bool))
    grid = objects.Cells(table, slots, keys, counts, SIZE)
    few = np.zeros(len(keys), bool)
    few[np.unique(cell[:4])] = True
    assert (objects.confirmed(grid, few, DynamicsConfig(min_seed_cells=20)) == -1).all()


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
    depth = certainty(points, SensorModel('depth', 0.05, 0.2, 8.0))
    assert depth[0] > 0.9
    assert depth[1] < 0.05
    assert (certainty(points, SensorModel('lidar', 0.3, 0.5, 100.0)) == 1.0).all()


def test_the_past_is_kept_close_at_first_and_evenly_later() -> None:
    config = DynamicsConfig(memory=4, spacing_s=0.5)
    dynamics = Dynamics(config, SensorModel('depth', 0.1, 0.2, 8.0))
    points = scene()[0]
    image = RangeImage(points, view_of(points, 'lidar'), np.eye(4))
    for k in range(40):
        dynamics.remember(image, points[:1], k * 100_000_000)
        if k == 3:
            assert len([past.stamp for past in dynamics._past]) == 4
    gaps = np.diff([past.stamp for past in dynamics._past])
    assert len(gaps) == 3
    assert (gaps >= 400_000_000).all()
