# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated sequences: a sensor moves through a dynamic scene; true poses and labels."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.data.meshes.geometry import look_at
from hybridreg_ros.data.meshes.raycast import Caster
from hybridreg_ros.data.rooms.furnished import make_room
from hybridreg_ros.data.rooms.motion import set_stage
from hybridreg_ros.data.sensors.depth_camera import DepthCamera, DepthNoise
from hybridreg_ros.data.sequences.camera_path import at_speed, choose_gaze, walk, walkable
from hybridreg_ros.data.sequences.frame import SHARES, SimulatedFrame, miss

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

_LOG = logging.getLogger(__name__)

CAMERA_FRAME = 'camera_depth_optical_frame'


def simulate(
    scene: str,
    frames: int,
    rate_hz: float = 10.0,
    seed: int = 0,
    *,
    dynamic: str = '10-30',
    size: tuple[int, int] = (320, 240),
) -> Iterator[SimulatedFrame]:
    """Simulate a sequence; the same seed gives the same frames.

    Args:
        scene: 'room' (depth camera, carried by hand) or 'street' (spinning lidar on a vehicle).
        frames: number of frames.
        rate_hz: frames per second.
        seed: of everything random.
        dynamic: share of moving points aimed at: 'none', '10-30' or '30-50' percent.
        size: width and height of the depth image; a street ignores it.

    Raises:
        ConfigError: an argument is outside its range.
    """
    if scene not in ('room', 'street'):
        raise ConfigError(f'scene: expected room or street, found {scene!r}')
    if dynamic not in SHARES:
        raise ConfigError(f'dynamic: expected one of {", ".join(SHARES)}, found {dynamic!r}')
    if frames < 1:
        raise ConfigError(f'frames: expected at least 1, found {frames}')
    if not 0.1 <= rate_hz <= 100.0:
        raise ConfigError(f'rate_hz: expected 0.1 to 100, found {rate_hz}')
    if min(size) < 16 or max(size) > 4096:
        raise ConfigError(f'size: expected 16 to 4096 pixels a side, found {size}')
    times = np.arange(frames) / rate_hz
    if scene == 'room':
        return _room_frames(times, seed, dynamic, size)
    from hybridreg_ros.data.sequences.street import street_frames

    return street_frames(times, rate_hz, seed, dynamic)


@dataclass(frozen=True, eq=False)
class Walk:
    """A camera walk through a stage.

    Attributes:
        caster: the scene.
        camera: what is carried.
        poses: (N, 4, 4) T_world_camera of each frame.
        share: expected share of moving points.
        loss: (F,) share of lost rays per static triangle.
    """

    caster: Caster
    camera: DepthCamera
    poses: F64
    share: float
    loss: NDArray[np.float32]


def _room_frames(
    times: F64, seed: int, dynamic: str, size: tuple[int, int]
) -> Iterator[SimulatedFrame]:
    walk_ = plan_walk(times, seed, dynamic, size)
    for k, (time_s, T) in enumerate(zip(times, walk_.poses, strict=True)):
        rng = np.random.default_rng([seed, 11, k])
        image = walk_.camera.render(walk_.caster, float(time_s), T, rng, loss=walk_.loss)
        points = walk_.camera.points(image.depth).reshape(-1, 3)
        yield SimulatedFrame(
            points,
            (walk_.camera.height, walk_.camera.width),
            None,
            float(time_s),
            T,
            image.label.reshape(-1),
            image.instance.reshape(-1),
            CAMERA_FRAME,
        )


def plan_walk(times: F64, seed: int, dynamic: str, size: tuple[int, int]) -> Walk:
    """The best of a few random rooms and walks for the share of moving points asked for.

    Raises:
        ConfigError: no room of this seed has space to walk.
    """
    wanted = SHARES[dynamic]
    best: Walk | None = None
    for attempt in range(10):
        candidate = _try_walk(times, np.random.default_rng([seed, 10, attempt]), dynamic, size)
        if candidate is None:
            continue
        if best is None or miss(candidate.share, wanted) < miss(best.share, wanted):
            best = candidate
        if miss(best.share, wanted) == 0.0:
            break
    if best is None:
        raise ConfigError(
            f'no unobstructed path through the rooms of seed {seed}: choose another seed'
        )
    _LOG.info('walk of seed %d: about %.0f %% moving points', seed, 100.0 * best.share)
    return best


