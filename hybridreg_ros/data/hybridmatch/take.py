# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Taking one pair of a stage: choose views, take clouds, measure what they share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.se3 import apply, exp, inverse
from hybridreg_ros.data.hybridmatch.candidate_views import MIN_USEFUL
from hybridreg_ros.data.hybridmatch.truth import Truth
from hybridreg_ros.data.meshes.geometry import voxel_thin
from hybridreg_ros.data.pair import Label, PointPair

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.hybridmatch.candidate_views import Survey
    from hybridreg_ros.data.hybridmatch.cell import Cell
    from hybridreg_ros.data.hybridmatch.stage import World
    from hybridreg_ros.data.sensors.depth_camera import DepthCamera, DepthImage

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

VOXEL_SIZE_M = 0.05
_MIN_POINTS = 2000
_MAX_POINTS = 15000
_MIN_STATIC_SHARED = 300
_TURNS_DEG = (10.0, 20.0, 35.0)
_MARGIN = 0.015


@dataclass(frozen=True, eq=False)
class _Cloud:
    """A thinned cloud in the frame of its first image, and the images it was made of."""

    points: F32
    true: F32
    label: NDArray[np.uint8]
    instance: NDArray[np.uint16]
    images: list[tuple[F64, DepthImage]]


@dataclass(frozen=True, eq=False)
class Sample:
    """A pair with what else its generator knows of it.

    Attributes:
        pair: the pair.
        displacement_m: mean displacement of the key figure's vertices between both clouds.
        still: (K, 3) float32 the target as it looks while everything stands as in the source,
            target sensor frame; None unless asked for.
        truth: how it came about.
    """

    pair: PointPair
    displacement_m: float
    truth: Truth
    still: F32 | None = None


def take_sample(
    rng: np.random.Generator,
    world: World,
    cell: Cell,
    views: tuple[int, int],
    *,
    still: bool = False,
) -> Sample | None:
    """Take the pair of two views (source, target); None when it does not suit the cell.

    Args:
        rng: source of the noise.
        world: the scene.
        cell: what the pair must be.
        views: rows of the views of the source and of the target.
        still: take the target without motion, too.
    """
    t_target, t_source = world.times_s
    if cell.frozen:
        t_target = t_source
    poses = world.view.poses
    i, j = views
    source = _cloud(rng, world, poses[i], t_source, cell)
    target = _cloud(rng, world, poses[j], t_target, cell)
    if min(len(source.points), len(target.points)) < _MIN_POINTS:
        return None
    T = inverse(poses[j]) @ poses[i]
    seen = _seen(world.camera, source, target, T)
    static = int((source.label == Label.STATIC).sum())
    overlap = float(seen.sum()) / max(static, 1)
    moving = (source.label > 0).sum() + (target.label > 0).sum()
    share = float(moving) / (len(source.label) + len(target.label))
    low, high = cell.overlap
    fits = low < overlap < high and overlap * static > _MIN_STATIC_SHARED
    if not fits or not (cell.frozen or cell.dynamic[0] <= share <= cell.dynamic[1]):
        return None
    pair = PointPair(
        source.points,
        target.points,
        T,
        source.label,
        target.label,
        source.instance,
        target.instance,
        overlap,
        share,
        VOXEL_SIZE_M,
    )
    if not still:
        twin = None
    elif cell.frozen:
        twin = target.points
    else:
        twin = _cloud(rng, world, poses[j], t_source, cell).points
    sigma = world.camera.noise.sigma_m(source.points[:, 2]).astype(np.float32)
    truth = Truth(world.stage.scene.movers, (t_source, t_target), poses[i], sigma, seen)
    return Sample(pair, 0.0 if cell.frozen else world.displacement_m, truth, twin)


