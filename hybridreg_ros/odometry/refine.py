# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Refinement: ICP of the static points against the local map, coarse level first."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry import align

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import RefineConfig
    from hybridreg_ros.odometry.localmap import LocalMap, VoxelLevel

Basin = Literal['coarse', 'middle', 'fine']

_POINT_SPREAD = 5.0
"""Standard deviation of a point-to-point residual, in voxels: such pairs follow the pattern of the
rings rather than the surface, so they only hold what planes leave free."""


_RANGE_GROUPS = 6
_RANGE_GROUP = 100
"""Points are grouped by range into at most so many groups of at least so many, each with a scale
of its own: the noise of a depth camera grows with the square of the range."""


@dataclass(frozen=True, eq=False)
class Fit:
    """How well a scan sits in the map.

    Attributes:
        T_odom_sensor: (4, 4) float64.
        information: (6, 6) of the pose error (x y z, turn about the sensor; odom axes), 1/m^2 and
            1/rad^2; zero where nothing was found.
        overlap: share of the points with a surface of the map nearby, [0, 1].
        scale_m: robust standard deviation of the plane residuals, metres.
        converged: False when the iterations ended while the pose still moved.
    """

    T_odom_sensor: NDArray[np.float64]
    information: NDArray[np.float64]
    overlap: float
    scale_m: float
    converged: bool


