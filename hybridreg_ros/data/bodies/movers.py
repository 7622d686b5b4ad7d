# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Things that move or deform: people, animals, cloth, articulated and rolling things."""

from __future__ import annotations

from hybridreg_ros.data.bodies.animals import ACTIVITIES as ANIMAL_ACTIVITIES
from hybridreg_ros.data.bodies.animals import make_animal
from hybridreg_ros.data.bodies.cloth import (
    Cloth,
    make_cloth,
    make_door,
    make_fan,
    make_robot_arm,
    make_suitcase,
)
from hybridreg_ros.data.bodies.humans import make_human
from hybridreg_ros.data.bodies.humans_motion import ACTIVITIES as HUMAN_ACTIVITIES
from hybridreg_ros.data.bodies.rig import RigidMover, SkinnedMover
from hybridreg_ros.data.bodies.track import Track, loop_track, straight_track, wander_track

__all__ = [
    'ANIMAL_ACTIVITIES',
    'HUMAN_ACTIVITIES',
    'Cloth',
    'RigidMover',
    'SkinnedMover',
    'Track',
    'loop_track',
    'make_animal',
    'make_cloth',
    'make_door',
    'make_fan',
    'make_human',
    'make_robot_arm',
    'make_suitcase',
    'straight_track',
    'wander_track',
]
