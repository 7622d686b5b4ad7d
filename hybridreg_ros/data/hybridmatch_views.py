# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Where to put the camera: candidate views of a stage, what they share, how much moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.se3 import apply, inverse
from hybridreg_ros.data.sensors import look_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.raycast import Caster
    from hybridreg_ros.data.rooms_motion import Stage
    from hybridreg_ros.data.sensors import DepthCamera

    F64 = NDArray[np.float64]

_NEAR_M = 0.35
_MIN_THINGS = 0.1
_MIN_SPREAD = 0.03
MIN_USEFUL = 0.2


@dataclass(frozen=True, eq=False)
class Survey:
    """A coarse look through all candidate views.

    Attributes:
        poses: (V, 4, 4) T_world_camera.
        overlap: (V, V) share of the static points of view i (at the second time) that view j
            (at the first time) sees too.
        dynamic: (2, V) share of moving points at the first and second time.
        useful: (V,) share of rays that return something that is kept, at the worse time; 0 for
            a view that shows too little furniture, only one plane, or something held before it.
    """

    poses: F64
    overlap: F64
    dynamic: F64
    useful: F64


def candidate_views(
    rng: np.random.Generator, stage: Stage, count: int, *, crowded: bool = False
) -> list[F64]:
    """Random camera poses: most look at the key figure from about 2 m, some look elsewhere."""
    floor, height = stage.room.floor, stage.room.plan.height_m
    spots = floor.clear_spots(rng.uniform(0.2, 0.6), rng.uniform(0.3, 0.9))
    if len(spots) == 0:
        return []
    away = np.linalg.norm(spots - stage.key[:2], axis=1)
    focus = np.array([*stage.room.focus, stage.key])
    level, roll = rng.uniform(0.6, 1.7), rng.uniform(0.0, 0.12)
    poses = []
    wanted = rng.uniform(0.9, 2.2) if crowded else rng.uniform(1.0, 3.2)
    weight = np.exp(-0.5 * ((away - wanted) / rng.uniform(0.4, 1.3)) ** 2) + 1e-6
    weight /= weight.sum()
    for spot in spots[rng.choice(len(spots), size=count, p=weight)]:
        at_key = rng.random() < (0.85 if crowded else 0.7)
        z = np.clip(level + rng.normal(0.0, 0.25), 0.3, height - 0.3)
        eye = np.array([*spot, z])
        aim = stage.key if at_key else focus[rng.integers(len(focus))]
        aim = aim + rng.normal(0.0, 0.35, 3)
        if not at_key and rng.random() < 0.5:
            angle = rng.uniform(0.0, 2.0 * np.pi)
            aim = eye + np.array([2.0 * np.cos(angle), 2.0 * np.sin(angle), rng.normal(-0.4, 0.5)])
        poses.append(look_at(eye, aim, rng.normal(0.0, roll)))
    return poses


@dataclass(frozen=True, eq=False)
class _Glance:
    """What few rays of each of V views show; leading axis 2 = first and second time.

    Attributes:
        depth: (2, V, P) along the optical axis, metres.
        static: (2, V, P) kept points of the background.
        weight: (2, V, P) how much of a voxel of the thinned cloud each point stands for.
        dynamic: (2, V) share of moving points.
        useful: (V,) as in `Survey`.
    """

    depth: F64
    static: NDArray[np.bool_]
    weight: F64
    dynamic: F64
    useful: F64


def survey(
    caster: Caster,
    camera: DepthCamera,
    stage: Stage,
    poses: list[F64],
    times_s: tuple[float, float],
    gone: NDArray[np.bool_],
    thin_m: float,
    keep: tuple[int, float, float],
) -> Survey:
    """Look through every view with few rays at two times, and compare the best of them.

    Args:
        caster: the scene.
        camera: intrinsics and range; its resolution is not used.
        stage: the scene's background.
        poses: candidate poses.
        times_s: first and second time.
        gone: (F,) static triangles whose points will be removed.
        thin_m: voxel of the thinned clouds.
        keep: number of views V to compare, and the lowest and highest share of moving points
            that is wanted.
    """
    small = camera.strided(camera.width / 32.0)
    length = np.linalg.norm(small.rays.reshape(-1, 3), axis=1)
    T = np.stack(poses)
    glance = _glance(caster, camera, stage, T, times_s, gone, thin_m)
    count, low, high = keep
    share = glance.dynamic.mean(0)
    miss = np.maximum(np.maximum(low - share, share - high), 0.0) + 10.0 * (
        glance.useful <= MIN_USEFUL
    )
    rows = np.sort(np.argsort(miss, kind='stable')[:count])
    T, depth, static = T[rows], glance.depth[:, rows], glance.static[:, rows]
    weight = glance.weight[1, rows] * static[1]
    ray = np.einsum('vij,rj->vri', T[:, :3, :3], small.rays.reshape(-1, 3) / length[:, None])
    reach = (depth[1] * length).clip(0.0, 1e3)
    world = T[:, None, :3, 3] + ray * reach[..., None]
    overlap = np.zeros((len(T), len(T)))
    for j in range(len(T)):
        seen = _seen(small, T[j], world.reshape(-1, 3), depth[0][j], static[0][j])
        overlap[:, j] = (weight * seen.reshape(len(T), -1)).sum(1)
    overlap /= np.maximum(weight.sum(1), 1e-9)[:, None]
    return Survey(T, overlap, glance.dynamic[:, rows], glance.useful[rows])