class _Surfaces:
    """Pairs of scan points with local surfaces of the map (buffers reused over iterations)."""

    def __init__(self, count: int) -> None:
        self.kind = np.zeros(count, np.int8)
        self.anchor = np.zeros((count, 3))
        self.normal = np.zeros((count, 3))
        self.variance = np.zeros(count)
        self.residual = np.full(count, np.inf)

    def search(
        self,
        points: NDArray[np.float64],
        T: NDArray[np.float64],
        levels: tuple[VoxelLevel, VoxelLevel],
        update: int,
    ) -> None:
        """Pair points with the surfaces of a level, or of the wider one where it has none."""
        align.associate(
            points, T[:3, :3].copy(), T[:3, 3].copy(), levels[0].grid, levels[1].grid, update,
            self.kind, self.anchor, self.normal, self.variance,
        )  # fmt: skip

    def measure(self, points: NDArray[np.float64], T: NDArray[np.float64]) -> None:
        align.residuals(
            points, T[:3, :3].copy(), T[:3, 3].copy(),
            self.kind, self.anchor, self.normal, self.residual,
        )  # fmt: skip

    def scale(self, low: float, high: float) -> float:
        """Robust standard deviation of the plane residuals, metres, clipped to [low, high]."""
        planes = self.residual[self.kind == align.PLANE]
        if len(planes) == 0:
            return high
        return float(np.clip(1.4826 * np.median(planes), low, high))

    def scales(self, order: NDArray[np.int64], low: float, high: float) -> NDArray[np.float64]:
        """The same per point (N,), as it grows with the range: medians of groups by range.

        Args:
            order: (N,) rows of the points by range.
            low: floor, metres.
            high: ceiling, metres.
        """
        out = np.empty(len(order))
        planes = order[self.kind[order] == align.PLANE]
        if len(planes) < 2 * _RANGE_GROUP:
            out.fill(self.scale(low, high))
            return out
        groups = min(_RANGE_GROUPS, len(planes) // _RANGE_GROUP)
        ends = np.linspace(0, len(planes), groups + 1).astype(np.int64)
        spread = [1.4826 * np.median(self.residual[planes[a:b]]) for a, b in pairwise(ends)]
        place = np.empty(len(order))
        place[order] = np.arange(len(order))
        middles = [place[planes[(a + b) // 2]] for a, b in pairwise(ends)]
        out[:] = np.interp(place, middles, spread)
        return np.clip(out, low, high)


def refine(
    points: NDArray[np.floating],
    T_odom_sensor: NDArray[np.float64],
    local_map: LocalMap,
    config: RefineConfig,
    weights: NDArray[np.floating] | None = None,
    basin: Basin = 'coarse',
) -> Fit:
    """Align points with the map, from a first guess.

    Args:
        points: (N, 3), sensor frame, metres, thinned.
        T_odom_sensor: (4, 4) first guess.
        local_map: the map.
        config: settings.
        weights: (N,) trust per point in [0, 1] (1 - P(dynamic)), or None for all equal.
        basin: level to start on: the coarser, the farther off the guess may be.
    """
    start = T_odom_sensor
    if basin != 'fine':
        start = pull_in(points, T_odom_sensor, local_map, config, weights, basin)
    points, trust = _prepared(points, weights)
    floor = 4.0 * config.min_scale if basin == 'fine' else 0.4 * config.start_scale
    T, converged = _iterate(
        points, trust, start, (local_map.fine, local_map.middle), local_map.updates, config, floor
    )
    return assess(points, T, local_map, config, weights, converged)


def pull_in(
    points: NDArray[np.floating],
    T_odom_sensor: NDArray[np.float64],
    local_map: LocalMap,
    config: RefineConfig,
    weights: NDArray[np.floating] | None,
    basin: Basin,
) -> NDArray[np.float64]:
    """Improve a guess on a coarser level with some of the points; arguments as `refine`."""
    some = slice(None, None, max(1, len(points) // config.coarse_points))
    points, trust = _prepared(points[some], None if weights is None else weights[some])
    level = local_map.coarse if basin == 'coarse' else local_map.middle
    levels = (level, local_map.coarse)
    T, _ = _iterate(
        points, trust, T_odom_sensor, levels, local_map.updates, config, config.start_scale
    )
    return T


def _prepared(
    points: NDArray[np.floating], weights: NDArray[np.floating] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Contiguous float64 points and weights for the kernels."""
    trust = np.ones(len(points)) if weights is None else weights
    return np.ascontiguousarray(points, np.float64), np.ascontiguousarray(trust, np.float64)


def assess(
    points: NDArray[np.floating],
    T_odom_sensor: NDArray[np.float64],
    local_map: LocalMap,
    config: RefineConfig,
    weights: NDArray[np.floating] | None = None,
    converged: bool = True,
) -> Fit:
    """Measure how well points sit in the map at a pose, without moving them.

    Args:
        points: (N, 3), sensor frame, metres.
        T_odom_sensor: (4, 4) the pose.
        local_map: the map.
        config: settings.
        weights: (N,) trust per point in [0, 1], or None.
        converged: passed on to the result.
    """
    points, trust = _prepared(points, weights)
    level = local_map.fine
    surfaces = _Surfaces(len(points))
    surfaces.search(points, T_odom_sensor, (local_map.fine, local_map.middle), local_map.updates)
    surfaces.measure(points, T_odom_sensor)
    scale = surfaces.scale(config.min_scale * level.size_m, level.size_m)
    # Point-to-point pairs follow the sampling, not the scene: they say nothing about the error.
    planes = np.where(surfaces.kind == align.PLANE, trust, 0.0)
    scales = surfaces.scales(_by_range(points), config.min_scale * level.size_m, level.size_m)
    H, _, _, _ = _system(points, planes, T_odom_sensor, surfaces, scales, level)
    usable = trust > 0.5
    paired = usable & (surfaces.kind != align.NONE)
    return Fit(
        T_odom_sensor=T_odom_sensor,
        information=H,
        overlap=float(paired.sum() / max(1, usable.sum())),
        scale_m=scale,
        converged=converged,
    )


def _by_range(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rows of the points (N, 3) by their range, nearest first."""
    return np.argsort((points**2).sum(axis=1))


def _system(
    points: NDArray[np.float64],
    trust: NDArray[np.float64],
    T: NDArray[np.float64],
    surfaces: _Surfaces,
    scale: NDArray[np.float64],
    level: VoxelLevel,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float, float]:
    """Gauss-Newton system of the robust cost at T."""
    system: tuple[NDArray[np.float64], NDArray[np.float64], float, float] = align.normal_equations(
        points, trust, T[:3, :3].copy(), T[:3, 3].copy(), surfaces.kind, surfaces.anchor,
        surfaces.normal, surfaces.variance, scale, (_POINT_SPREAD * level.size_m) ** 2,
    )  # fmt: skip
    return system


def _iterate(
    points: NDArray[np.float64],
    trust: NDArray[np.float64],
    T: NDArray[np.float64],
    levels: tuple[VoxelLevel, VoxelLevel],
    update: int,
    config: RefineConfig,
    floor: float,
) -> tuple[NDArray[np.float64], bool]:
    """Pair and step until the pose stands still; the pose and whether it does.

    The robust scale starts no smaller than `floor` voxels and shrinks (graduated non-convexity):
    a sharp kernel at a bad guess would keep only the pairs that happen to agree with the guess.
    """
    level = levels[0]
    surfaces = _Surfaces(len(points))
    reach = float(np.median(np.linalg.norm(points, axis=1))) if len(points) else 1.0
    order = _by_range(points)
    for _ in range(config.max_iterations):
        surfaces.search(points, T, levels, update)
        moved = 0.0
        for _ in range(2):
            surfaces.measure(points, T)
            low = max(floor, config.min_scale) * level.size_m
            scale = surfaces.scales(order, low, level.size_m)
            H, b, _, _ = _system(points, trust, T, surfaces, scale, level)
            step = _solve(H, b)
            T = T.copy()
            T[:3, :3] = se3.so3_exp(step[3:]) @ T[:3, :3]
            T[:3, 3] += step[:3]
            moved = max(moved, float(np.linalg.norm(step[:3]) + reach * np.linalg.norm(step[3:])))
        if moved < config.convergence * level.size_m and floor < 2.0 * config.min_scale:
            return se3.orthonormalise(T), True
        floor *= config.anneal
    return se3.orthonormalise(T), False


def _solve(H: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solution of H step = -b in the directions that the points hold; zero along the others."""
    unit = np.sqrt(np.maximum(np.diag(H), 1e-12))
    values, vectors = np.linalg.eigh(H / np.outer(unit, unit))
    held = values > 1e-4
    projected = np.where(held, (vectors.T @ (-b / unit)) / np.where(held, values, 1.0), 0.0)
    step: NDArray[np.float64] = (vectors @ projected) / unit
    return step
