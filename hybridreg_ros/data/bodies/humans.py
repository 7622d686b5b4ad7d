# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Procedural humans: varied build, clothes, hair and load on one skeleton."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.bodies.humans_dress import (
    ARM_L,
    ARM_R,
    CHEST,
    FOOT_L,
    FOOT_R,
    HEAD,
    NECK,
    PARENTS,
    PELVIS,
    SHIN_L,
    SHIN_R,
    SPINE,
    THIGH_L,
    THIGH_R,
    Build,
    carried,
    gown,
    hair,
)
from hybridreg_ros.data.bodies.humans_motion import ACTIVITIES, HumanMotion, make_motion
from hybridreg_ros.data.bodies.loft import assemble, ball, loft
from hybridreg_ros.data.bodies.rig import Rig, SkinnedMover

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hybridreg_ros.data.bodies.rig import Part
    from hybridreg_ros.data.bodies.track import Way

    F64 = NDArray[np.float64]


def random_build(rng: np.random.Generator) -> Build:
    """Measures of a random person; one in seven is a child."""
    child = rng.random() < 0.14
    height = rng.uniform(0.95, 1.5) if child else np.clip(rng.normal(1.71, 0.1), 1.48, 2.02)
    weight = float(np.clip(rng.normal(1.0, 0.13), 0.78, 1.45))
    return Build(
        height=float(height),
        weight=weight,
        belly=float(np.clip(rng.normal(1.0, 0.2) + 0.8 * (weight - 1.0), 0.75, 1.9)),
        hips=float(rng.uniform(0.048, 0.058) * height),
        shoulders=float(rng.uniform(0.105, 0.13) * height),
        legs=float(rng.uniform(0.95, 1.04) if not child else rng.uniform(0.88, 0.96)),
        clothes=float(rng.choice([0.004, 0.012, 0.025, 0.045], p=[0.25, 0.35, 0.25, 0.15])),
        head=float(rng.uniform(0.95, 1.06) * (1.22 if child else 1.0)),
    )


def rest_joints(b: Build) -> F64:
    """Rest joints (17, 3): standing at the origin, facing +x, arms hanging, metres."""
    h = b.height
    hip, knee, ankle = 0.52 * h * b.legs, 0.283 * h * b.legs, 0.045 * h
    shoulder = hip + 0.295 * h
    joints = np.zeros((17, 3))
    joints[[PELVIS, SPINE, CHEST, NECK, HEAD], 2] = (
        hip + np.array([0.01, 0.08, 0.18, 0.325, 0.37]) * h
    )
    for side, arm, thigh in ((1.0, ARM_L, THIGH_L), (-1.0, ARM_R, THIGH_R)):
        y = side * b.shoulders
        joints[arm] = [0.0, y, shoulder]
        joints[arm + 1] = [0.0, y * 1.05, shoulder - 0.17 * h]
        joints[arm + 2] = [0.0, y * 1.08, shoulder - 0.325 * h]
        joints[thigh] = [0.0, side * b.hips, hip]
        joints[thigh + 1] = [0.0, side * b.hips * 0.92, knee]
        joints[thigh + 2] = [0.0, side * b.hips * 0.88, ankle]
    return joints


def _trunk(rng: np.random.Generator, b: Build, joints: F64) -> list[Part]:
    """Torso, neck and head."""
    h, w, c = b.height, b.weight, b.clothes
    hip, neck = joints[THIGH_L, 2], joints[NECK, 2]
    top = neck + 0.02 * h
    depth = 0.062 * h * w
    torso = loft(
        [[0, 0, hip - 0.06 * h], joints[SPINE], joints[CHEST], [0, 0, top]],
        [
            [0.055 * h * w + c, 0.045 * h * w + c],
            [0.1 * h * w + c, 1.05 * depth + c],
            [0.085 * h * w * b.belly**0.5 + c, depth * b.belly + c],
            [0.088 * h * w + c, depth * (0.5 + 0.5 * b.belly) + c],
            [0.8 * b.shoulders + 0.02 * h + c, 1.08 * depth + c],
            [0.85 * b.shoulders + 0.02 * h + c, 0.95 * depth + c],
            [0.05 * h, 0.045 * h],
        ],
        [PELVIS, SPINE, CHEST],
        rings=18,
        sides=18,
        square=2.5,
        blend_m=0.05 * h,
        rng=rng,
        lumps=0.02 + c,
    )
    throat = loft(
        [[0, 0, neck - 0.03 * h], joints[HEAD], [0.01 * h, 0, neck + 0.07 * h]],
        [[0.037 * h, 0.037 * h]] * 3,
        [NECK, HEAD],
        rings=6,
        blend_m=0.02 * h,
    )
    size = 0.066 * h * b.head
    centre = [0.012 * h, 0.0, joints[HEAD, 2] + 0.9 * size]
    skull = ball(centre, [0.86 * size, 0.68 * size, 1.02 * size], HEAD, square=2.3, rings=10)
    nose = ball(
        [centre[0] + 0.86 * size, 0.0, centre[2] - 0.1 * size],
        [0.16 * size, 0.12 * size, 0.24 * size],
        HEAD,
        rings=4,
        sides=6,
    )
    jaw = ball(
        [centre[0] + 0.3 * size, 0.0, centre[2] - 0.62 * size],
        [0.5 * size, 0.5 * size, 0.42 * size],
        HEAD,
        rings=6,
        sides=10,
    )
    return [torso, throat, skull, nose, jaw, *hair(rng, centre, size)]


