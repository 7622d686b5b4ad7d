# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What people wear and carry, and the bones it hangs on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.bodies.loft import ball, loft

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.bodies.rig import Part

    F64 = NDArray[np.float64]


PELVIS, SPINE, CHEST, NECK, HEAD = range(5)
ARM_L, FOREARM_L, HAND_L, ARM_R, FOREARM_R, HAND_R = range(5, 11)
THIGH_L, SHIN_L, FOOT_L, THIGH_R, SHIN_R, FOOT_R = range(11, 17)
PARENTS = (-1, 0, 1, 2, 3, 2, 5, 6, 2, 8, 9, 0, 11, 12, 0, 14, 15)


@dataclass(frozen=True)
class Build:
    """Measures of one person, metres where not a factor.

    Attributes:
        height: from sole to crown.
        weight: factor on all widths, 1 = average.
        belly: factor on the depth of the belly.
        hips: half distance of the hip joints.
        shoulders: half distance of the shoulder joints.
        legs: factor on the length of the legs.
        clothes: thickness of loose clothes, metres.
        head: factor on the size of the head.
    """

    height: float
    weight: float
    belly: float
    hips: float
    shoulders: float
    legs: float
    clothes: float
    head: float


def hair(rng: np.random.Generator, centre: list[float], size: float) -> list[Part]:
    """Hair, hat, hood or nothing."""
    x, y, z = centre
    style = rng.choice(['none', 'short', 'long', 'bun', 'cap', 'hat', 'hood', 'helmet'])
    parts: list[Part] = []
    if style in ('short', 'bun', 'long'):
        s = rng.uniform(1.04, 1.25)
        parts.append(
            ball(
                [x - 0.16 * size, y, z + 0.2 * size],
                [0.8 * size * s, 0.72 * size * s, 0.9 * size * s],
                HEAD,
            )
        )
    if style == 'long':
        end = z - rng.uniform(1.2, 3.4) * size
        parts.append(
            loft(
                [[x - 0.45 * size, 0, z + 0.7 * size], [x - 0.75 * size, 0, end]],
                [[0.7 * size, 0.35 * size], [0.85 * size, 0.3 * size], [0.5 * size, 0.15 * size]],
                [HEAD],
                rng=rng,
                lumps=0.08,
            )
        )
    elif style == 'bun':
        parts.append(ball([x - 0.9 * size, 0, z + 0.6 * size], [0.42 * size] * 3, HEAD, rings=6))
    elif style in ('cap', 'hat'):
        brim = rng.uniform(1.4, 2.2) * size if style == 'hat' else 0.9 * size
        shift = 0.0 if style == 'hat' else 0.75 * size
        crown = rng.uniform(0.5, 1.3)
        parts.append(ball([x, y, z + 0.6 * size], [0.98 * size, 0.82 * size, crown * size], HEAD))
        parts.append(
            ball([x + shift, y, z + 0.5 * size], [brim, 0.9 * brim, 0.1 * size], HEAD, rings=4)
        )
    elif style == 'hood':
        parts.append(ball([x - 0.25 * size, y, z], [1.0 * size, 0.95 * size, 1.25 * size], HEAD))
    elif style == 'helmet':
        parts.append(
            ball(
                [x - 0.05 * size, y, z + 0.35 * size], [1.2 * size, 1.0 * size, 0.95 * size], HEAD
            )
        )
    return parts


def gown(rng: np.random.Generator, b: Build, joints: F64) -> list[Part]:
    """A skirt, dress or coat tail that follows both thighs."""
    h = b.height
    waist, length = joints[SPINE, 2] - 0.02 * h, rng.uniform(0.18, 0.42) * h
    wide = rng.uniform(1.0, 1.7)
    base = 0.085 * h * b.weight + b.clothes
    tube = loft(
        [[0, 0, waist], [0, 0, waist - length]],
        [
            [base, 0.8 * base],
            [1.25 * base, 1.05 * base],
            [1.3 * base * wide, 1.1 * base * wide],
            [1.35 * base * wide, 1.15 * base * wide],
        ],
        [PELVIS],
        rings=12,
        sides=18,
        rng=rng,
        lumps=0.04,
    )
    drop = np.clip((waist - tube.vertices[:, 2]) / (0.22 * h) - 0.3, 0.0, 0.8)
    left = tube.vertices[:, 1] > 0.0
    held = np.where(left, THIGH_L, THIGH_R)
    reach = drop * np.clip(np.abs(tube.vertices[:, 1]) / (0.5 * base), 0.25, 1.0)
    return [replace(tube, bone_b=held, weight_b=reach)]


def carried(rng: np.random.Generator, b: Build, joints: F64) -> list[Part]:
    """Something carried: rucksack, bag, box, stick, umbrella, tray; often nothing."""
    h = b.height
    kind = rng.choice(['none', 'rucksack', 'bag', 'box', 'stick', 'umbrella', 'board'],
                      p=[0.46, 0.14, 0.12, 0.1, 0.06, 0.06, 0.06])  # fmt: skip
    hand = int(rng.choice([HAND_L, HAND_R]))
    palm = joints[hand] + [0.02 * h, 0.0, -0.06 * h]
    x, y, z = palm
    s = rng.uniform(0.7, 1.3)
    if kind == 'rucksack':
        depth = 0.07 * h * s
        back = -0.062 * h * b.weight * 1.1 - b.clothes - 0.8 * depth
        return [ball([back, 0, joints[CHEST, 2] + 0.03 * h], [depth, 0.085 * h * s, 0.13 * h * s],
                CHEST, square=4.0)]  # fmt: skip
    if kind == 'bag':
        drop = rng.uniform(0.1, 0.22) * h
        return [ball([x, y, z - drop], [0.11 * h * s, 0.04 * h * s, 0.09 * h * s], hand, square=4),
                ball([x, y, z - 0.4 * drop], [0.05 * h, 0.006, 0.5 * drop], hand,
                     rings=5, sides=6)]  # fmt: skip
    if kind == 'box':
        return [ball([x + 0.08 * h * s, 0.4 * y, z - 0.02], rng.uniform(0.05, 0.12, 3) * h * s,
                hand, square=9.0)]  # fmt: skip
    if kind == 'stick':
        return [loft([[x - 0.1, y, z], [x + rng.uniform(0.5, 1.1), y, z - 0.1]],
                     [[0.014, 0.014]] * 2, [hand], sides=6, rings=5)]  # fmt: skip
    if kind == 'umbrella':
        canopy = ball([x + 0.75, y, z], [0.1, 0.5 * s, 0.5 * s], hand, rings=8, sides=14)
        return [loft([[x - 0.08, y, z], [x + 0.8, y, z]], [[0.012, 0.012]] * 2, [hand], rings=5,
                     sides=6), canopy]  # fmt: skip
    if kind == 'board':
        return [ball([x, y, z - 0.1], [rng.uniform(0.1, 0.45), 0.012, rng.uniform(0.1, 0.3)], hand,
                square=9.0)]  # fmt: skip
    return []