def _glance(
    caster: Caster,
    camera: DepthCamera,
    stage: Stage,
    T: F64,
    times_s: tuple[float, float],
    gone: NDArray[np.bool_],
    thin_m: float,
) -> _Glance:
    """Cast the few rays of all views (V, 4, 4)."""
    small = camera.strided(camera.width / 32.0)
    rays = small.rays.reshape(-1, 3)
    length = np.linalg.norm(rays, axis=1)
    directions = np.einsum('vij,rj->vri', T[:, :3, :3], rays / length[:, None]).reshape(-1, 3)
    origins = np.repeat(T[:, :3, 3], len(rays), axis=0)
    on_plane = np.append(stage.background.plane, 0)
    depth, static, dynamic, useful, weights = [], [], [], [], []
    for time_s in times_s:
        trace = caster.trace(time_s, origins.astype(np.float32), directions.astype(np.float32))
        z = trace.distance.reshape(len(T), -1) / length
        moving = trace.instance.reshape(len(T), -1) > 0
        kept = (z > camera.min_depth_m) & (z < camera.max_depth_m)
        kept &= ~np.append(gone, False)[trace.face].reshape(len(T), -1)
        # A thinned cloud holds one point per voxel: near pixels share voxels, far ones do not.
        weight = np.minimum(z / (camera.fx * thin_m), 1.0) ** 2
        weights.append(weight)
        depth.append(z)
        static.append(kept & ~moving)
        dynamic.append(
            (weight * (kept & moving)).sum(1) / np.maximum((weight * kept).sum(1), 1e-9)
        )
        blocked = (z < _NEAR_M).mean(1) > 0.15
        things = static[-1] & (on_plane[trace.face].reshape(len(T), -1) == 0)
        shape = _normal_spread(trace.normal.reshape(len(T), -1, 3), static[-1])
        poor = (things.mean(1) < _MIN_THINGS) | (shape < _MIN_SPREAD) | blocked
        useful.append(np.where(poor, 0.0, kept.mean(1)))
    return _Glance(
        np.stack(depth), np.stack(static), np.stack(weights), np.stack(dynamic),
        np.minimum(*useful),
    )  # fmt: skip


def _normal_spread(normal: NDArray[np.float32], kept: NDArray[np.bool_]) -> F64:
    """How well surface directions fix a pose (V,): smallest eigenvalue of their mean n n^T."""
    n = np.where(kept[..., None], normal, 0.0).astype(np.float64)
    moment = np.einsum('vri,vrj->vij', n, n) / np.maximum(kept.sum(1), 1)[:, None, None]
    smallest: F64 = np.linalg.eigvalsh(moment)[:, 0]
    return smallest


def _seen(
    camera: DepthCamera, T_world_camera: F64, world: F64, depth: F64, static: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which world points (N, 3) a coarse depth image (H*W,) shows as static."""
    local = apply(inverse(T_world_camera), world)
    z = local[:, 2]
    safe = np.maximum(z, 1e-3)
    u = np.rint(local[:, 0] / safe * camera.fx + camera.cx)
    v = np.rint(local[:, 1] / safe * camera.fy + camera.cy)
    hit = (z > camera.min_depth_m) & (u >= 0) & (u < camera.width) & (v >= 0)
    hit &= v < camera.height
    pixel = np.where(hit, v * camera.width + u, 0).astype(np.int64)
    seen: NDArray[np.bool_] = hit & static[pixel] & (np.abs(depth[pixel] - z) < 0.08 + 0.06 * z)
    return seen