def _limbs(rng: np.random.Generator, b: Build, joints: F64) -> list[Part]:
    """Arms with hands and legs with feet."""
    h, w, c = b.height, b.weight, b.clothes
    flare = rng.uniform(0.0, 0.02) + 0.5 * c
    arms = [(0.036, 0.04), (0.029, 0.03), (0.026, 0.028), (0.023, 0.024), (0.017, 0.019)]
    legs = [(0.052, 0.056), (0.05, 0.052), (0.04, 0.042), (0.033, 0.034), (0.031, 0.034),
            (0.022, 0.024)]  # fmt: skip
    parts: list[Part] = []
    for side, arm, thigh in ((1.0, ARM_L, THIGH_L), (-1.0, ARM_R, THIGH_R)):
        top = joints[arm] + [0.0, -0.012 * side * h, 0.022 * h]
        wrist = joints[arm + 2]
        width = np.array(arms) * h * w**0.7 + c * np.array([1.0, 1.0, 0.9, 0.8, 0.4])[:, None]
        parts.append(loft([top, joints[arm + 1], wrist], width, [arm, arm + 1], rings=14,
                     sides=10, blend_m=0.03 * h, rng=rng, lumps=0.02 + c))  # fmt: skip
        palm = wrist + np.array([0.012 * h, 0.0, -0.047 * h])
        parts.append(ball(palm, [0.024 * h, 0.011 * h, 0.055 * h], arm + 2, rings=7, sides=8))
        thumb = wrist + np.array([0.03 * h, 0.0, -0.035 * h])
        parts.append(ball(thumb, [0.009 * h, 0.009 * h, 0.025 * h], arm + 2, rings=4, sides=6))
        hip = joints[thigh] + [0.0, 0.0, 0.02 * h]
        ankle = joints[thigh + 2]
        width = np.array(legs) * h * w**0.8 + c * 0.5
        width[-2:] += flare
        parts.append(loft([hip, joints[thigh + 1], ankle + np.array([0.0, 0.0, 0.005 * h])], width,
                     [thigh, thigh + 1], rings=16, sides=12, blend_m=0.04 * h, rng=rng,
                     lumps=0.02 + 0.5 * c))  # fmt: skip
        heel = np.array([ankle[0] - 0.035 * h, ankle[1], 0.024 * h])
        toe = np.array([ankle[0] + 0.115 * h, ankle[1] + 0.012 * side * h, 0.018 * h])
        shoe = rng.uniform(1.0, 1.25)
        parts.append(loft([heel, toe], [[0.022 * h * shoe, 0.024 * h], [0.024 * h * shoe,
                     0.023 * h], [0.03 * h * shoe, 0.018 * h], [0.024 * h * shoe, 0.014 * h]],
                     [thigh + 2], rings=9, sides=10, square=2.6))  # fmt: skip
    return parts


def human_rig(rng: np.random.Generator, *, load: bool = True, coarse: bool = False) -> Rig:
    """Skeleton and skin of a random person in the rest pose.

    Args:
        rng: source of build, clothes and load.
        load: whether something may be carried.
        coarse: about a quarter of the triangles, for people seen from some metres away.
    """
    build = random_build(rng)
    joints = rest_joints(build)
    parts = _trunk(rng, build, joints) + _limbs(rng, build, joints)
    if rng.random() < 0.25:
        parts += gown(rng, build, joints)
    if load:
        parts += carried(rng, build, joints)
    h = build.height
    soles = [
        joints[f] * [1, 1, 0] + [dx * h, 0, 0.0] for f in (FOOT_L, FOOT_R) for dx in (-0.04, 0.12)
    ]
    others = [joints[j] - [r * h, 0, 0] for j, r in ((PELVIS, 0.06), (CHEST, 0.06))]
    knees = [joints[j] + [0.04 * h, 0, 0] for j in (SHIN_L, SHIN_R)]
    bones = [FOOT_L, FOOT_L, FOOT_R, FOOT_R, PELVIS, CHEST, SHIN_L, SHIN_R]
    skin = assemble(parts, coarse=coarse)
    return Rig(PARENTS, joints, skin, np.array(bones), np.array(soles + others + knees))


def make_human(  # noqa: PLR0913 - all but two are optional
    rng: np.random.Generator,
    start: F64,
    heading_rad: float = 0.0,
    *,
    activity: str | None = None,
    track: Way | None = None,
    reach_m: float = 1.2,
    speed_mps: float | None = None,
    ground: Callable[[float, float], float] | None = None,
    rig: Rig | None = None,
) -> SkinnedMover:
    """Build a person who moves for ever.

    Args:
        rng: source of build, clothes, load and motion.
        start: (3,) feet at time 0, world frame, metres.
        heading_rad: first heading about z.
        activity: one of `ACTIVITIES`, or None for a random one.
        track: path of a walker; by default a closed loop that stays within 2 `reach_m` of start.
        reach_m: half extent of that loop, metres.
        speed_mps: walking speed; by default random, fitting the activity.
        ground: height of the ground at (x, y), metres; by default the height of `start`.
        rig: an earlier person's body, to save building another.

    Raises:
        ConfigError: the activity is unknown.
    """
    rig = rig or human_rig(rng)
    chosen = activity or str(rng.choice(ACTIVITIES))
    motion: HumanMotion = make_motion(
        rng,
        chosen,
        np.asarray(start, dtype=np.float64),
        heading_rad,
        track=track,
        reach_m=reach_m,
        speed_mps=speed_mps,
        ground=ground,
        leg_m=float(rig.joints[THIGH_L, 2]),
    )
    return SkinnedMover(rig, motion, motion.speed_mps, f'human {chosen}')
