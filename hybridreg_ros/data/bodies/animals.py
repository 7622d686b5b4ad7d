# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Procedural four-legged animals: dogs, cats, horses, deer, sheep and what lies between."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.data.bodies.animals_motion import (
    GAITS,
    HEAD,
    LEGS,
    LOINS,
    NECK_LOW,
    NECK_TOP,
    PARENTS,
    RIBS,
    TAIL,
    AnimalMotion,
    gesture_keys,
)
from hybridreg_ros.data.bodies.loft import assemble, ball, loft
from hybridreg_ros.data.bodies.rig import Rig, SkinnedMover
from hybridreg_ros.data.bodies.track import KeyFrames, Way, loop_track

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hybridreg_ros.data.bodies.rig import Part

    F64 = NDArray[np.float64]

ACTIVITIES = ('walk', 'trot', 'bound', 'play', 'sit')


@dataclass(frozen=True)
class Shape:
    """Proportions of a kind of animal, in units of its shoulder height unless said.

    Attributes:
        shoulder_m: low and high shoulder height, metres.
        length: low and high body length.
        girth: half width of the chest.
        leg: half width of the upper leg.
        neck: length of the neck.
        rise_deg: rise of the neck above the horizontal.
        head: length of the head.
        muzzle: length of the muzzle as a share of the head.
        ear: length of the ears.
        tail: length of the tail.
        fur: size of the lumps of the coat, relative.
        horns: chance of horns or antlers.
    """

    shoulder_m: tuple[float, float]
    length: tuple[float, float]
    girth: float
    leg: float
    neck: float
    rise_deg: float
    head: float
    muzzle: float
    ear: float
    tail: float
    fur: float
    horns: float = 0.0


SHAPES = {
    'dog': Shape((0.28, 0.75), (0.95, 1.25), 0.17, 0.085, 0.34, 42, 0.36, 0.5, 0.14, 0.55, 0.04),
    'cat': Shape((0.22, 0.32), (1.25, 1.55), 0.2, 0.095, 0.26, 35, 0.36, 0.25, 0.14, 1.0, 0.03),
    'horse': Shape((1.15, 1.7), (0.95, 1.15), 0.17, 0.075, 0.5, 48, 0.38, 0.6, 0.1, 0.55, 0.015),
    'deer': Shape((0.7, 1.15), (0.9, 1.1), 0.15, 0.06, 0.48, 55, 0.3, 0.5, 0.15, 0.15, 0.02, 0.6),
    'sheep': Shape(
        (0.55, 0.8), (1.05, 1.25), 0.29, 0.09, 0.24, 30, 0.34, 0.45, 0.12, 0.2, 0.08, 0.3
    ),
    'cow': Shape((1.1, 1.45), (1.15, 1.35), 0.24, 0.09, 0.3, 20, 0.38, 0.5, 0.13, 0.65, 0.02, 0.7),
    'bear': Shape((0.6, 1.1), (1.2, 1.5), 0.3, 0.15, 0.25, 25, 0.42, 0.4, 0.1, 0.08, 0.06),
}


def _vary(rng: np.random.Generator, value: float, share: float = 0.18) -> float:
    return float(value * rng.uniform(1.0 - share, 1.0 + share))


def rest_joints(rng: np.random.Generator, shape: Shape) -> F64:
    """Rest joints (20, 3): standing at the origin, facing +x, metres."""
    h = rng.uniform(*shape.shoulder_m)
    length = h * rng.uniform(*shape.length)
    girth = _vary(rng, shape.girth) * h
    rise = np.deg2rad(_vary(rng, shape.rise_deg))
    neck = _vary(rng, shape.neck) * h
    tail = _vary(rng, shape.tail, 0.35) * h
    back = 0.88 * h
    joints = np.zeros((20, 3))
    joints[LOINS] = [-0.4 * length, 0.0, back]
    joints[RIBS] = [0.02 * length, 0.0, back]
    ahead = np.array([np.cos(rise), 0.0, np.sin(rise)])
    joints[NECK_LOW] = [0.42 * length, 0.0, back]
    joints[NECK_TOP] = joints[NECK_LOW] + 0.5 * neck * ahead
    joints[HEAD] = joints[NECK_LOW] + neck * ahead
    droop = np.array([-0.75, 0.0, -0.65 if rng.random() < 0.6 else 0.5])
    for k, bone in enumerate(TAIL):
        joints[bone] = joints[LOINS] + [-0.1 * h, 0, -0.45 * girth] + k / 3.0 * tail * droop
    for bone, x, side in zip(LEGS, (0.36, 0.36, -0.4, -0.4), (1, -1, 1, -1), strict=True):
        fore = x > 0.0
        y = 0.62 * girth * side
        bend = -0.035 if fore else 0.075
        joints[bone] = [x * length, y, 0.72 * h]
        joints[bone + 1] = [x * length + bend * h, y, 0.42 * h]
        joints[bone + 2] = [x * length - (0.0 if fore else 0.1) * h, y, 0.2 * h]
    return joints


