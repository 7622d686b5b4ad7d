# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pyramid: everything about one cloud that depends on geometry alone.

A data worker builds it, the network only reads it; no gradient passes through it. In a training
sample tensors stand in place of what the network reads (`training.samples`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.model.geometry import ops
from hybridreg_ros.model.geometry.kernel import KernelOperator, kernel_operator, kernel_points
from hybridreg_ros.model.geometry.neighbours import CellList
from hybridreg_ros.model.geometry.normals import surface_normals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.config import ModelConfig

    F32 = NDArray[np.float32]

MIN_POINTS = 3
_MAX_EXTENT_VOXELS = float(2**20)
_MAX_COORDINATE_VOXELS = 2.0e6


@dataclass(frozen=True, eq=False)
class Level:
    """One resolution of a cloud; N points, Morton order.

    Attributes:
        points: (N, 3) float32, finest voxels, relative to `Pyramid.origin_m`.
        conv: influence weights of kernel points, from this level to itself; None once the cloud is
            encoded (`Pyramid.encoded`), like `pool` and `pool_index`.
        pool: the same from this level to the next coarser one; None at the coarsest.
        pool_index: (N_next, H) int32 neighbours of the coarser points in this level, nearest
            first, padded with N; None at the coarsest.
        up_index: (N,) int64 point of the next coarser level whose voxel holds this one; None at
            the coarsest.
    """

    points: F32
    conv: KernelOperator | None
    pool: KernelOperator | None = None
    pool_index: NDArray[np.int32] | None = None
    up_index: NDArray[np.int64] | None = None


@dataclass(frozen=True, eq=False)
class Pyramid:
    """A cloud at all resolutions, its patches and its pairwise geometry.

    Attributes:
        levels: finest first; `levels[config.fine_level]` holds the fine points (F of them) and
            `levels[-1]` the superpoints (S).
        patch_index: (S, K) int64 fine points of each superpoint, nearest first, padded with F.
        patch_mask: (S, K) bool, True where `patch_index` is a real point.
        geometry: (S, S, 1 + A) int16 rows of the embedding table: one distance bin, then A angle
            bins already offset by `config.distance_bins`.
        input_to_level0: (N,) int32 finest-level point of every input point, -1 for rows that held
            NaN or inf.
        voxel_size_m: metres per finest voxel.
        origin_m: (3,) float64 position of the zero of `Level.points` in the sensor frame, metres.
        fine_level: number of the level of the fine points.
        normals: (N, 3) float32 unit normals of the finest level, zero where there is no surface.
    """

    levels: tuple[Level, ...]
    patch_index: NDArray[np.int64]
    patch_mask: NDArray[np.bool_]
    geometry: NDArray[np.int16]
    input_to_level0: NDArray[np.int32]
    voxel_size_m: float
    origin_m: NDArray[np.float64]
    fine_level: int
    normals: F32

    @property
    def fine_points(self) -> F32:
        """(F, 3) float32 fine points, finest voxels, relative to `origin_m`."""
        return self.levels[self.fine_level].points

    @property
    def encoded(self) -> Pyramid:
        """Without what only the backbone needs, to be kept with its features: a third smaller."""
        levels = (replace(v, conv=None, pool=None, pool_index=None) for v in self.levels)
        return replace(self, levels=tuple(levels))

    @property
    def superpoints(self) -> F32:
        """(S, 3) float32 superpoints, finest voxels, relative to `origin_m`."""
        return self.levels[-1].points

    def metric(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Points (N, 3) of any level turned into metres in the sensor frame, float64."""
        return np.asarray(points, dtype=np.float64) * self.voxel_size_m + self.origin_m


def voxel_transform(
    T_target_source: NDArray[np.float64], source: Pyramid, target: Pyramid
) -> NDArray[np.float64]:
    """The metric transform between two sensor frames, for points in the voxels of two pyramids.

    Args:
        T_target_source: (4, 4), metres.
        source: pyramid of the source cloud.
        target: pyramid of the target cloud, same voxel size.

    Returns:
        (4, 4) float64 V with `target_voxels = V[:3, :3] @ source_voxels + V[:3, 3]`.
    """
    V = T_target_source.copy()
    shift = T_target_source[:3, :3] @ source.origin_m + T_target_source[:3, 3] - target.origin_m
    V[:3, 3] = shift / source.voxel_size_m
    return V


def metric_transform(
    V_target_source: NDArray[np.float64], source: Pyramid, target: Pyramid
) -> NDArray[np.float64]:
    """Inverse of `voxel_transform`: (4, 4) in voxels to (4, 4) in metres."""
    T = V_target_source.copy()
    T[:3, 3] = (
        V_target_source[:3, 3] * source.voxel_size_m
        + target.origin_m
        - V_target_source[:3, :3] @ source.origin_m
    )
    return T


def build_pyramid(
    points_m: NDArray[np.float32], voxel_size_m: float, config: ModelConfig
) -> Pyramid:
    """Build every level, neighbourhood, patch and pairwise bin of a cloud.

    The order of the input points does not matter; rows with NaN or inf are left out.

    Args:
        points_m: (N, 3) float32, sensor frame, metres.
        voxel_size_m: metres per finest voxel.
        config: sizes of the network.

    Raises:
        RegistrationError: fewer than 3 points, one single voxel, or coordinates too large for
            the voxel size.
    """
    grids, input_to_level0, origin = _grids(points_m, voxel_size_m, config)
    levels, normals = _levels(grids, config)
    fine, super_ = grids[config.fine_level].points, grids[-1].points
    patch = CellList.build(fine, config.patch_radius / 2.0).search(
        super_, config.patch_radius, config.patch_size
    )
    return Pyramid(
        levels,
        patch.astype(np.int64),
        patch < len(fine),
        pairwise_bins(super_, config),
        input_to_level0,
        float(voxel_size_m),
        origin,
        config.fine_level,
        normals,
    )


def surface(
    points_m: NDArray[np.float32], voxel_size_m: float, config: ModelConfig
) -> tuple[F32, F32, NDArray[np.float64]]:
    """What a pyramid of that voxel has on its finest level alone.

    Arguments and errors are those of `build_pyramid`.

    Returns:
        Points (N, 3) float32, finest voxels, their unit normals (N, 3), zero where there is no
        surface, and the origin (3,) of the points in the sensor frame, metres.
    """
    grids, _, origin = _grids(points_m, voxel_size_m, config)
    points = grids[0].points
    near = CellList.build(points, config.radius).search(points, config.radius, config.neighbours)
    return points, surface_normals(points, near), origin


@dataclass(frozen=True, eq=False)
class _Level:
    """Voxel barycentres (N, 3), sorted Morton keys, and the owner of each point of last level."""

    points: NDArray[np.float32]
    keys: NDArray[np.int64]
    owner: NDArray[np.int32]


def _grids(
    points_m: NDArray[np.float32], voxel_size_m: float, config: ModelConfig
) -> tuple[list[_Level], NDArray[np.int32], NDArray[np.float64]]:
    """Barycentres of all levels, `Pyramid.input_to_level0`, and the origin in metres."""
    every = np.ascontiguousarray(points_m, dtype=np.float32)
    if every.ndim != 2 or every.shape[1] != 3:
        raise RegistrationError(f'points: expected (N, 3), found {every.shape}')
    finite = ops.finite_rows(every)
    points = every[finite]
    if not (np.isfinite(voxel_size_m) and voxel_size_m > 0.0):
        raise RegistrationError(f'voxel_size_m: expected > 0, found {voxel_size_m}')
    if len(points) < MIN_POINTS:
        raise RegistrationError(
            f'expected at least {MIN_POINTS} finite points, found {len(points)}'
        )
    low, high = ops.bounds(points)
    largest = float(np.abs([low, high]).max())
    extent = float((high - low).max())
    if largest > _MAX_COORDINATE_VOXELS * voxel_size_m or extent > (
        _MAX_EXTENT_VOXELS * voxel_size_m
    ):
        raise RegistrationError(
            f'coordinates up to {largest:.3g} m over {extent:.3g} m are too large for voxels of '
            f'{voxel_size_m:g} m in float32: move the cloud to its sensor frame, in metres'
        )
    coarsest = 2 ** (config.levels - 1)
    first = np.floor(low / (voxel_size_m * coarsest)) * coarsest
    keys = ops.morton_keys(points, 1.0 / voxel_size_m, first)
    order = ops.radix_order(keys)
    grid = _merge(points, keys[order], order, 1.0 / voxel_size_m, first)
    grid = _thin(grid, config.max_points)
    if len(grid.points) < MIN_POINTS:
        raise RegistrationError(
            f'expected at least {MIN_POINTS} occupied voxels of {voxel_size_m:g} m, found '
            f'{len(grid.points)}: the cloud has no extent, or the voxel size is too large'
        )
    grids, zero = [grid], np.zeros(3)
    for level in range(1, config.levels):
        last = grids[-1]
        order = np.arange(len(last.keys))
        grid = _merge(last.points, last.keys >> 3, order, 1.0, zero)
        if level == config.levels - 1:
            grid = _thin(grid, config.max_superpoints)
        grids.append(grid)
    input_to_level0 = np.full(len(every), -1, np.int32)
    input_to_level0[finite] = grids[0].owner
    return grids, input_to_level0, first * voxel_size_m


def _merge(
    points: NDArray[np.float32],
    sorted_keys: NDArray[np.int64],
    order: NDArray[np.int64],
    scale: float,
    shift: NDArray[np.float64],
) -> _Level:
    """One barycentre per voxel."""
    starts = ops.runs_of(sorted_keys)
    means = ops.barycentres(points, order, starts, scale, shift)
    return _Level(means, sorted_keys[starts[:-1]], ops.run_of_each(order, starts))


def _thin(grid: _Level, limit: int) -> _Level:
    """Keep `limit` voxels evenly along the Morton curve; the others go to the nearest kept one."""
    n = len(grid.points)
    if n <= limit:
        return grid
    kept = np.linspace(0, n - 1, limit).round().astype(np.int64)
    nearest = np.searchsorted((kept[1:] + kept[:-1]) / 2.0, np.arange(n)).astype(np.int32)
    return _Level(grid.points[kept], grid.keys[kept], nearest[grid.owner])


def _levels(
    grids: list[_Level], config: ModelConfig
) -> tuple[tuple[Level, ...], NDArray[np.float32]]:
    """Neighbourhoods and influence weights of all levels; normals of the finest."""
    levels, normals = [], np.zeros((0, 3), np.float32)
    unit = kernel_points(config.kernel_points, config.kernel_radius)
    for i, grid in enumerate(grids):
        size = float(2**i)
        kernel, extent, radius = unit * size, config.kernel_extent * size, config.radius * size
        cells = CellList.build(grid.points, radius)
        near = cells.search(grid.points, radius, config.neighbours)
        if i == 0:
            normals = surface_normals(grid.points, near)
        conv = kernel_operator(grid.points, grid.points, near, kernel, extent)
        if i == len(grids) - 1:
            levels.append(Level(grid.points, conv))
            break
        coarse = grids[i + 1]
        below = cells.search(coarse.points, radius, config.neighbours)
        pool = kernel_operator(coarse.points, grid.points, below, kernel, extent)
        levels.append(Level(grid.points, conv, pool, below, coarse.owner.astype(np.int64)))
    return tuple(levels), normals


def pairwise_bins(superpoints: NDArray[np.float32], config: ModelConfig) -> NDArray[np.int16]:
    """Embedding-table rows of all pairs of superpoints."""
    near = ops.nearest_others(superpoints, config.angle_neighbours)
    bins: NDArray[np.int16] = ops.geometry_bins(
        superpoints, near, config.distance_step, config.distance_bins, config.angle_bins
    )
    return bins
