# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the network branch says of the points of a scan against a keyframe."""

from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.core import se3
from hybridreg_ros.model.budget import Budget
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.model.register import HybridReg
from hybridreg_ros.odometry.keyframes import Keyframe
from hybridreg_ros.odometry.network_branch import LearnedBranch, load

BUDGET = Budget(800, 64)


def walls(rng: np.random.Generator) -> np.ndarray:
    """Points (N, 3) of a corner around the sensor, metres."""
    flat = rng.uniform(-3.0, 3.0, (1500, 2))
    floor = np.c_[flat, np.full(len(flat), -1.0)]
    wall = np.c_[np.full(len(flat), 3.0), flat]
    return np.concatenate([floor, wall]).astype(np.float32)


def branch_of(model: object) -> LearnedBranch:
    registrar = load(model)
    assert registrar is not None
    return LearnedBranch(registrar, memory=2)


@pytest.fixture
def branch() -> LearnedBranch:
    return branch_of('auto')


def test_a_thing_that_came_is_not_static(branch: LearnedBranch) -> None:
    rng = np.random.default_rng(4)
    room = walls(rng)
    pose = se3.exp(np.array([0.2, 0.1, 0.0, 0.0, 0.0, 0.2]))
    keyframe = Keyframe(0, 0, pose, room)
    branch.adopt(keyframe, branch.encode(room, BUDGET))
    step = se3.exp(np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.05]))
    thing = rng.uniform(-0.2, 0.2, (400, 3)) + np.array([1.5, 0.5, 0.0])
    points = se3.apply(se3.inverse(step), np.concatenate([room, thing])).astype(np.float32)
    scan = branch.encode(points, BUDGET)
    assert scan is not None
    answer = branch.point_mask(scan, keyframe, pose @ step)
    assert answer is not None
    branch.forget(keyframe)  # what it needs was taken when it was asked
    mask = answer()
    assert mask is not None
    assert np.median(mask.static[len(room) :]) < 0.5 < np.median(mask.static[: len(room)])
    assert mask.seen.shape == (len(points),)


def test_no_answer_where_nothing_is_kept_or_known(branch: LearnedBranch) -> None:
    room = walls(np.random.default_rng(5))
    keyframe = Keyframe(0, 0, np.eye(4), room)
    scan = branch.encode(room, BUDGET)
    assert scan is not None
    assert branch.point_mask(scan, keyframe, np.eye(4)) is None
    branch.adopt(keyframe, branch.encode(room, Budget(400, 64)))
    assert branch.point_mask(scan, keyframe, np.eye(4)) is None  # another budget
    without = branch_of(HybridReg(ModelConfig(), HybridRegNet(ModelConfig())))
    scan = without.encode(room, BUDGET)
    assert scan is not None
    without.adopt(keyframe, scan)
    answer = without.point_mask(scan, keyframe, np.eye(4))
    assert answer is not None
    assert answer() is None
