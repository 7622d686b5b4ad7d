# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""How people move: gait cycles and random gestures within joint limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.data.bodies.rig import Pose
from hybridreg_ros.data.bodies.track import KeyFrames, Way, loop_track

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

ACTIVITIES = ('walk', 'run', 'gesture', 'turn', 'reach', 'crouch', 'sit', 'dance', 'bend', 'lie')
BONES = 17
_LEFT = {'arm': 5, 'forearm': 6, 'hand': 7, 'thigh': 11, 'shin': 12, 'foot': 13}
_RIGHT = {'arm': 8, 'forearm': 9, 'hand': 10, 'thigh': 14, 'shin': 15, 'foot': 16}
_MIRROR = np.array([-1.0, 1.0, -1.0])

# Joint limits in degrees: roll, pitch, yaw (low, high) of the left side; the right is mirrored.
_LIMITS_DEG = {
    0: ((-15, 15), (-95, 60), (-180, 180)),
    1: ((-20, 20), (-15, 45), (-25, 25)),
    2: ((-18, 18), (-12, 40), (-30, 30)),
    3: ((-20, 20), (-20, 30), (-35, 35)),
    4: ((-20, 20), (-35, 35), (-45, 45)),
    5: ((-15, 150), (-170, 45), (-60, 60)),
    6: ((-5, 5), (-145, 0), (-60, 60)),
    7: ((-25, 25), (-50, 50), (-30, 30)),
    11: ((-15, 50), (-120, 30), (-30, 40)),
    12: ((0, 0), (0, 145), (0, 0)),
    13: ((-15, 15), (-25, 45), (-10, 10)),
}


def _limits() -> F64:
    """Limits (17, 3, 2), radians."""
    limits = np.zeros((BONES, 3, 2))
    for bone, ranges in _LIMITS_DEG.items():
        limits[bone] = np.deg2rad(ranges)
        if bone >= 5:
            limits[bone + 3] = np.sort(limits[bone] * _MIRROR[:, None], axis=1)
    return limits


LIMITS = _limits()


@dataclass(frozen=True, eq=False)
class HumanMotion:
    """Pose of a person as a function of the time: gait along a track plus key gestures.

    Attributes:
        keys: gestures, each (17, 3) radians, added to the gait.
        stance: keys (3,) of sideways x, y (metres) and turn (radians) about the place.
        track: path of the feet, or None for someone who stays.
        start: (3,) first place, metres.
        heading_rad: first heading.
        speed_mps: speed along the track.
        cadence_hz: double steps a second.
        stride: (4,) swing of hip, knee, arm and elbow, radians.
        phase: of the gait, radians.
        ground: height of the ground at (x, y), or None for the height of `start`.
    """

    keys: KeyFrames
    stance: KeyFrames
    track: Way | None
    start: F64
    heading_rad: float
    speed_mps: float
    cadence_hz: float
    stride: F64
    phase: float
    ground: Callable[[float, float], float] | None = None

    def __call__(self, time_s: float) -> Pose:
        """Pose at a time, seconds."""
        angles = self.keys.at(time_s)
        if self.speed_mps > 0.0:
            angles = angles + self.gait(time_s)
        angles = np.clip(angles, LIMITS[..., 0], LIMITS[..., 1])
        place, heading = self._place(time_s)
        z = self.start[2] if self.ground is None else self.ground(place[0], place[1])
        return Pose(angles, np.array([place[0], place[1], z]), heading)

    def _place(self, time_s: float) -> tuple[F64, float]:
        """Ground point (2,) and heading at a time."""
        shift = self.stance.at(time_s)
        if self.track is None:
            return self.start[:2] + shift[:2], self.heading_rad + float(shift[2])
        place, heading = self.track.at(self.speed_mps * time_s)
        return place, heading + 0.15 * float(shift[2])

    def gait(self, time_s: float) -> F64:
        """Angles (17, 3) of the walking or running cycle."""
        hip, knee, arm, elbow = self.stride
        cycle = 2.0 * np.pi * self.cadence_hz * time_s + self.phase
        angles = np.zeros((BONES, 3))
        for side, sign, p in ((_LEFT, 1.0, cycle), (_RIGHT, -1.0, cycle + np.pi)):
            swing = np.sin(p)
            lift = max(np.cos(p), 0.0) ** 1.5
            angles[side['thigh'], 1] = -hip * (swing + 0.25) - 0.35 * knee * lift
            angles[side['shin'], 1] = 0.12 + knee * lift + 0.15 * hip * (1.0 - swing)
            angles[side['foot'], 1] = 0.35 * hip * max(-swing, 0.0) - 0.25 * hip * max(swing, 0)
            angles[side['arm'], 1] = arm * np.sin(p)
            angles[side['arm'], 0] = sign * 0.08
            angles[side['forearm'], 1] = -elbow * (1.0 - 0.5 * np.sin(p))
        angles[0, 2] = 0.25 * hip * np.sin(cycle)
        angles[0, 0] = 0.06 * np.cos(cycle)
        angles[2, 2] = -0.35 * hip * np.sin(cycle)
        angles[1, 1] = 0.04 + 0.12 * elbow
        return angles


