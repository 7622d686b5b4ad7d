# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One stage of HybridMatch: a room with movers, a camera, two times and surveyed views."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.hybridmatch.candidate_views import (
    MIN_USEFUL,
    Looker,
    Survey,
    candidate_views,
    compare,
    glance,
    promising,
)
from hybridreg_ros.data.meshes.raycast import Caster
from hybridreg_ros.data.pair import Label
from hybridreg_ros.data.rooms.furnished import make_room
from hybridreg_ros.data.rooms.motion import Stage, set_stage
from hybridreg_ros.data.sensors.depth_camera import random_camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.hybridmatch.cell import Cell
    from hybridreg_ros.data.meshes.scene import Mover
    from hybridreg_ros.data.sensors.depth_camera import DepthCamera

    F64 = NDArray[np.float64]

KINDS = ('room', 'corridor', 'office', 'hall')
_SLACK = 0.08
_SOME_STAND = 0.3
_KIND_SHARE = ((0.62, 0.08, 0.18, 0.12), (0.8, 0.05, 0.13, 0.02))
_THIN_M = (0.02, 0.027)
_REACH_M = (1.3, 3.0)
_SHORT_RANGES_M = (4.5, 3.8, 3.2, 2.7)
MIN_DISPLACEMENT_M = 0.25


@dataclass(frozen=True, eq=False)
class World:
    """One stage ready for taking pairs.

    Attributes:
        stage: room and movers.
        caster: rays into it, with what stands still standing.
        camera: the depth camera, all of one device.
        gone: (F,) static triangles whose points are removed.
        times_s: time of the target and of the source.
        view: what the candidate views share.
        thin_m: voxel of the thinned clouds.
        displacement_m: mean displacement of the key figure's vertices between both times.
    """

    stage: Stage
    caster: Caster
    camera: DepthCamera
    gone: NDArray[np.bool_]
    times_s: tuple[float, float]
    view: Survey
    thin_m: float
    displacement_m: float


def make_world(
    rng: np.random.Generator,
    *,
    crowded: bool = False,
    wanted: tuple[float, float] = (0.0, 1.0),
    views: int = 24,
    cell: Cell | None = None,
) -> World | None:
    """Build a random stage and look through candidate views; None when no view is any good.

    Args:
        rng: source of everything random.
        crowded: much that could move, seen from near; otherwise a key figure with some company.
        wanted: share of points on what could move that the views should show.
        views: number of views to compare; several times as many are looked at.
        cell: the cell that all pairs belong to, which says how much of what could move does;
            None lets everything move.
    """
    room = make_room(rng, KINDS[rng.choice(len(KINDS), p=_KIND_SHARE[int(crowded)])])
    reach = float(rng.uniform(*_REACH_M)) if crowded else _REACH_M[1]
    stage = set_stage(rng, room, **_company(rng, crowded=crowded), reach_m=reach)
    (first, second), displacement = _times(rng, stage)
    poses = candidate_views(rng, stage, views * (7 if crowded else 2), crowded=crowded)
    if len(poses) == 0 or (cell is not None and displacement <= MIN_DISPLACEMENT_M):
        return None
    caster = Caster(stage.scene)
    camera = random_camera(rng).strided(rng.uniform(2.2, 3.2))
    ranges = (camera.max_depth_m, *(_SHORT_RANGES_M if crowded else ()))
    planes = np.arange(stage.background.plane.max() + 1)
    drop = rng.random(len(planes)) < 0.5
    drop[0] = False
    gone = drop[stage.background.plane]
    thin = float(rng.uniform(*_THIN_M))
    look = Looker(camera, np.append(stage.background.plane, 0), np.append(gone, False), thin)
    T, look, fit = promising(look, caster, poses, second, (views, *wanted), ranges)
    if cell is not None and fit < 2:
        return None
    source = glance(look, caster, T, second)
    if cell is not None:
        fair = (source.useful > MIN_USEFUL) & _between(source.share(_movers(stage)), wanted)
        T, source = T[fair], source.rows(fair)
    moves = np.ones(len(stage.scene.movers), np.bool_)
    if cell is None and rng.random() < _SOME_STAND:
        moves[1:] = rng.random(len(moves) - 1) < rng.uniform(0.3, 0.9)
        caster = caster.halted(moves, second)
    elif cell is not None and cell.part:
        share = source.shares(len(moves))
        moves, displacement = _who_moves(rng, stage, share, (first, second), cell.dynamic)
        caster = caster.halted(moves, second)
    elif cell is not None and cell.frozen:
        moves[:] = False
    target = glance(look, caster, T, first) if moves.any() else source
    survey = compare(look, T, target, source, np.append(False, moves))
    return World(stage, caster, look.camera, gone, (first, second), survey, thin, displacement)