def animal_rig(rng: np.random.Generator, kind: str) -> Rig:
    """Skeleton and skin of a random animal of a kind in the rest pose."""
    shape = SHAPES[kind]
    joints = rest_joints(rng, shape)
    h = float(joints[LOINS, 2]) / 0.88
    girth = float(joints[LEGS[0], 1]) / 0.62
    parts = _trunk(rng, shape, joints, h, girth) + _head(rng, shape, joints, h)
    feet: list[F64] = []
    for bone in LEGS:
        parts += _leg(rng, shape, joints, bone, h)
        foot = joints[bone + 2].copy()
        feet.append(np.array([foot[0] + 0.02 * h, foot[1], 0.0]))
    belly = [joints[LOINS] - [0, 0, 1.1 * girth], joints[RIBS] - [0, 0, 1.3 * girth]]
    bones = [*(bone + 2 for bone in LEGS), LOINS, RIBS]
    return Rig(PARENTS, joints, assemble(parts), np.array(bones), np.array(feet + belly))


def _trunk(
    rng: np.random.Generator, shape: Shape, joints: F64, h: float, girth: float
) -> list[Part]:
    """Barrel, neck and tail."""
    fur = _vary(rng, shape.fur, 0.6)
    drop = np.array([0.0, 0.0, -0.7 * girth])
    rear = joints[LOINS] + drop + [-0.15 * h, 0.0, 0.0]
    front = joints[NECK_LOW] + drop + [0.08 * h, 0.0, 0.03 * h]
    waist = rng.uniform(0.7, 1.0)
    barrel = loft(
        [rear, joints[RIBS] + drop, front],
        [
            [0.6 * girth, 0.8 * girth],
            [0.9 * girth, 1.1 * girth],
            [waist * girth, 1.05 * waist * girth],
            [girth, 1.25 * girth],
            [0.95 * girth, 1.3 * girth],
            [0.6 * girth, 0.9 * girth],
        ],
        [LOINS, RIBS],
        rings=18,
        sides=14,
        blend_m=0.2 * h,
        rng=rng,
        lumps=fur,
    )
    thick = 0.55 * girth
    tip = joints[HEAD] + 0.25 * (joints[HEAD] - joints[NECK_TOP])
    neck = loft(
        [joints[NECK_LOW] + 0.6 * drop, joints[NECK_TOP], tip],
        [[1.3 * thick, 1.7 * thick], [thick, 1.3 * thick], [0.8 * thick, thick]],
        [NECK_LOW, NECK_TOP],
        rings=10,
        blend_m=0.08 * h,
        rng=rng,
        lumps=fur,
    )
    bush = rng.uniform(0.025, 0.07) * h
    end = joints[TAIL[2]] + (joints[TAIL[2]] - joints[TAIL[1]])
    tail = loft(
        [joints[TAIL[0]], joints[TAIL[1]], joints[TAIL[2]], end],
        [[bush, bush], [1.1 * bush, 1.1 * bush], [0.6 * bush, 0.6 * bush]],
        TAIL,
        rings=10,
        sides=8,
        blend_m=0.04 * h,
        rng=rng,
        lumps=fur,
    )
    return [barrel, neck, tail]


def _head(rng: np.random.Generator, shape: Shape, joints: F64, h: float) -> list[Part]:
    """Skull, muzzle, ears, sometimes horns or antlers."""
    size = _vary(rng, shape.head) * h
    skull = 0.36 * size * (1.25 - 0.4 * shape.muzzle)
    x, _, z = joints[HEAD]
    nose = [x + size * (0.55 + 0.5 * shape.muzzle), 0.0, z - rng.uniform(0.25, 0.75) * skull]
    parts = [
        ball([x + 0.15 * size, 0.0, z], [1.1 * skull, 0.85 * skull, skull], HEAD),
        loft(
            [[x + 0.1 * size, 0.0, z - 0.2 * skull], nose],
            [[0.7 * skull, 0.75 * skull], [0.55 * skull, 0.6 * skull], [0.5 * skull, 0.5 * skull]],
            [HEAD],
            rings=8,
            sides=10,
        ),
    ]
    ear, floppy = _vary(rng, shape.ear, 0.4) * h, rng.random() < 0.4
    horn = rng.uniform(0.12, 0.35) * h if rng.random() < shape.horns else 0.0
    for side in (1.0, -1.0):
        root = [x + 0.05 * size, 0.55 * skull * side, z + 0.55 * skull]
        tip = [root[0], root[1] + 0.5 * ear * side, root[2] + ear * (-0.8 if floppy else 0.9)]
        parts.append(
            loft(
                [root, tip],
                [[0.3 * ear, 0.1 * ear], [0.32 * ear, 0.1 * ear], [0.08 * ear, 0.05 * ear]],
                [HEAD],
                rings=5,
                sides=8,
                side_axis=(1.0, 0.0, 0.0),
            )
        )
        if horn > 0.0:
            bow = [root[0] - 0.3 * horn, root[1] + 0.6 * horn * side, root[2] + 0.6 * horn]
            parts.append(
                loft(
                    [root, bow, [bow[0], bow[1] * 0.9, bow[2] + 0.5 * horn]],
                    [[0.025 * h] * 2, [0.015 * h] * 2, [0.006 * h] * 2],
                    [HEAD],
                    rings=7,
                    sides=6,
                )
            )
    return parts


