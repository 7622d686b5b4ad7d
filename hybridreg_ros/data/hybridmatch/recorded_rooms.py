# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Room pairs as recorded: images of a depth camera that is carried through a room with people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.bodies.humans import human_rig
from hybridreg_ros.data.bodies.movers import RigidMover, make_door, make_human
from hybridreg_ros.data.bodies.track import KeyFrames
from hybridreg_ros.data.hybridmatch.recorded import (
    GAP_S,
    MOVED_M,
    PAIRS_A_SCENE,
    Bodies,
    Kind,
    Shot,
    recorded_samples,
    shot_times,
    unit_shares,
    who_moves,
    with_standing,
)
from hybridreg_ros.data.meshes.geometry import look_at, voxel_thin
from hybridreg_ros.data.meshes.raycast import Caster
from hybridreg_ros.data.rooms.furnished import make_room
from hybridreg_ros.data.rooms.motion import Path, Stage, set_stage
from hybridreg_ros.data.sensors.depth_camera import random_camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.hybridmatch.recorded import Unit
    from hybridreg_ros.data.hybridmatch.take import Sample
    from hybridreg_ros.data.meshes.scene import Mover
    from hybridreg_ros.data.rooms.furnished import Room
    from hybridreg_ros.data.sensors.depth_camera import DepthCamera

    F64 = NDArray[np.float64]

KIND = Kind('room-recorded', 0.05, 0.03, 0.25)
_MOST_MOVING = 0.15
_ROOMS, _ROOM_SHARE = ('room', 'corridor', 'office', 'hall'), (0.35, 0.12, 0.28, 0.25)
_THIN_M = 0.0125
_NEAR_KEY_M = 3.0
_TRIES, _LOOKS = 64, 10
_FREE_M, _CLEAR_M = 0.35, 0.4
_FARTHEST_M, _SPEED_MPS = 3.0, (0.2, 1.2)
_STAYS_SHARE = 0.15
_COARSE_PIXELS = 40
_LEAST_VALID, _FEW_MOVING = 0.5, (0.03, 0.25)


@dataclass(frozen=True, eq=False)
class _Walk:
    """A camera carried by hand along a straight line.

    Attributes:
        eyes: (2, 3) first and last place.
        aims: (2, 3) what it looks at there.
        tremble: (6, 3) amplitude (metres, radians), rate (rad/s) and phase of the small motions.
        start_s: time of the first place.
        last_s: seconds until the last one.
    """

    eyes: F64
    aims: F64
    tremble: F64
    start_s: float
    last_s: float

    def pose_at(self, time_s: float) -> F64:
        """T_world_camera (4, 4) at a time."""
        share = (time_s - self.start_s) / self.last_s
        eye, aim = ((1.0 - share) * a + share * b for a, b in (self.eyes, self.aims))
        move = self.tremble[:, 0] * np.sin(self.tremble[:, 1] * time_s + self.tremble[:, 2])
        away = float(np.linalg.norm(aim - eye))
        aim = aim + away * np.array([move[3], move[4], move[5]])
        return look_at(eye + move[:3], aim, float(move[3]))


def recorded_room(seed: int, count: int = PAIRS_A_SCENE) -> list[Sample]:
    """Pairs of a few images of one random walk, at most `count`; none where there is no way.

    Args:
        seed: of everything.
        count: most pairs.
    """
    rng = np.random.default_rng([seed, 6])
    room = make_room(rng, str(rng.choice(_ROOMS, p=_ROOM_SHARE)))
    more = _pushed(rng, room) + _doors(rng, room)
    stage = set_stage(
        rng,
        room,
        people=int(rng.integers(1, 6)),
        animals=int(rng.random() < 0.2),
        shifted=int(rng.integers(0, 4)),
        reach_m=float(rng.uniform(1.0, 5.0)),
    )
    more += _walkers(rng, stage)
    units: list[Unit] = [(mover,) for mover in (*stage.scene.movers, *more)]
    camera = random_camera(rng).strided(float(rng.uniform(1.6, 2.8)))
    caster = Caster(stage.scene).peopled(tuple(unit[0] for unit in units))
    walk = _walk(rng, stage, caster, camera)
    if walk is None:
        return []
    times = walk.start_s + shot_times(rng, walk.last_s)
    caster = _peopled(rng, caster, camera, walk, units, times)
    loss = stage.background.loss
    shots = [_shot(rng, caster, camera, walk.pose_at(t), t, loss) for t in times.tolist()]
    return recorded_samples(rng, KIND, seed, shots, caster.scene.movers, count)


