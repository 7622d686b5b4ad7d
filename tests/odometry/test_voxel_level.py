# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A level of the map against a plain one made of lists, and what its arrays take."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hybridreg_ros.odometry.map import voxel_map
from hybridreg_ros.odometry.map.local_map import VoxelLevel
from hybridreg_ros.odometry.map.voxel_map import MOST_MASS, nearest

SIZE = 0.5
MOST = 9


class PlainLevel:
    """The rules of `VoxelLevel` with a dictionary of lists, float32 like the real one."""

    def __init__(self, most: int) -> None:
        self.cubes: dict[tuple[int, ...], list[list[np.ndarray | float]]] = {}
        self._most = most
        self._spacing_sq = SIZE**2 / most

    def add(self, points: np.ndarray) -> None:
        for point in points:
            cube = self.cubes.setdefault(tuple(np.floor(point / SIZE).astype(int)), [])
            off = [np.sum((np.asarray(p, np.float64) - point) ** 2) for p, _ in cube]
            full = len(cube) >= self._most
            best = int(np.argmin(off)) if off else -1
            if off and off[best] < (4.0 if full else 1.0) * self._spacing_sq:
                p, mass = cube[best]
                cube[best][0] = (p + (point - p) / (mass + 1.0)).astype(np.float32)
                cube[best][1] = min(mass + 1.0, MOST_MASS)
            elif not full:
                cube.append([point.astype(np.float32), 1.0])

    def erase(self, points: np.ndarray, reach: float) -> None:
        for point in points:
            cube = self.cubes.get(tuple(np.floor(point / SIZE).astype(int)), [])
            place = 0
            while place < len(cube):  # the last one takes the place of one that goes
                if np.sum((cube[place][0] - point) ** 2) <= reach**2:
                    cube[place] = cube[-1]
                    cube.pop()
                else:
                    place += 1

    def keep_near(self, centre: np.ndarray, reach: float) -> None:
        self.cubes = {
            k: c for k, c in self.cubes.items() if c and np.linalg.norm(c[0][0] - centre) <= reach
        }

    @property
    def points(self) -> np.ndarray:
        return np.array([p for cube in self.cubes.values() for p, _ in cube])


def in_order(points: np.ndarray) -> np.ndarray:
    return points[np.lexsort(points.T)]


@pytest.mark.parametrize('most', [1, 2, MOST])
def test_level_keeps_what_a_plain_one_keeps(most: int) -> None:
    rng = np.random.default_rng(most)
    level, plain = VoxelLevel(SIZE, most), PlainLevel(most)
    for k in range(40):
        points = rng.normal([0.2 * k, 0.0, 0.0], [1.5, 1.5, 0.3], (300, 3))
        level.add(points, np.ones(len(points)), np.zeros(3), float(k))
        plain.add(points)
        if k % 3 == 2:
            gone = points[::17]
            level.erase_near(gone, 0.1)
            plain.erase(gone, 0.1)
        if k % 7 == 6:
            centre = points.mean(axis=0)
            level.keep_near(centre, 2.0)
            plain.keep_near(centre, 2.0)
        assert len(level) == len(plain.points)
    np.testing.assert_allclose(in_order(level.points()), in_order(plain.points), atol=1e-5)


def test_points_stay_with_their_voxel_when_arrays_grow() -> None:
    rng = np.random.default_rng(0)
    level = VoxelLevel(SIZE, MOST)
    before = len(level.grid.voxels), len(level.grid.store)
    points = rng.uniform(-12.0, 12.0, (150_000, 3))
    level.add(points, np.ones(len(points)), np.array([0.0, 0.0, 50.0]), 3.0)
    assert len(level.grid.voxels) > before[0]
    assert len(level.grid.store) > before[1]
    assert np.unique(level.points(), axis=0).shape == level.points().shape
    for point in level.points()[::5000]:
        row, _, off = nearest(*point.astype(np.float64), level.grid)
        assert off == 0.0
        assert np.array_equal(level.grid.store[row, :3], point)
        assert level.grid.surface[row]['born'] == 3.0
        assert level.grid.beam[row] @ np.array([0.0, 0.0, -1.0]) > 0.8


def test_rows_of_what_is_forgotten_are_used_again() -> None:
    """A long way: the arrays stay as large as what is near needs."""
    rng = np.random.default_rng(1)
    level, sizes = VoxelLevel(SIZE, MOST), []
    for k in range(300):
        place = np.array([float(k), 0.0, 0.0])
        level.add(place + rng.normal(0.0, 4.0, (2000, 3)), np.ones(2000), place, float(k))
        level.keep_near(place, 12.0)
        sizes.append((len(level), len(level.grid.voxels)))
    points, voxels = np.array(sizes[100:]).T
    assert points.max() < 1.2 * points.min()
    assert len(level.grid.store) <= 4 * points.max()
    assert voxels.max() == voxels.min()


def test_points_are_packed_before_more_rows_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """All voxels outgrow their rows together, so those that they leave fit no other one."""
    packs: list[int] = []
    pack = voxel_map.pack

    def counted(*args: Any) -> Any:
        packs.append(args[2])
        return pack(*args)

    monkeypatch.setattr(voxel_map, 'pack', counted)
    corners = SIZE * np.stack(np.meshgrid(*[np.arange(12.0)] * 3), -1).reshape(-1, 3)
    places = np.array([(x, y, 0.2) for x in (0.07, 0.24, 0.41) for y in (0.07, 0.24, 0.41)])
    level = VoxelLevel(SIZE, MOST)
    rows = len(level.grid.store)
    marks: dict[tuple[float, ...], int] = {}
    for k, place in enumerate(places):
        level.add(corners + place, np.ones(len(corners)), np.zeros(3), float(k))
        if k == 2:  # surfaces, as a registration leaves them
            for voxel in range(level.used):
                start, count = (level.grid.voxels[voxel][name] for name in ('start', 'count'))
                for row in range(start, start + count):
                    marks[tuple(level.grid.store[row, :3].tolist())] = row + 1
                    surface = level.grid.surface[row]
                    surface['fitted'] = surface['variance'] = row + 1
                    surface['support'] = row
    assert packs == [len(corners)]
    assert len(level.grid.store) == rows
    assert len(level) == len(places) * len(corners) == len(np.unique(level.points(), axis=0))
    for place, mark in marks.items():
        row, _, off = nearest(*place, level.grid)
        assert off == 0.0
        surface = level.grid.surface[row]
        assert surface['fitted'] == surface['variance'] == mark
        assert surface['support'] == mark - 1