# Per activity: mean angles and spread in degrees of (bone, axis); the left side stands for both.
# Spread is the standard deviation of the keys. Axis 0 roll, 1 pitch, 2 yaw.
_GESTURES: dict[str, dict[tuple[int, int], tuple[float, float]]] = {
    'walk': {(5, 1): (0, 10), (6, 1): (-8, 12), (4, 2): (0, 20), (4, 1): (0, 10)},
    'run': {(5, 1): (0, 8), (6, 1): (-10, 8), (4, 2): (0, 10), (1, 1): (6, 3)},
    'gesture': {(5, 1): (-45, 50), (5, 0): (25, 30), (6, 1): (-55, 40), (5, 2): (0, 25),
                (4, 2): (0, 25), (2, 2): (0, 15), (1, 1): (6, 10), (11, 1): (-5, 8),
                (12, 1): (8, 8), (7, 1): (0, 20)},
    'turn': {(5, 1): (-15, 25), (6, 1): (-30, 25), (4, 2): (0, 30), (2, 2): (0, 20),
             (11, 1): (-6, 12), (12, 1): (10, 10)},
    'reach': {(5, 1): (-95, 50), (5, 0): (20, 25), (6, 1): (-25, 25), (1, 1): (15, 18),
              (2, 1): (12, 15), (2, 2): (0, 18), (11, 1): (-12, 15), (12, 1): (14, 12)},
    'crouch': {(11, 1): (-75, 40), (12, 1): (95, 45), (13, 1): (-20, 8), (1, 1): (22, 12),
               (2, 1): (12, 10), (5, 1): (-50, 35), (6, 1): (-45, 35), (11, 0): (10, 8)},
    'sit': {(11, 1): (-85, 7), (12, 1): (85, 14), (13, 1): (0, 8), (1, 1): (6, 14),
            (2, 1): (4, 12), (5, 1): (-45, 35), (6, 1): (-65, 35), (4, 2): (0, 30),
            (2, 2): (0, 16), (11, 0): (8, 8)},
    'dance': {(5, 1): (-70, 65), (5, 0): (50, 45), (6, 1): (-60, 45), (2, 0): (0, 14),
              (2, 2): (0, 22), (1, 1): (6, 14), (1, 0): (0, 12), (11, 1): (-25, 28),
              (12, 1): (35, 30), (11, 0): (12, 14), (0, 0): (0, 8), (4, 2): (0, 25)},
    'bend': {(1, 1): (28, 22), (2, 1): (22, 18), (0, 1): (18, 18), (11, 1): (-30, 20),
             (12, 1): (22, 20), (5, 1): (-55, 40), (6, 1): (-25, 25), (4, 1): (8, 14)},
    'lie': {(0, 1): (-86, 4), (11, 1): (-25, 25), (12, 1): (35, 30), (5, 1): (-30, 40),
            (5, 0): (30, 30), (6, 1): (-40, 35), (4, 2): (0, 25), (1, 1): (5, 8)},
}  # fmt: skip
# Wander of a standing person: x and y spread in metres, turn in degrees, seconds per key.
_STANCE = {
    'walk': (0.0, 25.0, 1.5), 'run': (0.0, 10.0, 1.0), 'gesture': (0.18, 30.0, 0.8),
    'turn': (0.18, 95.0, 1.0), 'reach': (0.22, 40.0, 1.0), 'crouch': (0.15, 30.0, 1.2),
    'sit': (0.04, 14.0, 1.0), 'dance': (0.32, 70.0, 0.55), 'bend': (0.2, 35.0, 1.1),
    'lie': (0.08, 25.0, 1.2),
}  # fmt: skip


