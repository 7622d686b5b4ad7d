# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""LocalMap: the one voxel map that both branches read and write, fed with static points only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.pages import zeros
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.map import voxel_map
from hybridreg_ros.odometry.map.voxel_map import VoxelTable

if TYPE_CHECKING:
    from numpy.typing import NDArray

POINTS_PER_VOXEL = 20
"""Stored points of a cube at most."""
_COARSE = 8.0
"""Edge of a coarse cube in fine ones."""
_START_VOXELS = 1 << 13
_START_POINTS = 1 << 15


class VoxelLevel:
    """Points hashed into cubes, at most a few per cube, never two nearer than a spacing.

    Attributes:
        size_m: edge of a cube.
        used: cubes in use.
        grid: the arrays, as the kernels take them.
    """

    def __init__(self, size_m: float, points_per_voxel: int, by_mass: bool = False) -> None:
        self.size_m = size_m
        self._by_mass = by_mass
        self._per_voxel = points_per_voxel
        self._spacing_sq = size_m**2 / points_per_voxel
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self.used = 0
        self.grid = VoxelTable(
            size=self.size_m,
            most=self._per_voxel,
            **_no_voxels(_START_VOXELS),
            free=voxel_map.none_taken(self._per_voxel),
            **_no_points(_START_POINTS),
            by_mass=self._by_mass,
        )

    def add(
        self,
        points: NDArray[np.floating],
        weights: NDArray[np.floating],
        origin: NDArray[np.float64],
        now_s: float,
    ) -> None:
        """Add points (N, 3), map frame, metres, with weights (N,), seen from a place (3,), now."""
        row = 0
        while row < len(points):
            self.used, done = voxel_map.insert(
                points[row:], weights[row:], origin, now_s, self._spacing_sq, self.grid, self.used
            )
            row += done
            if row < len(points):
                self.make_room()

    def keep_near(self, centre: NDArray[np.float64], reach_m: float) -> None:
        """Drop cubes farther from the centre (3,) than the reach, and empty ones."""
        place = np.ascontiguousarray(centre)
        self.used = voxel_map.keep_near(place, reach_m**2, self.grid, self.used)

    def erase_near(self, points: NDArray[np.floating], reach_m: float) -> int:
        """Remove stored points that share a cube with a point (N, 3) and lie within the reach."""
        places = np.ascontiguousarray(points)
        removed: int = voxel_map.erase_near(places, reach_m**2, self.grid)
        return removed

    def distance(self, points: NDArray[np.floating], T: NDArray[np.float64]) -> float:
        """Mean distance, metres, of points (N, 3) moved by T to the map, cut off at one cube."""
        R, t, places = T[:3, :3].copy(), T[:3, 3].copy(), np.ascontiguousarray(points)
        mean: float = voxel_map.mean_distance(places, R, t, self.grid)
        return mean

    def __len__(self) -> int:
        """Stored points."""
        return int(self.grid.voxels['count'][: self.used].sum())

    def points(self) -> NDArray[np.float32]:
        """All stored points (N, 3), map frame, metres."""
        grid = self.grid
        stored: NDArray[np.float32] = voxel_map.gather(grid.voxels, grid.store, self.used)
        return stored

    def make_room(self) -> None:
        """Make room: twice as many cubes; or twice as many points, or those packed that are there.

        Rows of the new arrays that are not used yet take no memory.
        """
        old, rows = self.grid, len(self.grid.store)
        if self.used == len(old.voxels):
            more = _no_voxels(2 * self.used)
            more['voxels'][: self.used] = old.voxels
            self.grid = old._replace(**more)
            self.keep_near(np.zeros(3), np.inf)
        elif 2 * len(self) > rows:
            more = _no_points(2 * rows)
            for name, values in more.items():
                values[:rows] = getattr(old, name)
            self.grid = old._replace(**more)
        else:
            free = voxel_map.none_taken(self._per_voxel)
            self.grid = old._replace(free=free, **_no_points(rows))
            voxel_map.pack(old, self.grid, self.used)


