# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Where to put the camera: candidate views of a stage, what they share, how much moves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.se3 import apply, inverse
from hybridreg_ros.data.meshes.geometry import look_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.meshes.raycast import Caster, Trace
    from hybridreg_ros.data.rooms.motion import Stage
    from hybridreg_ros.data.sensors.depth_camera import DepthCamera

    F64 = NDArray[np.float64]

_NEAR_M = 0.35
_MIN_THINGS = 0.1
_MIN_SPREAD = 0.03
_FEW, _MANY = 16, 32
MIN_USEFUL = 0.2


@dataclass(frozen=True, eq=False)
class Survey:
    """A coarse look through all candidate views.

    Attributes:
        poses: (V, 4, 4) T_world_camera.
        overlap: (V, V) share of the static points of view i (at the second time) that view j
            (at the first time) sees too.
        turn_deg: (V, V) angle between the orientations of both views.
        dynamic: (2, V) share of moving points at the first and second time.
        crowd: (2, V) share of points on whatever could move, whether or not it does.
        useful: (V,) share of rays that return something that is kept, at the worse time; 0 for
            a view that shows too little furniture, only one plane, or something held before it.
    """

    poses: F64
    overlap: F64
    turn_deg: F64
    dynamic: F64
    crowd: F64
    useful: F64


def candidate_views(
    rng: np.random.Generator, stage: Stage, count: int, *, crowded: bool = False
) -> F64:
    """Random camera poses (N, 4, 4): most look at the key figure from about 2 m, some elsewhere.

    There are `count` of them, or none where there is no place to stand.
    """
    floor, height = stage.room.floor, stage.room.plan.height_m
    spots = floor.clear_spots(rng.uniform(0.2, 0.6), rng.uniform(0.3, 0.9))
    if len(spots) == 0:
        return np.zeros((0, 4, 4))
    away = np.linalg.norm(spots - stage.key[:2], axis=1)
    focus = np.array([*stage.room.focus, stage.key])
    level, roll = rng.uniform(0.6, 1.7), rng.uniform(0.0, 0.12)
    wanted = rng.uniform(0.9, 2.2) if crowded else rng.uniform(1.0, 3.2)
    weight = (
        np.exp(
            -0.5 * ((away - wanted) / rng.uniform(*((0.3, 0.9) if crowded else (0.4, 1.3)))) ** 2
        )
        + 1e-6
    )
    weight /= weight.sum()
    place = spots[rng.choice(len(spots), size=count, p=weight)]
    z = np.clip(level + rng.normal(0.0, 0.25, count), 0.3, height - 0.3)
    eye = np.column_stack([place, z])
    at_key = rng.random(count) < (0.85 if crowded else 0.7)
    aim = np.where(at_key[:, None], stage.key, focus[rng.integers(len(focus), size=count)])
    aim = aim + rng.normal(0.0, 0.35, (count, 3))
    angle, down = rng.uniform(0.0, 2.0 * np.pi, count), rng.normal(-0.4, 0.5, count)
    around = eye + np.column_stack([2.0 * np.cos(angle), 2.0 * np.sin(angle), down])
    away_from_key = ~at_key & (rng.random(count) < 0.5)
    aim = np.where(away_from_key[:, None], around, aim)
    return look_at(eye, aim, rng.normal(0.0, roll, count))


@dataclass(frozen=True, eq=False)
class Looker:
    """What all views of a stage have in common.

    Attributes:
        camera: intrinsics and range; its resolution is not used.
        on_plane: (F + 1,) number of the large plane of each static triangle, 0 for none.
        gone: (F + 1,) static triangles whose points will be removed; False at the end.
        thin_m: voxel of the thinned clouds.
    """

    camera: DepthCamera
    on_plane: NDArray[np.int32]
    gone: NDArray[np.bool_]
    thin_m: float

    def rays(self, across: int) -> tuple[DepthCamera, F64, F64]:
        """Camera with few pixels, its unit rays (P, 3), and their lengths (P,) at depth 1."""
        small = self.camera.strided(self.camera.width / across)
        rays = small.rays.reshape(-1, 3)
        length = np.linalg.norm(rays, axis=1)
        return small, rays / length[:, None], length


@dataclass(frozen=True, eq=False)
class Glance:
    """What few rays of each of V views show at one time.

    Attributes:
        depth: (V, P) along the optical axis, metres.
        kept: (V, P) rays that give a point.
        instance: (V, P) number of the mover, 0 = what can never move.
        weight: (V, P) how much of a voxel of the thinned cloud each point stands for.
        useful: (V,) as in `Survey`.
    """

    depth: F64
    kept: NDArray[np.bool_]
    instance: NDArray[np.uint16]
    weight: F64
    useful: F64

    def share(self, of: NDArray[np.bool_]) -> F64:
        """Share of the thinned points (V,) of each view that show some instances (K + 1,)."""
        mass = self.weight * self.kept
        shown: F64 = (mass * of[self.instance]).sum(1) / np.maximum(mass.sum(1), 1e-9)
        return shown

    def rows(self, keep: NDArray[np.bool_]) -> Glance:
        """What some of the views show."""
        return Glance(
            self.depth[keep],
            self.kept[keep],
            self.instance[keep],
            self.weight[keep],
            self.useful[keep],
        )

    def shares(self, count: int) -> F64:
        """Share of the points of all views that shows each of so many movers (count,)."""
        mass = self.weight * self.kept
        known = np.bincount(self.instance.reshape(-1), mass.reshape(-1), count + 1)
        share: F64 = known[1:] / max(float(mass.sum()), 1e-9)
        return share