def _pushed(rng: np.random.Generator, room: Room) -> list[Mover]:
    """Chairs and the like that somebody pushes about; they leave what stands in the room."""
    movers: list[Mover] = []
    for _ in range(int(rng.choice([0, 1, 2], p=[0.5, 0.3, 0.2]))):
        low = [k for k, thing in enumerate(room.movable) if thing.at[2] < 0.05]
        if not low:
            break
        thing = room.movable.pop(int(rng.choice(low)))
        size = rng.uniform(0.0, 1.0, (8, 4)) * [0.5, 0.5, 0.0, 0.8]
        sign = np.where(np.arange(8)[:, None] % 2 == 0, 1.0, -1.0)
        step_s = float(rng.uniform(0.8, 2.0))
        keys = KeyFrames(size * sign, step_s, float(rng.uniform(0.0, step_s)))
        movers.append(RigidMover(thing.mesh, Path(thing.at, thing.yaw_rad, keys), 'pushed'))
    return movers


def _walkers(rng: np.random.Generator, stage: Stage) -> list[Mover]:
    """People who walk about near the key figure."""
    movers: list[Mover] = []
    spots = stage.room.floor.clear_spots(0.3)
    spots = spots[np.linalg.norm(spots - stage.key[:2], axis=1) < _NEAR_KEY_M]
    for _ in range(int(rng.integers(1, 4)) if len(spots) else 0):
        start = np.array([*spots[rng.integers(len(spots))], 0.0])
        movers.append(
            make_human(
                rng,
                start,
                float(rng.uniform(0.0, 6.3)),
                activity='walk',
                reach_m=float(rng.uniform(0.6, 2.0)),
                rig=human_rig(rng, coarse=True),
            )
        )
    return movers


def _doors(rng: np.random.Generator, room: Room) -> list[Mover]:
    """Doors that swing at the walls."""
    movers: list[Mover] = []
    corners = room.plan.outline
    for _ in range(int(rng.choice([0, 1, 2], p=[0.5, 0.35, 0.15]))):
        k = int(rng.integers(len(corners)))
        a, b = corners[k], corners[(k + 1) % len(corners)]
        along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
        hinge = a + rng.uniform(0.1, 0.9) * (b - a) + 0.06 * np.array([-along[1], along[0]])
        heading = float(np.arctan2(along[1], along[0]))
        movers.append(make_door(rng, np.array([*hinge, 0.01]), heading))
    return movers


def _walk(
    rng: np.random.Generator, stage: Stage, caster: Caster, camera: DepthCamera
) -> _Walk | None:
    """The first of a few free ways whose views are good, or the best; None when none is free."""
    start_s = float(rng.uniform(0.0, 20.0))
    ways = _free_ways(rng, stage, caster, start_s)
    focus = np.array([*stage.room.focus, stage.key])
    best: tuple[float, _Walk] | None = None
    for way in ways:
        stays = rng.random() < _STAYS_SHARE
        first = stage.key if rng.random() < 0.75 else focus[rng.integers(len(focus))]
        first = first + rng.normal(0.0, 0.4, 3)
        second = first + rng.normal(0.0, 0.4, 3)
        speed = float(rng.uniform(*_SPEED_MPS))
        far = float(np.linalg.norm(way[1] - way[0]))
        last = float(rng.uniform(1.0, GAP_S[1]) if stays else np.clip(far / speed, 0.5, GAP_S[1]))
        size = np.array([0.012, 0.012, 0.012, 0.02, 0.02, 0.02]) * rng.uniform(0.2, 1.2, 6)
        tremble = np.stack([size, rng.uniform(1.0, 9.0, 6), rng.uniform(0.0, 6.3, 6)], axis=1)
        walk = _Walk(
            way[[0, 0]] if stays else way, np.stack([first, second]), tremble, start_s, last
        )
        miss = _miss(caster, camera, walk)
        if best is None or miss < best[0]:
            best = miss, walk
        if miss == 0.0:
            break
    return None if best is None or best[0] >= 1.0 else best[1]