def gesture_keys(rng: np.random.Generator, activity: str, count: int = 48) -> F64:
    """Random key poses (count, 17, 3), radians, of an activity."""
    keys = np.zeros((count, BONES, 3))
    together = rng.uniform(0.0, 0.9)
    for (bone, axis), (mean, spread) in _GESTURES[activity].items():
        common = rng.normal(0.0, 1.0, count)
        sides = ((bone, 1.0),) if bone < 5 else ((bone, 1.0), (bone + 3, float(_MIRROR[axis])))
        for place, sign in sides:
            own = rng.normal(0.0, 1.0, count)
            mix = together**0.5 * common + (1.0 - together) ** 0.5 * own
            keys[:, place, axis] = sign * np.deg2rad(mean + spread * mix)
    idle = np.deg2rad(4.0) * rng.normal(0.0, 1.0, (1, BONES, 3))
    idle[:, [0, 12, 15]] = 0.0
    arm_out = np.zeros((1, BONES, 3))
    arm_out[:, 5, 0], arm_out[:, 8, 0] = np.deg2rad([7.0, -7.0])
    poses: F64 = keys + idle + arm_out
    return poses


def _gait_scale(rng: np.random.Generator, speed: float, leg_m: float) -> tuple[float, F64]:
    """Cadence (double steps a second) and swings (4,) that fit a speed and leg length."""
    run = speed > 2.3
    cadence = float(np.clip(0.72 * (speed / max(leg_m, 0.3)) ** 0.5, 0.55, 1.7))
    half_stride = min(0.5 * speed / cadence / (1.6 if run else 1.0), 1.3 * leg_m)
    hip = float(np.clip(np.arcsin(np.clip(0.5 * half_stride / leg_m, 0.05, 0.8)), 0.12, 0.8))
    knee = rng.uniform(0.75, 1.05) * (1.7 if run else 1.0)
    arm = hip * rng.uniform(0.5, 1.4)
    elbow = rng.uniform(1.0, 1.6) if run else rng.uniform(0.1, 0.45)
    return cadence, np.array([hip, knee, arm, elbow])


def make_motion(  # noqa: PLR0913 - all but two are optional
    rng: np.random.Generator,
    activity: str,
    start: F64,
    heading_rad: float,
    *,
    leg_m: float,
    track: Way | None = None,
    reach_m: float = 1.2,
    speed_mps: float | None = None,
    ground: Callable[[float, float], float] | None = None,
) -> HumanMotion:
    """Build the motion of a person; see `humans.make_human` for the arguments.

    Raises:
        ConfigError: the activity is unknown.
    """
    if activity not in ACTIVITIES:
        raise ConfigError(f'activity: expected one of {", ".join(ACTIVITIES)}, found {activity!r}')
    walks = activity in ('walk', 'run')
    speed = 0.0
    if walks:
        usual = rng.uniform(2.4, 4.5) if activity == 'run' else rng.uniform(0.6, 1.7)
        speed = float(usual) if speed_mps is None else speed_mps
        track = track or loop_track(rng, start, heading_rad, reach_m)
    cadence, stride = _gait_scale(rng, speed, leg_m)
    spread, turn_deg, step = _STANCE[activity]
    shift = rng.normal(0.0, 1.0, (48, 3)) * [spread, spread, np.deg2rad(turn_deg)]
    step *= rng.uniform(0.75, 1.3)
    shift[0] = 0.0
    return HumanMotion(
        keys=KeyFrames(gesture_keys(rng, activity), step, rng.uniform(0.0, step)),
        stance=KeyFrames(shift, step),
        track=track if walks else None,
        start=start,
        heading_rad=heading_rad,
        speed_mps=speed,
        cadence_hz=cadence,
        stride=stride,
        phase=float(rng.uniform(0.0, 2.0 * np.pi)),
        ground=ground,
    )
