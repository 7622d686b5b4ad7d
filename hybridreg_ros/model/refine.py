# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Refinement of a match: GICP of the trusted points, kept only where it does no harm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import small_gicp

from hybridreg_ros.core import se3
from hybridreg_ros.model.ops import CellList

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

_NORMAL_NEIGHBOURS = 12
_SOURCE_POINTS = 2500
_MIN_POINTS = 20
_STAGES_VOXELS = (3.0, 1.5)
_ITERATIONS = 15
_OVERLAP_RADIUS = 1.0
_MAX_SHIFT_VOXELS = 8.0
_MAX_TURN_DEG = 15.0


@dataclass(frozen=True, eq=False)
class Surface:
    """Finest points of a cloud prepared for GICP, voxels; built once per cloud.

    Attributes:
        points: (N, 3) float32.
        normals: (N, 3) float32 unit.
        cloud: small_gicp cloud with covariances.
        tree: its kd-tree.
        cells: for overlap queries.
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    cloud: Any
    tree: Any
    cells: CellList

    @classmethod
    def build(cls, points: NDArray[np.float32]) -> Surface:
        """Estimate covariances and sort points (N, 3), voxels."""
        cloud = small_gicp.PointCloud(points.astype(np.float64))
        tree = small_gicp.KdTree(cloud)
        small_gicp.estimate_normals_covariances(cloud, tree, _NORMAL_NEIGHBOURS)
        normals = np.ascontiguousarray(np.asarray(cloud.normals())[:, :3], dtype=np.float32)
        return cls(points, normals, cloud, tree, CellList.build(points, _OVERLAP_RADIUS))


@dataclass(frozen=True, eq=False)
class Refinement:
    """A refined pose.

    Attributes:
        V_target_source: (4, 4) float64, voxels.
        overlap: share of the trusted source points with a target point within one voxel.
        residual: root mean square of those distances, voxels; 1 when there is none.
        constraint: smallest over largest eigenvalue of the translational information.
        correction: distance that the mean of the trusted points was moved, voxels.
        accepted: False when the pose from before was kept.
        support: number of trusted source points with a target point within one voxel.
    """

    V_target_source: F64
    overlap: float
    residual: float
    constraint: float
    correction: float
    accepted: bool
    support: int


def refine(
    source: Surface,
    target: Surface,
    V_target_source: F64,
    trusted: NDArray[np.bool_],
    threads: int = 1,
) -> Refinement:
    """Align the trusted source points with the target, starting from a match.

    Args:
        source: moving cloud, voxels.
        target: fixed cloud, voxels.
        V_target_source: (4, 4) start, voxels.
        trusted: (N,) source points that neither move nor lack a counterpart.
        threads: threads of small_gicp.
    """
    rows = np.flatnonzero(trusted)
    if len(rows) < _MIN_POINTS:
        rows = np.arange(len(source.points))
    if len(rows) > _SOURCE_POINTS:
        rows = rows[np.linspace(0, len(rows) - 1, _SOURCE_POINTS).astype(np.int64)]
    moving = source.points[rows].astype(np.float64)
    before = _overlap(moving, target, V_target_source)
    V, constraint = _gicp(moving, target, V_target_source, threads)
    after = _overlap(moving, target, V)
    centre = moving.mean(axis=0)
    step = V @ se3.inverse(V_target_source)
    difference = V - V_target_source
    shift = float(np.linalg.norm(difference[:3, :3] @ centre + difference[:3, 3]))
    fits = (
        se3.is_rigid(V)
        and shift <= _MAX_SHIFT_VOXELS
        and se3.rotation_angle_deg(step[:3, :3]) <= _MAX_TURN_DEG
        and after[0] >= 0.95 * before[0]
    )
    if not fits:
        return Refinement(
            V_target_source, *before, constraint, 0.0, False, round(before[0] * len(rows))
        )
    return Refinement(V, *after, constraint, shift, True, round(after[0] * len(rows)))


def _gicp(moving: F64, target: Surface, V: F64, threads: int) -> tuple[F64, float]:
    """GICP from coarse to fine; the pose and how well the surfaces constrain it."""
    cloud = small_gicp.PointCloud(moving)
    small_gicp.estimate_covariances(cloud, num_neighbors=_NORMAL_NEIGHBOURS, num_threads=threads)
    constraint = 0.0
    for gate in _STAGES_VOXELS:
        result = small_gicp.align(
            target.cloud,
            cloud,
            target.tree,
            V,
            registration_type='GICP',
            max_correspondence_distance=gate,
            num_threads=threads,
            max_iterations=_ITERATIONS,
            rotation_epsilon=2e-4,
            translation_epsilon=2e-3,
        )
        if result.num_inliers < _MIN_POINTS:
            break
        V = se3.orthonormalise(np.asarray(result.T_target_source))
        eigenvalues = np.linalg.eigvalsh(np.asarray(result.H)[3:, 3:])
        constraint = float(max(eigenvalues[0], 0.0) / max(eigenvalues[-1], 1e-12))
    return V, constraint


def _overlap(moving: F64, target: Surface, V: F64) -> tuple[float, float]:
    """Share of points with a target point within one voxel, and their rms distance."""
    moved = se3.apply(V, moving).astype(np.float32)
    near = target.cells.search(moved, _OVERLAP_RADIUS, 1)[:, 0]
    hit = near < len(target.points)
    if not hit.any():
        return 0.0, 1.0
    gap = moved[hit] - target.points[near[hit]]
    return float(hit.mean()), float(np.sqrt((gap * gap).sum(axis=1).mean()))
