# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Cells that grow with the range, their parts, and what is remembered of them."""

from __future__ import annotations

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.dynamics.cells import Cells, Grid
from hybridreg_ros.odometry.dynamics.classifier import kept_at_rest

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


def cells_of(points: np.ndarray, pose: np.ndarray, grid: Grid) -> Cells:
    return Cells.of(points, np.ones(len(points), np.int32), pose, grid)


def test_cells_have_one_size_near_and_a_share_of_the_range_far_away() -> None:
    grid = Grid(0.2, 0.01)
    rays = np.random.default_rng(1).normal(size=(500, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    for range_m, size_m in ((5.0, 0.2), (40.0, 0.4), (80.0, 0.8)):
        step = 1e-4
        near, far = grid.warped(rays * range_m), grid.warped(rays * (range_m + step))
        np.testing.assert_allclose(np.linalg.norm(far - near, axis=1), step / size_m, rtol=1e-3)
    np.testing.assert_allclose(grid.warped(rays * 3.0), rays * 3.0 / 0.2)


def test_a_box_on_a_floor_is_a_part_of_its_own() -> None:
    points, box = scene()
    cells = cells_of(points, np.eye(4), Grid(SIZE, 0.001))
    part, count = cells.parts
    assert part.min() == 0
    assert part.max() == count - 1
    of_box = np.bincount(cells.of_point, weights=box) / np.bincount(cells.of_point)
    high = (of_box == 1.0) & (cells.centre[:, 2] > FLOOR_M + 2 * SIZE)
    floor = (of_box == 0.0) & (np.abs(cells.centre[:, 1]) > 0.4 + 2 * SIZE)
    assert not set(part[high]) & set(part[floor])
    assert len(np.unique(part[floor])) == 1


def test_values_are_found_again_from_another_pose() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-8.0, 8.0, (400, 3)).astype(np.float32)
    first = se3.exp(np.array([0.3, -0.1, 0.2, 0.1, 0.0, 0.4]))
    second = se3.exp(np.array([-0.5, 0.4, 0.1, 0.0, -0.2, 1.0]))
    cells = cells_of(points, first, Grid(0.05, 0.001))
    values = rng.normal(size=(len(cells), 2)).astype(np.float32)
    there = se3.apply(se3.inverse(second) @ first, cells.centre)
    found = cells.at(there, second, values)
    np.testing.assert_allclose(found[:, :2], values, atol=1e-6)
    assert (found[:, 2] == 1.0).all()
    assert (cells.at(there + 1000.0, second, values) == 0.0).all()


def test_what_comes_to_rest_keeps_its_log_odds_for_a_while_and_what_it_hid_does_not() -> None:
    points, _ = scene()
    cells = cells_of(points, np.eye(4), Grid(SIZE, 0.001))
    box = cells.centre[:, 2] > FLOOR_M + 2 * SIZE
    odds = np.full(len(cells), -3.0, np.float32)
    moved = np.where(box, np.float32(4.0), np.float32(-1000.0))
    kept = kept_at_rest(cells, odds, moved, 2.0)
    assert (kept[box] == 3.0).all()
    assert (kept[~box] == -3.0).all()
    assert (kept_at_rest(cells, odds, moved, 7.0) == odds).all()
    going = np.where(box, np.float32(1.0), odds)  # by its own evidence
    assert (kept_at_rest(cells, going, moved, 2.0) == going).all()
    beside = ~box & (cells.centre[:, 1] > 0.7)
    assert beside.sum() > 100
    left = np.where(beside, np.float32(4.0), np.float32(-1000.0))
    assert (kept_at_rest(cells, odds, left, 0.1) == odds).all()
