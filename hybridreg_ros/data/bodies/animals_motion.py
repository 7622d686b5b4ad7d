# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""How four-legged animals move: gaits and gestures on one skeleton."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.bodies.rig import Pose

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hybridreg_ros.data.bodies.track import KeyFrames, Way

    F64 = NDArray[np.float64]


LOINS, RIBS, NECK_LOW, NECK_TOP, HEAD = range(5)
TAIL = (5, 6, 7)
LEGS = (8, 11, 14, 17)  # upper bones: fore left, fore right, hind left, hind right
PARENTS = (-1, 0, 1, 2, 3, 0, 5, 6, 1, 8, 9, 1, 11, 12, 0, 14, 15, 0, 17, 18)
GAITS = {
    'walk': (0.5, 0.0, 0.25, 0.75),
    'trot': (0.0, 0.5, 0.5, 0.0),
    'bound': (0.0, 0.1, 0.5, 0.6),
}


@dataclass(frozen=True, eq=False)
class AnimalMotion:
    """Pose of an animal as a function of the time.

    Attributes:
        keys: gestures (20, 3) of head, neck, tail and back, radians.
        stance: keys (3,) of x, y (metres) and turn (radians) for one that stays.
        track: path, or None for one that stays.
        start: (3,) first place, metres.
        heading_rad: first heading.
        speed_mps: speed along the track.
        cadence_hz: strides a second.
        swing: of the legs, radians.
        gait: phase of each leg in turns.
        ground: height of the ground at (x, y), or None for the height of `start`.
    """

    keys: KeyFrames
    stance: KeyFrames
    track: Way | None
    start: F64
    heading_rad: float
    speed_mps: float
    cadence_hz: float
    swing: float
    gait: tuple[float, float, float, float]
    ground: Callable[[float, float], float] | None = None

    def __call__(self, time_s: float) -> Pose:
        """Pose at a time, seconds."""
        angles = self.keys.at(time_s)
        shift = self.stance.at(time_s)
        if self.track is None:
            place, heading = self.start[:2] + shift[:2], self.heading_rad + float(shift[2])
        else:
            place, heading = self.track.at(self.speed_mps * time_s)
            angles = angles + self._cycle(time_s)
        z = self.start[2] if self.ground is None else self.ground(place[0], place[1])
        return Pose(angles, np.array([place[0], place[1], z]), heading)

    def _cycle(self, time_s: float) -> F64:
        """Angles (20, 3) of the gait."""
        angles = np.zeros((20, 3))
        turn = self.cadence_hz * time_s
        for k, (bone, offset) in enumerate(zip(LEGS, self.gait, strict=True)):
            p = 2.0 * np.pi * (turn + offset)
            lift = max(np.cos(p), 0.0)
            fold = 1.0 if k < 2 else -1.0
            angles[bone, 1] = -self.swing * np.sin(p)
            angles[bone + 1, 1] = fold * 1.5 * self.swing * lift
            angles[bone + 2, 1] = -fold * 0.7 * self.swing * lift + 0.4 * self.swing * lift
        beat = 2.0 * np.pi * turn
        angles[RIBS, 1] = 0.12 * self.swing * np.sin(2.0 * beat)
        angles[LOINS, 1] = 0.1 * self.swing * np.sin(beat)
        angles[NECK_LOW, 1] = 0.15 * self.swing * np.sin(2.0 * beat + 1.0)
        angles[TAIL[0], 2] = 0.4 * np.sin(2.0 * beat)
        return angles


def gesture_keys(rng: np.random.Generator, activity: str) -> F64:
    """Random gestures (48, 20, 3), radians."""
    keys = np.zeros((48, 20, 3))
    lively = 1.0 if activity in ('play', 'sit') else 0.45
    keys[:, [NECK_LOW, NECK_TOP, HEAD]] = rng.normal(0, lively, (48, 3, 3)) * [0.12, 0.35, 0.35]
    keys[:, TAIL] = rng.normal(0.0, 0.35, (48, 3, 3)) * [0.1, 0.8, 1.0]
    keys[:, RIBS] = rng.normal(0.0, 0.12 * lively, (48, 3))
    if activity == 'play':
        keys[:, LOINS, 1] = rng.normal(0.0, 0.3, 48)
        for bone in LEGS:
            keys[:, bone, 1] = rng.normal(0.0, 0.5, 48)
            keys[:, bone + 1, 1] = np.abs(rng.normal(0.0, 0.5, 48)) * (1 if bone < 12 else -1)
    if activity == 'sit':
        keys[:, LOINS, 1] = rng.uniform(-0.75, -0.5)
        for bone in LEGS[2:]:
            keys[:, bone, 1] = -0.9
            keys[:, bone + 1, 1] = 1.2
            keys[:, bone + 2, 1] = 0.5
        keys[:, LEGS[:2], 1] -= keys[:, [LOINS], 1]
        keys[:, NECK_LOW, 1] -= 0.6 * keys[:, LOINS, 1]
    return keys