def _no_voxels(count: int) -> dict[str, Any]:
    """The arrays of a `Grid` for so many cubes, a power of two, all empty."""
    slots = zeros(4 * count, np.int32)
    slots[:] = -1
    return {'slots': slots, 'voxels': zeros(count, voxel_map.VOXEL)}


def _no_points(count: int) -> dict[str, Any]:
    """The arrays of a `Grid` for so many points."""
    return {
        'store': zeros((count, 4), np.float32),
        'beam': zeros((count, 3), np.float32),
        'surface': zeros(count, voxel_map.SURFACE),
    }


class LocalMap:
    """Static surroundings of the sensor at three resolutions, in the odom frame.

    The coarse level widens the basin of the registration; the fine one gives the accuracy; the
    middle and then the coarse one have surfaces where the rings of a lidar are too far apart, or
    a depth camera too noisy, for the finer ones. The map forgets what lies farther from the sensor
    than its reach, so its memory is bounded.

    Args:
        voxel_size_m: edge of a fine cube.
        reach_m: farther points are forgotten.
        noisy: whether the noise grows with the range, as that of a depth camera. Then surfaces are
            fitted to stored points by their mass. Rings of a lidar pile up mass where they lie by
            chance.

    Attributes:
        changes: how often its points changed.
        updates: how often points were added.
        noisy: as given.
        age_s: seconds from its first points to its last ones, on a clock that never goes back.
    """

    def __init__(self, voxel_size_m: float, reach_m: float, noisy: bool = False) -> None:
        sizes = (voxel_size_m * _COARSE**power for power in (0.0, 0.5, 1.0))
        self.fine, self.middle, self.coarse = (
            VoxelLevel(size, POINTS_PER_VOXEL, noisy) for size in sizes
        )
        self.noisy = noisy
        self._reach_m = reach_m
        self._pruned_at = np.full(3, np.inf)
        self.changes = 0
        self.updates = 0
        self.age_s = 0.0
        self._stamp: int | None = None

    @property
    def levels(self) -> tuple[VoxelLevel, VoxelLevel, VoxelLevel]:
        """Coarse, middle and fine level."""
        return self.coarse, self.middle, self.fine

    @property
    def grids(self) -> tuple[VoxelTable, VoxelTable, VoxelTable]:
        """The levels as kernels that ask for surfaces take them, the finest first."""
        return self.fine.grid, self.middle.grid, self.coarse.grid

    def __len__(self) -> int:
        """Cubes of the fine level in use."""
        return self.fine.used

    def update(
        self,
        points: NDArray[np.floating],
        position: NDArray[np.float64],
        weights: NDArray[np.floating] | None = None,
        stamp: int = 0,
    ) -> None:
        """Add static points and forget what is out of reach.

        Args:
            points: (N, 3) odom frame, metres.
            position: (3,) of the sensor, odom frame, metres.
            weights: (N,) of each point in means with others there, at most 1; None = 1.
            stamp: when they were seen, ns.
        """
        given = np.ones(len(points)) if weights is None else np.asarray(weights, np.float64)
        self.updates += 1
        self.changes += 1
        if self._stamp is not None:
            self.age_s += max(0, stamp - self._stamp) / NS_PER_S
        self._stamp = stamp
        for level in self.levels:
            level.add(points, given, np.asarray(position, np.float64), self.age_s)
        if not np.linalg.norm(position - self._pruned_at) < 0.1 * self._reach_m:
            for level in self.levels:
                level.keep_near(position, self._reach_m)
            self._pruned_at = position.copy()

    def erase(self, points: NDArray[np.floating]) -> int:
        """Take points out again that turned out to move; returns how many went.

        Args:
            points: (N, 3) odom frame, metres.
        """
        removed = 0
        for level in self.levels:
            removed += level.erase_near(points, 0.5 * level.size_m)
        self.changes += removed > 0
        return removed

    def clear(self) -> None:
        """Forget everything."""
        for level in self.levels:
            level.clear()
        self._pruned_at = np.full(3, np.inf)
        self.age_s, self._stamp = 0.0, None
        self.changes += 1
