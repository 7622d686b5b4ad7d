# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Compiled point operations against scipy and plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from hybridreg_ros.core import se3
from hybridreg_ros.model.geometry import ops
from hybridreg_ros.model.geometry.neighbours import CellList


@pytest.mark.parametrize(('radius', 'cell'), [(0.3, 0.3), (0.7, 0.3), (0.2, 0.5)])
def test_radius_search_equals_kdtree(rng: np.random.Generator, radius: float, cell: float) -> None:
    points = rng.uniform(-2, 2, (800, 3)).astype(np.float32)
    queries = rng.uniform(-2.5, 2.5, (100, 3)).astype(np.float32)
    found = CellList.build(points, cell).search(queries, radius, 12)
    distance, index = cKDTree(points).query(queries, k=12, distance_upper_bound=radius)
    expected = np.where(np.isfinite(distance), index, len(points))
    np.testing.assert_array_equal(found, expected)


def test_radius_search_far_query_finds_nothing() -> None:
    points = np.zeros((3, 3), np.float32)
    queries = np.array([[9, 9, 9], [-9, 0, 0], [0.1, 0, 0]], np.float32)
    found = CellList.build(points, 1.0).search(queries, 1.0, 2)
    np.testing.assert_array_equal(found, [[3, 3], [3, 3], [0, 1]])


def test_morton_parent_is_voxel_of_twice_the_size(rng: np.random.Generator) -> None:
    points = rng.uniform(0, 40, (500, 3)).astype(np.float32)
    fine = ops.morton_keys(points, 1.0, np.zeros(3))
    coarse = ops.morton_keys(points, 0.5, np.zeros(3))
    np.testing.assert_array_equal(fine >> 3, coarse)
    same = (np.floor(points[:, None]) == np.floor(points[None])).all(axis=2)
    np.testing.assert_array_equal(fine[:, None] == fine[None], same)


def test_barycentres_equal_means_per_voxel(rng: np.random.Generator) -> None:
    points = rng.uniform(0, 6, (400, 3)).astype(np.float32)
    keys = ops.morton_keys(points, 1.0, np.zeros(3))
    order = np.argsort(keys)
    starts = ops.runs_of(keys[order])
    means = ops.barycentres(points, order, starts, 1.0, np.zeros(3))
    owner = ops.run_of_each(order, starts)
    for r in range(len(means)):
        np.testing.assert_allclose(means[r], points[owner == r].mean(axis=0), atol=1e-5)


def _bins(points: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    return ops.geometry_bins(points.astype(np.float32), neighbours, 0.01, 4000, 2001)


def test_geometry_bins_do_not_change_under_rigid_motion(rng: np.random.Generator) -> None:
    points = rng.uniform(-5, 5, (30, 3))
    distance = np.linalg.norm(points[:, None] - points[None], axis=2) + 99.0 * np.eye(30)
    near = np.argsort(distance, axis=1)[:, :3].astype(np.int32)
    T = se3.exp(np.array([3.0, -2.0, 1.0, 0.8, -1.1, 0.4]))
    before, after = _bins(points, near), _bins(se3.apply(T, points), near)
    assert np.abs(before.astype(int) - after.astype(int)).max() <= 1
    assert (before == after).mean() > 0.97
    sheared = points * np.array([1.0, 1.0, 1.2])
    assert (before == _bins(sheared, near)).mean() < 0.3


def test_geometry_bins_are_distances_and_angles(rng: np.random.Generator) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0]], np.float32)
    near = np.array([[1], [0], [0]], np.int32)
    bins = ops.geometry_bins(points, near, 0.5, 10, 181)
    assert bins[0, 2, 0] == 4
    assert bins[0, 2, 1] == 10 + 90
    assert bins[1, 2, 1] == 10 + round(np.degrees(np.arctan2(2, 1)))
    assert bins[0, 0, 1] == 10
