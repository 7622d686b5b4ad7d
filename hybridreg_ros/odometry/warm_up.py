# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Warm-up: each branch sees a made-up room, so that no scan waits for a compiler.

A thing stands in it that is gone later, the sensor jumps, and scans are large: what that asks of
the map is compiled too.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import jit
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.map.local_map import POINTS_PER_VOXEL, VoxelLevel

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hybridreg_ros.odometry.config import OdometryConfig

SCANS = 6
"""Scans that each front end sees: a thing is gone in the fourth, the last is somewhere else."""
_MOST_POINTS = 5000
"""Of the scans of 9,000 points, those that are thinned."""
WITHOUT_NETWORK = 'kiss-icp'
"""Part of the kernels that runs without a network."""
_HALF_M = np.array([6.0, 4.0, 1.5])


def warm_up(config: OdometryConfig, model: Any, filled: bool = False) -> Iterator[str]:
    """Run the front end with each branch on a made-up room; yields what comes next, step by step.

    Args:
        config: settings of the front end.
        model: the network, None = there is none.
        filled: all kernels are compiled: two scans of the branch of `model` load nearly all of it.
    """
    scans = 2 if filled else SCANS
    for branch in (model,) if model is None or filled else (None, model):
        for timed in (False, True):
            thins = replace(config.preprocess, max_points=_MOST_POINTS)
            front_end = HybridOdometry(replace(config, preprocess=thins), model=branch)
            for k in range(scans):
                name = 'network' if branch is not None else 'kiss-icp'
                yield f'{name}, {"lidar" if timed else "depth camera"}, scan {k + 1} of {scans}'
                front_end.step(_scan(k, timed))
    if filled:
        return
    VoxelLevel(1.0, POINTS_PER_VOXEL).make_room()
    whole = hasattr(model, 'register')
    if whole:
        yield 'registration of two clouds'
        model.register(_scan(0, False).points, _scan(3, False).points, voxel_size_m=0.3)
    jit.mark_filled(jit.ALL if whole else WITHOUT_NETWORK)


def _scan(k: int, timed: bool) -> Scan:
    """A scan (9,000 points) of a box-shaped room from a sensor on its way."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-_HALF_M, _HALF_M, (8000, 3))
    axis = rng.integers(0, 3, len(points))
    points[np.arange(len(points)), axis] = _HALF_M[axis] * rng.choice([-1.0, 1.0], len(points))
    thing = rng.uniform([2.0, -0.5, -0.5], [2.3, 0.5, 0.5], (1000, 3))
    behind = thing * (_HALF_M[0] / thing[:, :1])
    points = np.concatenate([points, thing if k < SCANS // 2 else behind])
    moved = (points - [0.05 * k if k < SCANS - 1 else 1.5, 0.0, 0.0]).astype(np.float32)
    times = np.linspace(0.0, 0.1, len(points)) if timed else None
    return Scan(moved, stamp=(1 + k) * NS_PER_S // 10, times=times)