def _leg(rng: np.random.Generator, shape: Shape, joints: F64, bone: int, h: float) -> list[Part]:
    """One leg with its paw or hoof."""
    thick = _vary(rng, shape.leg, 0.05) * h * (1.15 if bone in LEGS[2:] else 1.0)
    foot = joints[bone + 2]
    sole = [foot[0] + 0.01 * h, foot[1], 0.035 * h]
    top = joints[bone] + [0.0, 0.0, 0.06 * h]
    leg = loft(
        [top, joints[bone + 1], foot, sole],
        [
            [thick, 1.5 * thick],
            [0.85 * thick, 1.25 * thick],
            [0.55 * thick, 0.65 * thick],
            [0.42 * thick, 0.48 * thick],
            [0.4 * thick, 0.42 * thick],
        ],
        [bone, bone + 1, bone + 2],
        rings=14,
        sides=9,
        blend_m=0.05 * h,
        rng=rng,
        lumps=0.02,
    )
    paw = ball(
        [sole[0] + 0.03 * h, sole[1], 0.03 * h],
        [0.075 * h, 0.5 * thick, 0.03 * h],
        bone + 2,
        rings=5,
        sides=8,
    )
    return [leg, paw]


def make_animal(
    rng: np.random.Generator,
    start: F64,
    heading_rad: float = 0.0,
    *,
    kind: str | None = None,
    activity: str | None = None,
    track: Way | None = None,
    reach_m: float = 1.2,
    ground: Callable[[float, float], float] | None = None,
) -> SkinnedMover:
    """Build a four-legged animal that moves for ever.

    Args:
        rng: source of proportions and motion.
        start: (3,) ground below its loins at time 0, world frame, metres.
        heading_rad: first heading about z.
        kind: one of `SHAPES`, or None: mostly dogs and cats.
        activity: one of `ACTIVITIES`, or None for a random one.
        track: path of a walker; by default a closed loop within 2 `reach_m` of start.
        reach_m: half extent of that loop, metres.
        ground: height of the ground at (x, y), metres; by default the height of `start`.

    Raises:
        ConfigError: the kind or the activity is unknown.
    """
    kind = kind or str(rng.choice(list(SHAPES), p=[0.4, 0.24, 0.08, 0.08, 0.08, 0.05, 0.07]))
    activity = activity or str(rng.choice(ACTIVITIES, p=[0.3, 0.25, 0.15, 0.25, 0.05]))
    for name, value, known in (('kind', kind, SHAPES), ('activity', activity, ACTIVITIES)):
        if value not in known:
            raise ConfigError(f'{name}: expected one of {", ".join(known)}, found {value!r}')
    rig = animal_rig(rng, kind)
    leg = float(rig.joints[LEGS[0], 2])
    moves = activity in GAITS
    froude = {'walk': 0.35, 'trot': 0.85, 'bound': 1.5}.get(activity, 0.0)
    speed = froude * float(np.sqrt(9.81 * leg)) * rng.uniform(0.8, 1.2)
    swing = {'walk': 0.38, 'trot': 0.5, 'bound': 0.7}.get(activity, 0.0) * rng.uniform(0.8, 1.15)
    place = np.asarray(start, dtype=np.float64)
    step = float(rng.uniform(0.5, 0.9))
    stance = rng.normal(0.0, 1.0, (48, 3)) * (
        [0.35, 0.35, 1.2] if activity == 'play' else [0.03, 0.03, 0.2]
    )
    stance[0] = 0.0
    motion = AnimalMotion(
        keys=KeyFrames(gesture_keys(rng, activity), step, float(rng.uniform(0.0, step))),
        stance=KeyFrames(stance, step),
        track=(track or loop_track(rng, place, heading_rad, reach_m)) if moves else None,
        start=place,
        heading_rad=heading_rad,
        speed_mps=speed if moves else 0.0,
        cadence_hz=float(speed / max(3.2 * leg * np.sin(swing), 1e-3)) if moves else 0.0,
        swing=swing,
        gait=GAITS.get(activity, (0.0, 0.0, 0.0, 0.0)),
        ground=ground,
    )
    return SkinnedMover(rig, motion, motion.speed_mps, f'{kind} {activity}')
