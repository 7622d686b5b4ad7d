# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Kernels on the cells of a scan."""

from __future__ import annotations

import numpy as np

from hybridreg_ros.odometry.dynamics import cells
from hybridreg_ros.odometry.map.thinning import occupied


def a_row_of_cells(count):
    """Cells of 1 m along x, as the classifier makes them."""
    points = np.zeros((count, 3))
    points[:, 0] = np.arange(count) + 0.5
    table, slots, keys, first, _, _ = occupied(points, 1.0, np.ones(count, np.bool_))
    return table, slots, keys, np.argsort(first)


def test_growing_reaches_as_far_as_steps_and_budget_allow_and_changes_no_argument():
    table, slots, keys, place = a_row_of_cells(9)
    value, group = np.zeros(9, np.float32), np.full(9, -1, np.int32)
    value[place[4]], group[place[4]] = 1.0, 0
    budget, passable = np.array([3]), np.ones(9, np.bool_)
    passable[place[3]] = False
    given = [a.copy() for a in (value, group, budget, passable)]
    grown, owner = cells.grow(keys, table, slots, value, group, budget, passable, 2, 0.5)
    assert grown[place].tolist() == [0, 0, 0, 0, 1.0, 0.5, 0.25, 0, 0]
    assert owner[place].tolist() == [-1, -1, -1, -1, 0, 0, 0, -1, -1]
    for before, after in zip(given, (value, group, budget, passable), strict=True):
        assert np.array_equal(before, after)
    few, _ = cells.grow(keys, table, slots, value, group, np.array([1]), passable, 2, 0.5)
    assert few[place].tolist() == [0, 0, 0, 0, 1.0, 0.5, 0, 0, 0]
