# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Surfaces of the map by age: who remembers it, what it does to weights and to a pose."""

from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.map.local_map import LocalMap
from hybridreg_ros.odometry.registration import alignment
from hybridreg_ros.odometry.registration.alignment import align
from hybridreg_ros.odometry.registration.kernels import associate
from hybridreg_ros.odometry.registration.surfaces import Surfaces, by_age, unpaired

VOXEL_M = 0.05


def wall(x: float, height: float, seed: int = 0, depth_m: float = 0.0) -> np.ndarray:
    """(N, 3) points of an upright rectangle across the view at x, 3 mm of noise."""
    rng = np.random.default_rng([seed, 23])
    y, z = np.meshgrid(np.arange(-1.0, 1.0, 0.03), np.arange(0.0, height, 0.03))
    points = np.stack([np.full(y.size, x), y.ravel(), z.ravel() + depth_m], 1)
    return points + rng.normal(0.0, 0.003, points.shape)


def surfaces(born: np.ndarray) -> Surfaces:
    """Surfaces of that many points, all of them planes, first seen at these ages."""
    found = unpaired(len(born))
    found.kind[:] = 2
    found.born[:] = born
    return found


def test_old_surfaces_hold_and_new_ones_hardly_do() -> None:
    born = np.repeat([0.0, 9.5, 9.75, 10.0], 100)
    weight = by_age(np.full(400, 0.9), surfaces(born), 10.0, 0.5)
    per_kind = weight.reshape(4, 100)
    assert (per_kind == per_kind[:, :1]).all()
    np.testing.assert_allclose(per_kind[:, 0], [0.9, 0.9, 0.9 * 0.55, 0.09], rtol=1e-6)


def test_only_differences_of_age_count() -> None:
    trust = np.linspace(0.6, 1.0, 200)
    for born in (np.full(200, 10.0), np.zeros(200)):
        np.testing.assert_array_equal(by_age(trust, surfaces(born), 10.0, 0.5), trust)
    young_map = by_age(trust, surfaces(np.repeat([0.0, 0.1], 100)), 0.1, 0.1)
    np.testing.assert_allclose(young_map[:100], trust[:100])
    np.testing.assert_allclose(young_map[100:], 0.1 * trust[100:])
    np.testing.assert_array_equal(by_age(trust, surfaces(np.zeros(200)), 0.0, 0.0), trust)


def test_points_without_trust_or_surface_do_not_decide() -> None:
    found = surfaces(np.repeat([0.0, 10.0], [300, 60]))
    found.kind[:100] = 0
    trust = np.repeat([1.0, 0.0, 1.0], [100, 200, 60])
    np.testing.assert_array_equal(by_age(trust, found, 10.0, 0.5), trust)


def test_the_map_remembers_when_places_were_first_seen() -> None:
    local_map = LocalMap(VOXEL_M, 8.0)
    for second in range(4):
        points = wall(2.0, 1.0, second)
        if second >= 2:
            points = np.concatenate([points, wall(2.0, 1.0, second, 2.0)])
        local_map.update(points, np.zeros(3), None, 1000 + second * NS_PER_S)
    assert local_map.age_s == pytest.approx(3.0)
    local_map.erase(wall(2.0, 0.4))
    both = np.concatenate([wall(2.0, 1.0, 9)[-600:], wall(2.0, 1.0, 9, 2.0)])
    found = unpaired(len(both))
    associate(both, np.eye(4), local_map.grids, local_map.updates, found)
    assert (found.born[:600] <= 1.0).mean() > 0.6  # noise fills gaps between old points later
    assert (found.born[600:] >= 2.0).all()
    assert set(found.born[found.kind != 0]) <= {0.0, 1.0, 2.0, 3.0}


def test_the_clock_of_the_map_never_goes_back() -> None:
    local_map = LocalMap(VOXEL_M, 8.0)
    for stamp_s in (100, 101, 5, 6, 8):
        local_map.update(wall(2.0, 1.0), np.zeros(3), None, stamp_s * NS_PER_S)
    assert local_map.age_s == pytest.approx(4.0)
    local_map.clear()
    assert local_map.age_s == 0.0
    local_map.update(wall(2.0, 1.0), np.zeros(3), None, 50 * NS_PER_S)
    assert local_map.age_s == 0.0


def drawn_along_m(stands: int) -> float:
    """How far a standing sensor is drawn by a nearer wall that leaves, known to nobody.

    It stands for some scans, then moves at 0.5 m/s, and has as many points as the one that stays.
    """
    pose, local_map = np.eye(4), LocalMap(VOXEL_M, 8.0)
    for k in range(30):
        gone = 0.05 * max(0, k - stands)
        points = np.concatenate([wall(3.0, 1.0, k), wall(1.5 + gone, 1.0, k + 100, 1.2)])
        if k > 0:
            pose = align(points, pose, local_map, basin='fine').T_odom_sensor
        moved = points @ pose[:3, :3].T + pose[:3, 3]
        local_map.update(moved, pose[:3, 3], None, k * NS_PER_S // 10)
    return float(abs(pose[0, 3]))


@pytest.mark.parametrize('stands', [0, 10])
def test_an_unknown_mover_does_not_draw_the_pose_along(
    stands: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert drawn_along_m(stands) < 0.01
    monkeypatch.setattr(alignment, 'MATURE_S', 0.0)
    assert drawn_along_m(stands) > 0.2