def choose_views(
    rng: np.random.Generator, view: Survey, cell: Cell, count: int
) -> list[tuple[int, int]]:
    """Different random pairs of views whose coarse overlap and moving share suit a cell.

    Pairs that repeat a source view, or a pair the other way round, come last.
    """
    low, high = cell.overlap
    fits = (view.overlap > low + _MARGIN) & (view.overlap < high - _MARGIN)
    useful = view.useful > MIN_USEFUL
    fits &= useful[:, None] & useful[None, :]
    np.fill_diagonal(fits, False)
    # What the few rays of a survey show is a little off: keep away from the limits.
    limits = [(view.dynamic, cell.dynamic)] if not cell.frozen else []
    limits += [(view.crowd, cell.crowd)] if cell.crowd is not None else []
    for seen, (least, most) in limits:
        share = 0.5 * (seen[1][:, None] + seen[0][None, :])
        fits &= (share >= least + _MARGIN) & (share <= most - _MARGIN)
    i, j = np.nonzero(fits)
    if len(i) == 0:
        return []
    # Even over the overlap, and there over the turn, with fewer of the smallest turns: rare views
    # are as likely as frequent ones.
    overlap_bin = np.minimum((view.overlap[i, j] * 10).astype(int), 9)
    both = overlap_bin * (len(_TURNS_DEG) + 1) + np.digitize(view.turn_deg[i, j], _TURNS_DEG)
    of, bin_of, number = np.unique(both, return_inverse=True, return_counts=True)
    turns = np.bincount(of // (len(_TURNS_DEG) + 1), minlength=10)
    weight = 1.0 / (number[bin_of] * turns[overlap_bin])
    weight[view.turn_deg[i, j] < _TURNS_DEG[0]] *= 0.5
    # Exponential keys: a weighted order whose beginning does not depend on `count`.
    rows = np.argsort(rng.exponential(size=len(i)) / weight, kind='stable')
    fresh: list[tuple[int, int]] = []
    again: list[tuple[int, int]] = []
    for a, b in zip(i[rows].tolist(), j[rows].tolist(), strict=True):
        known = any(a == c or (b, a) == (c, d) for c, d in fresh)
        (again if known else fresh).append((a, b))
    return (fresh + again)[:count]


def _cloud(
    rng: np.random.Generator, world: World, T_world_camera: F64, time_s: float, cell: Cell
) -> _Cloud:
    """Take one cloud: one image, or a few of nearby views fused in the frame of the first."""
    count = int(rng.integers(2, cell.fused + 1)) if rng.random() < cell.fusing else 1
    images: list[tuple[F64, DepthImage]] = []
    parts = []
    for k in range(count):
        T_base_view = np.eye(4) if k == 0 else _nearby(rng)
        image = world.camera.render(
            world.caster,
            time_s,
            T_world_camera @ T_base_view,
            rng,
            loss=world.stage.background.loss,
        )
        images.append((T_base_view, image))
        drift = T_base_view if k == 0 else T_base_view @ _small_motion(rng, 0.004, 0.003)
        parts.append(_points(world, image, drift))
    points, true, label, instance = (np.concatenate(p) for p in zip(*parts, strict=True))
    if cell.frozen:
        label, instance = np.zeros_like(label), np.zeros_like(instance)
    voxel_m = world.thin_m
    rows = voxel_thin(points, voxel_m)
    while len(rows) > _MAX_POINTS:
        voxel_m *= max(1.1, float(np.sqrt(len(rows) / _MAX_POINTS)))
        rows = voxel_thin(points, voxel_m)
    return _Cloud(points[rows], true[rows], label[rows], instance[rows], images)


def _points(
    world: World, image: DepthImage, T_base_view: F64
) -> tuple[F32, F32, NDArray[np.uint8], NDArray[np.uint16]]:
    """Measured points, true points, labels and instances of an image, base frame."""
    removed = np.append(world.gone, False)[image.face]
    kept = np.isfinite(image.depth) & ~removed
    measured, true = world.camera.points_of(kept, image.depth, image.clean)
    return (
        apply(T_base_view, measured).astype(np.float32),
        apply(T_base_view, true).astype(np.float32),
        image.label[kept],
        image.instance[kept],
    )


def _nearby(rng: np.random.Generator) -> F64:
    """A camera motion between two images that are fused."""
    return _small_motion(rng, 0.15, float(rng.uniform(0.05, 0.35)))


def _small_motion(rng: np.random.Generator, shift_m: float, turn_rad: float) -> F64:
    turn = rng.normal(0.0, turn_rad, 3) * [0.6, 1.0, 0.25]
    return exp(np.concatenate([rng.normal(0.0, shift_m, 3), turn]))


def _seen(
    camera: DepthCamera, source: _Cloud, target: _Cloud, T_target_source: F64
) -> NDArray[np.bool_]:
    """Which source points (N,) are static and shown by an image of the target, by true depth."""
    static = source.label == Label.STATIC
    true = apply(T_target_source, source.true[static].astype(np.float64)).astype(np.float64)
    shown = np.zeros(len(true), np.bool_)
    frozen = not target.label.any()
    for T_base_view, image in target.images:
        local = apply(inverse(T_base_view), true).astype(np.float64)
        background = np.ones_like(image.clean, np.bool_) if frozen else image.label == 0
        shown |= visible(camera, local, image.clean, background)
    seen = np.zeros(len(static), np.bool_)
    seen[static] = shown
    return seen


def visible(
    camera: DepthCamera, points: F64, clean: F32, background: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which points (N, 3), optical frame, lie on the background surface of a true depth image."""
    z = points[:, 2]
    inside = (z > camera.min_depth_m) & (z < camera.max_depth_m)
    safe = np.maximum(z, 1e-3)
    u = points[:, 0] / safe * camera.fx + camera.cx
    v = points[:, 1] / safe * camera.fy + camera.cy
    seen = np.zeros(len(points), np.bool_)
    tolerance = 0.02 + 0.01 * z
    for du in (0, 1):
        for dv in (0, 1):
            col, row = np.floor(u).astype(np.int64) + du, np.floor(v).astype(np.int64) + dv
            ok = inside & (col >= 0) & (col < camera.width) & (row >= 0) & (row < camera.height)
            pixel = np.where(ok, row * camera.width + col, 0)
            near = np.abs(clean.reshape(-1)[pixel] - z) < tolerance
            seen |= ok & near & background.reshape(-1)[pixel]
    return seen