def glance(look: Looker, caster: Caster, T: F64, time_s: float) -> Glance:
    """Cast a few rays of all views T (V, 4, 4)."""
    return _judged(look, _trace(look, caster, T, time_s, _MANY), len(T), _MANY)


def _trace(look: Looker, caster: Caster, T: F64, time_s: float, across: int) -> Trace:
    """Rays of all views T (V, 4, 4), `across` of them in each row."""
    _, unit, _ = look.rays(across)
    directions = np.einsum('vij,rj->vri', T[:, :3, :3], unit).reshape(-1, 3)
    origins = np.repeat(T[:, :3, 3], len(unit), axis=0)
    return caster.trace(time_s, origins.astype(np.float32), directions.astype(np.float32))


def _judged(look: Looker, trace: Trace, views: int, across: int) -> Glance:
    """What the rays of some views show."""
    camera, _, length = look.rays(across)
    shape = (views, len(length))
    z = trace.distance.reshape(shape) / length
    kept = (z > camera.min_depth_m) & (z < camera.max_depth_m)
    kept &= ~look.gone[trace.face].reshape(shape)
    instance = trace.instance.reshape(shape)
    bare = kept & (instance == 0)
    things = bare & (look.on_plane[trace.face].reshape(shape) == 0)
    poor = (things.mean(1) < _MIN_THINGS) | ((z < _NEAR_M).mean(1) > 0.15)
    poor |= _normal_spread(trace.normal.reshape(*shape, 3), bare) < _MIN_SPREAD
    # A thinned cloud holds one point per voxel: near pixels share voxels, far ones do not.
    weight = np.minimum(z / (look.camera.fx * look.thin_m), 1.0) ** 2
    return Glance(z, kept, instance, weight, np.where(poor, 0.0, kept.mean(1)))


def promising(
    look: Looker,
    caster: Caster,
    T: F64,
    time_s: float,
    keep: tuple[int, float, float],
    ranges_m: tuple[float, ...],
) -> tuple[F64, Looker, int]:
    """The best of some candidate views, after a look with very few rays.

    Args:
        look: what the views have in common.
        caster: the scene.
        T: (N, 4, 4) candidate poses.
        time_s: time of the movers.
        keep: number of views V, and the lowest and highest share of points on movers.
        ranges_m: ranges of the camera, tried in this order until a third of V views fits.

    Returns:
        The best views (V, 4, 4), what they have in common with the range that was chosen, and
        how many candidates fit.
    """
    count, low, high = keep
    movers = np.arange(len(caster.scene.movers) + 1) > 0
    trace = _trace(look, caster, T, time_s, _FEW)
    best: tuple[F64, Looker, int] = T[:0], look, -1
    for range_m in ranges_m:
        tried = replace(look, camera=replace(look.camera, max_depth_m=range_m))
        seen = _judged(tried, trace, len(T), _FEW)
        share = seen.share(movers)
        miss = np.maximum(np.maximum(low - share, share - high), 0.0)
        miss += 10.0 * (seen.useful <= MIN_USEFUL)
        fits = int((miss == 0.0).sum())
        if fits > best[2]:
            best = T[np.sort(np.argsort(miss, kind='stable')[:count])], tried, fits
        if 3 * fits >= count:
            break
    return best


def compare(
    look: Looker, T: F64, target: Glance, source: Glance, moves: NDArray[np.bool_]
) -> Survey:
    """What views T (V, 4, 4) share.

    Args:
        look: what the views have in common.
        T: poses.
        target: at the first time.
        source: at the second time.
        moves: (K + 1,) which movers move; False for what is no mover.
    """
    small, unit, length = look.rays(_MANY)
    still = [seen.kept & ~moves[seen.instance] for seen in (target, source)]
    ray = np.einsum('vij,rj->vri', T[:, :3, :3], unit)
    reach = (source.depth * length).clip(0.0, 1e3)
    world = (T[:, None, :3, 3] + ray * reach[..., None]).reshape(-1, 3)
    weight = source.weight * still[1]
    overlap = np.zeros((len(T), len(T)))
    for j in range(len(T)):
        seen = _seen(small, T[j], world, target.depth[j], still[0][j])
        overlap[:, j] = (weight * seen.reshape(len(T), -1)).sum(1)
    overlap /= np.maximum(weight.sum(1), 1e-9)[:, None]
    cosine = 0.5 * (np.einsum('aij,bij->ab', T[:, :3, :3], T[:, :3, :3]) - 1.0)
    any_mover = np.arange(len(moves)) > 0
    return Survey(
        T,
        overlap,
        np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))),
        np.stack([target.share(moves), source.share(moves)]),
        np.stack([target.share(any_mover), source.share(any_mover)]),
        np.minimum(target.useful, source.useful),
    )


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
