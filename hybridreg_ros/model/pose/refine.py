# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Refinement of a match: robust point-to-plane alignment, kept only where it does no harm."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.model.geometry.pyramid import surface
from hybridreg_ros.model.geometry.views import View
from hybridreg_ros.model.pose.plane_icp import aligned_both_ways, contacts

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.config import ModelConfig

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

_POINTS, _FEW_POINTS = 2500, 1000
_FIRST_STAGES = (('wide', 3.0, 6), ('grid', 1.5, 8))
_LAST_STAGES = (('grid', 0.8, 8),)
_FINER_STAGES = (('grid', 1.0, 8),)
"""Grid of the views, radius beyond which points are ignored, voxels, and rounds; on few points
until the pose is near, on all of the finer views."""
_OVERLAP_RADIUS = 1.0
_MAX_SHIFT_VOXELS = 8.0
_MAX_TURN_DEG = 15.0


@dataclass(frozen=True, eq=False)
class Refinement:
    """A refined pose.

    Attributes:
        V_target_source: (4, 4) float64, voxels.
        overlap: share of the source points with a target point within one voxel.
        residual: root mean square of those distances, voxels; 1 when there is none.
        constraint: smallest over largest eigenvalue of the translational information.
        correction: distance that the mean of the points was moved, voxels.
        accepted: False when the pose from before was kept.
        support: number of source points tried with a target point within one voxel.
    """

    V_target_source: F64
    overlap: float
    residual: float
    constraint: float
    correction: float
    accepted: bool
    support: int


def refine(source: View, target: View, V_target_source: F64, near: bool = False) -> Refinement:
    """Align the source with the target, starting from a match.

    Both clouds are drawn to each other. Every point takes part, and those without a surface within
    a shrinking radius drop out: that mask is sharper than the network's, which has superpoints.

    Args:
        source: moving cloud, voxels.
        target: fixed cloud, voxels.
        V_target_source: (4, 4) start, voxels.
        near: the start is within a voxel, and all that the views test takes part.
    """
    moving, fixed, V = source, target, V_target_source
    if not near:
        moving, fixed = source.resampled(_POINTS), target.resampled(_POINTS)
        few = source.resampled(_FEW_POINTS), target.resampled(_FEW_POINTS)
        V = aligned_both_ways(V, *few, _FIRST_STAGES)
    stages = _FINER_STAGES if near else _LAST_STAGES
    V = se3.orthonormalise(aligned_both_ways(V, moving, fixed, stages))
    before, after = _contact(moving, target, V_target_source), _contact(moving, target, V)
    centre = moving.sample.mean(axis=0, dtype=np.float64)
    difference = V - V_target_source
    shift = float(np.linalg.norm(difference[:3, :3] @ centre + difference[:3, 3]))
    step = V @ se3.inverse(V_target_source)
    accepted = (
        se3.is_rigid(V)
        and shift <= _MAX_SHIFT_VOXELS
        and se3.rotation_angle_deg(step[:3, :3]) <= _MAX_TURN_DEG
        and after.count >= 0.95 * before.count
    )
    kept = after if accepted else before
    return Refinement(
        V if accepted else V_target_source,
        kept.count / len(moving.sample),
        kept.residual,
        kept.constraint,
        shift if accepted else 0.0,
        bool(accepted),
        kept.count,
    )


def refined_finely(
    T_target_source: F64, clouds: tuple[F32, F32], voxel_size_m: float, config: ModelConfig
) -> F64:
    """A refined pose (4, 4), metres, aligned once more on all points of smaller voxels.

    Args:
        T_target_source: (4, 4) start, metres, right within `voxel_size_m`.
        clouds: (N, 3) and (M, 3) float32, source and target, metres.
        voxel_size_m: metres per voxel of this alignment.
        config: of the neighbourhoods that give the normals.

    Raises:
        RegistrationError: a cloud has too few points.
    """
    with ThreadPoolExecutor(2) as both:
        sides = both.map(lambda cloud: surface(cloud, voxel_size_m, config), clouds)
        views, metric = [], []
        for points, normals, origin in sides:
            views.append(View.build(points, normals, -origin / voxel_size_m, len(points)))
            metric.append(se3.transform(voxel_size_m * np.eye(3), origin))
    source, target = metric
    V = np.asarray(np.linalg.solve(target, T_target_source @ source), np.float64)
    V = refine(views[0], views[1], V, near=True).V_target_source
    return se3.orthonormalise(target @ V @ np.linalg.inv(source))


@dataclass(frozen=True)
class _Contact:
    """How points touch a surface: number within a voxel, rms distance, how well held in place."""

    count: int
    residual: float
    constraint: float


def _contact(moving: View, target: View, V: F64) -> _Contact:
    """Contact of the moving view's sample with the target."""
    index, squared = contacts(V, moving.sample, target, _OVERLAP_RADIUS)
    hit = index >= 0
    count = int(hit.sum())
    if count == 0:
        return _Contact(0, 1.0, 0.0)
    normals = target.normals[index[hit]].astype(np.float64)
    values = np.linalg.eigvalsh(normals.T @ normals)
    return _Contact(
        count,
        float(np.sqrt(squared[hit].mean(dtype=np.float64))),
        float(max(values[0], 0.0) / max(values[-1], 1e-12)),
    )