def _try_walk(
    times: F64, rng: np.random.Generator, dynamic: str, size: tuple[int, int]
) -> Walk | None:
    """One random room and walk; None when there is no space."""
    room = make_room(rng, str(rng.choice(['room', 'room', 'office'])))
    people, animals, flying, shifted = {
        'none': (0, 0, 0, 0),
        '10-30': (int(rng.integers(1, 4)), int(rng.integers(0, 2)), 4, 2),
        '30-50': (int(rng.integers(3, 7)), int(rng.integers(0, 3)), 14, 4),
    }[dynamic]
    stage = set_stage(rng, room, people=people, animals=animals, flying=flying, shifted=shifted)
    height = float(rng.uniform(1.0, 1.5))
    speed = float(rng.uniform(0.5, 0.9))
    reach = {'none': (0.0, 6.0), '10-30': (1.0, 3.5), '30-50': (0.8, 2.5)}[dynamic]
    free = walkable(stage, height, 0.25)
    path = walk(rng, room.floor, free, stage.key[:2], reach, speed * float(times[-1]))
    if path is None:
        return None
    caster = Caster(stage.scene)
    camera = _carried(rng, size)
    return Walk(
        caster,
        camera,
        *_poses(rng, caster, camera, at_speed(path, speed, times), times, height, SHARES[dynamic]),
        stage.background.loss,
    )


def _carried(rng: np.random.Generator, size: tuple[int, int]) -> DepthCamera:
    """A usual depth camera with usual noise."""
    noise = DepthNoise(
        base_m=0.001,
        quadratic=float(rng.uniform(0.0008, 0.0018)),
        disparity=1500.0,
        warp=float(rng.uniform(0.0, 0.002)),
        grazing=0.15,
        edge_loss=0.4,
        flying=0.02,
        ragged=0.2,
        patchy=0.01,
        seed=int(rng.integers(2**31)),
    )
    full = DepthCamera(min_depth_m=0.3, max_depth_m=6.0, noise=noise)
    camera = full.strided(640 / size[0])
    if camera.height != size[1]:
        camera = replace(camera, height=size[1], cy=0.5 * size[1] - 0.5)
    return camera


def _poses(
    rng: np.random.Generator,
    caster: Caster,
    camera: DepthCamera,
    places: F64,
    times: F64,
    height: float,
    wanted: tuple[float, float],
) -> tuple[F64, float]:
    """Poses (N, 4, 4) along places (N, 2), and the expected share of moving points."""
    pitch = float(rng.uniform(-0.35, -0.1))
    every = np.arange(0.0, times[-1] + 0.5, 0.5)
    knots = np.stack([np.interp(every, times, places[:, k]) for k in (0, 1)], axis=1)
    eyes = np.column_stack([knots, np.full(len(every), height)])
    yaw, share = choose_gaze(
        caster, eyes, every, pitch, (camera.min_depth_m, camera.max_depth_m), wanted
    )
    padded = np.pad(yaw, 2, mode='edge')
    smooth = np.convolve(padded, [0.1, 0.2, 0.4, 0.2, 0.1], mode='valid')
    look = np.interp(times, every, smooth)
    phase = rng.uniform(0.0, 2.0 * np.pi, 4)
    poses = []
    for place, angle, t in zip(places, look, times, strict=True):
        wobble = np.sin(2.0 * np.pi * np.array([1.7, 0.31, 0.23, 0.41]) * t + phase)
        eye = np.array([*place, height + 0.012 * wobble[0]])
        tilt = pitch + 0.04 * wobble[1]
        ahead = [np.cos(angle + 0.05 * wobble[2]), np.sin(angle + 0.05 * wobble[2]), np.tan(tilt)]
        poses.append(look_at(eye, eye + np.array(ahead), 0.03 * wobble[3]))
    return np.stack(poses), share