def _free_ways(rng: np.random.Generator, stage: Stage, caster: Caster, start_s: float) -> F64:
    """First and last places (W, 2, 3) of ways on which the camera meets nothing."""
    spots = stage.room.floor.clear_spots(_FREE_M, 0.4)
    if len(spots) < 2:
        return np.zeros((0, 2, 3))
    ends = spots[rng.integers(len(spots), size=(_TRIES, 2))]
    run = ends[:, 1] - ends[:, 0]
    far = np.linalg.norm(run, axis=1)
    shorter = np.minimum(1.0, rng.uniform(0.3, _FARTHEST_M, _TRIES) / np.maximum(far, 1e-6))
    ends[:, 1] = ends[:, 0] + run * shorter[:, None]
    height = np.clip(rng.uniform(0.6, 1.7), 0.3, stage.room.plan.height_m - 0.3)
    eyes = np.dstack([ends, np.full((_TRIES, 2), height)])
    run = eyes[:, 1] - eyes[:, 0]
    far = np.linalg.norm(run, axis=1)
    ok = far > 0.1
    eyes, run, far = eyes[ok], run[ok], far[ok]
    hits = caster.cast(
        start_s, eyes[:, 0].astype(np.float32), (run / far[:, None]).astype(np.float32)
    )
    free: F64 = eyes[hits.distance > far + _FREE_M][:_LOOKS]
    return free


def _miss(caster: Caster, camera: DepthCamera, walk: _Walk) -> float:
    """How far the views at both ends of a walk are from good ones; 1 or more = of no use."""
    valid, moving = [], []
    for time_s in (walk.start_s, walk.start_s + walk.last_s):
        depth, instance = _glance(caster, camera, walk, time_s)
        near = (depth > camera.min_depth_m) & (depth < camera.max_depth_m)
        valid.append(float(near.mean()))
        moving.append(float((instance[near] > 0).mean()) if near.any() else 0.0)
    share = max(moving)
    low, high = _FEW_MOVING
    return max(low - share, share - high, 0.0) + 1.0 * (min(valid) < _LEAST_VALID)


def _glance(
    caster: Caster, camera: DepthCamera, walk: _Walk, time_s: float
) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
    """Depth (R,) and instance (R,) of a small image without faults."""
    small = camera.strided(camera.width / _COARSE_PIXELS)
    T = walk.pose_at(time_s)
    rays = small.rays.reshape(-1, 3)
    length = np.linalg.norm(rays, axis=1)
    world = (rays / length[:, None]) @ T[:3, :3].T
    trace = caster.trace(time_s, T[:3, 3].astype(np.float32), world.astype(np.float32))
    return (trace.distance / length).astype(np.float32), trace.instance


def _peopled(
    rng: np.random.Generator,
    caster: Caster,
    camera: DepthCamera,
    walk: _Walk,
    units: list[Unit],
    times: F64,
) -> Caster:
    """The room with its movers, of which about half stand; none meets the camera."""
    places = np.stack([walk.pose_at(t)[:3, 3] for t in times.tolist()])
    stand_s = rng.uniform(times[0], times[-1], len(units))
    may = np.ones((len(units), 2), np.bool_)
    for k, unit in enumerate(units):
        bodies = Bodies(unit)
        may[k, 0] = bodies.away_m(0, float(stand_s[k]), places) > _CLEAR_M
        may[k, 1] = bodies.moved_m(0, float(times[0]), float(times[-1])) > MOVED_M
        for time_s, place in zip(times.tolist(), places, strict=True):
            may[k, 1] &= bodies.away_m(0, time_s, place[None]) > _CLEAR_M
    share = np.zeros(len(units))
    for time_s in (float(times[0]), float(times[-1])):
        depth, instance = _glance(caster, camera, walk, time_s)
        near = (depth > camera.min_depth_m) & (depth < camera.max_depth_m)
        share = np.maximum(share, unit_shares(units, instance[near], int(near.sum())))
    kept, moves = who_moves(rng, units, share, may, _MOST_MOVING)
    return caster.peopled(with_standing(units, kept, moves, stand_s))


def _shot(
    rng: np.random.Generator,
    caster: Caster,
    camera: DepthCamera,
    T: F64,
    time_s: float,
    loss: NDArray[np.float32],
) -> Shot:
    """One image as a cloud."""
    image = camera.render(caster, time_s, T, rng, loss=loss)
    kept = np.isfinite(image.depth) & np.isfinite(image.clean)
    points, true = camera.points_of(kept, image.depth, image.clean)
    rows = voxel_thin(points, _THIN_M)
    sigma = camera.noise.sigma_m(points[rows, 2]).astype(np.float32)
    return Shot(points[rows], true[rows], image.instance[kept][rows], sigma, T, time_s)