def _movers(stage: Stage) -> NDArray[np.bool_]:
    """Which instances (K + 1,) are movers."""
    return np.arange(len(stage.scene.movers) + 1) > 0


def _between(share: F64, limits: tuple[float, float]) -> NDArray[np.bool_]:
    """Which shares lie between limits, or so close that the other view may make up for it."""
    near: NDArray[np.bool_] = (share > limits[0] - _SLACK) & (share < limits[1] + _SLACK)
    return near


def _company(rng: np.random.Generator, *, crowded: bool) -> dict[str, int]:
    """How many people, animals, flying things and pieces of furniture move."""
    if crowded:
        people, animals = int(rng.integers(1, 6)), int(rng.integers(0, 3))
        flying, shifted = int(rng.integers(12, 31)), int(rng.integers(2, 10))
    else:
        company = int(rng.choice([0, 1, 2], p=[0.5, 0.25, 0.25]))
        people = 1 + company // 2
        animals = int(rng.integers(0, 1 + company))
        flying, shifted = int(rng.integers(4, 21)), int(rng.integers(0, 6))
    return {'people': people, 'animals': animals, 'flying': flying, 'shifted': shifted}


def _who_moves(
    rng: np.random.Generator,
    stage: Stage,
    share: F64,
    times_s: tuple[float, float],
    wanted: tuple[float, float],
) -> tuple[NDArray[np.bool_], float]:
    """A figure that gets far enough, and others in random order, up to a share of the points.

    Args:
        rng: source of the choice.
        stage: with K movers.
        share: (K,) share of the points that shows each mover while all stand.
        times_s: between which they move.
        wanted: lowest and highest share of moving points.

    Returns:
        Which movers (K,) move, and how far the figure's vertices get on average, metres; none and
        0 when no figure gets far enough.
    """
    movers = stage.scene.movers
    enough = float(rng.uniform(*wanted))
    moves = np.zeros(len(movers), np.bool_)
    order = rng.permutation(len(movers))
    figures = [k for k in order if movers[k].label == Label.DEFORMING]
    for k in sorted(figures, key=lambda k: bool(share[k] > enough)):
        apart = displacement_m(movers[k], *times_s)
        if apart > MIN_DISPLACEMENT_M:
            moves[k] = True
            break
    else:
        return moves, 0.0
    total = float(share[moves].sum())
    for k in order:
        if not moves[k] and total + share[k] <= enough:
            moves[k] = True
            total += float(share[k])
    return moves, apart


def displacement_m(mover: Mover, first_s: float, second_s: float) -> float:
    """Mean displacement of the vertices of a mover between two times, metres."""
    a, b = mover.mesh_at(first_s).vertices, mover.mesh_at(second_s).vertices
    return float(np.linalg.norm(b - a, axis=1).mean())


def _times(rng: np.random.Generator, stage: Stage) -> tuple[tuple[float, float], float]:
    """Two times between which the key figure's vertices move by more than 0.25 m on average.

    Returns:
        Both times, seconds, and the mean displacement, metres.
    """
    start = float(rng.uniform(0.0, 20.0))
    step = float(rng.uniform(0.1, 1.2))
    if not stage.scene.movers:
        return (start, start + step), 0.0
    key = stage.scene.movers[0]
    first = key.mesh_at(start).vertices
    apart = 0.0
    for _ in range(12):
        apart = float(np.linalg.norm(key.mesh_at(start + step).vertices - first, axis=1).mean())
        if apart > MIN_DISPLACEMENT_M:
            break
        step += float(rng.uniform(0.2, 0.6))
    return (start, start + step), apart
