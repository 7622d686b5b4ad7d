# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The voxel follows the budget of points."""

import numpy as np
import pytest

from hybridreg_ros.model.geometry.voxel_size import budget_voxel_size_m


def occupied(points, cell_m):
    return len(np.unique(np.floor(points / cell_m), axis=0))


@pytest.mark.parametrize(('points', 'superpoints'), [(5000, 256), (5000, 40), (400, 256)])
def test_the_voxel_keeps_the_budget_at_both_ends_and_is_hardly_larger(points, superpoints):
    rng = np.random.default_rng(3)
    wall = rng.uniform(-30.0, 30.0, (60_000, 3)).astype(np.float32)
    wall[:, 2] = rng.normal(0.0, 0.01, len(wall))
    wall[::97] = np.nan
    small = wall[:9000] * np.float32(0.5)
    voxel_m = budget_voxel_size_m(
        wall, small, smallest_m=0.1, max_points=points, max_superpoints=superpoints
    )
    seen = wall[np.isfinite(wall).all(axis=1)]
    assert occupied(seen, voxel_m) <= 1.05 * points
    assert occupied(seen, 8 * voxel_m) <= 1.3 * superpoints
    tighter = voxel_m / 1.1
    assert occupied(seen, tighter) > points or occupied(seen, 8 * tighter) > superpoints


def test_a_cloud_within_the_budget_keeps_the_smallest_voxel():
    cloud = np.random.default_rng(0).random((500, 3)).astype(np.float32)
    found = budget_voxel_size_m(cloud, smallest_m=0.05, max_points=5000, max_superpoints=256)
    assert found == 0.05
