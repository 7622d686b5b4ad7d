# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One stage of HybridMatch: a room with movers, a camera, two times and surveyed views."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.hybridmatch_views import Survey, candidate_views, survey
from hybridreg_ros.data.raycast import Caster
from hybridreg_ros.data.rooms import make_room
from hybridreg_ros.data.rooms_motion import Stage, set_stage
from hybridreg_ros.data.sensors import random_camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.sensors import DepthCamera

KINDS = ('room', 'corridor', 'office', 'hall')
_KIND_SHARE = ((0.62, 0.08, 0.18, 0.12), (0.8, 0.05, 0.13, 0.02))
_THIN_M = (0.02, 0.027)
MIN_DISPLACEMENT_M = 0.25


@dataclass(frozen=True, eq=False)
class World:
    """One stage ready for taking pairs.

    Attributes:
        stage: room and movers.
        caster: rays into it.
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
) -> World | None:
    """Build a random stage and look through candidate views; None when no view is any good.

    Args:
        rng: source of everything random.
        crowded: much that moves, seen from near; otherwise a key figure with some company.
        wanted: share of moving points that the views should show.
        views: number of views to compare; several times as many are looked at.
    """
    room = make_room(rng, KINDS[rng.choice(len(KINDS), p=_KIND_SHARE[int(crowded)])])
    if crowded:
        people, animals = int(rng.integers(1, 6)), int(rng.integers(0, 3))
        flying, shifted = int(rng.integers(12, 31)), int(rng.integers(2, 10))
    else:
        company = int(rng.choice([0, 1, 2], p=[0.5, 0.25, 0.25]))
        people = 1 + company // 2
        animals = int(rng.integers(0, 1 + company))
        flying, shifted = int(rng.integers(4, 21)), int(rng.integers(0, 6))
    stage = set_stage(rng, room, people=people, animals=animals, flying=flying, shifted=shifted)
    looks = views * (4 if crowded else 2)
    poses = candidate_views(rng, stage, looks, crowded=crowded)
    if not poses:
        return None
    caster = Caster(stage.scene)
    camera = random_camera(rng).strided(rng.uniform(2.2, 3.2))
    if crowded and rng.random() < 0.6:
        camera = replace(camera, max_depth_m=float(rng.uniform(3.0, 4.5)))
    planes = np.arange(stage.background.plane.max() + 1)
    drop = rng.random(len(planes)) < 0.5
    drop[0] = False
    gone = drop[stage.background.plane]
    times, displacement = _times(rng, stage)
    thin = float(rng.uniform(*_THIN_M))
    look = survey(caster, camera, stage, poses, times, gone, thin, (views, *wanted))
    return World(stage, caster, camera, gone, times, look, thin, displacement)


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
