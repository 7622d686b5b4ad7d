# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Warm-up: each branch sees a made-up room, so that no scan waits for a compiler."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import jit
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.odometry.frontend import HybridOdometry

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hybridreg_ros.odometry.config import OdometryConfig

SCANS = 4
"""Scans that each front end sees: the third is the first with two before it."""
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
            front_end = HybridOdometry(config, model=branch)
            for k in range(scans):
                name = 'network' if branch is not None else 'kiss-icp'
                yield f'{name}, {"lidar" if timed else "depth camera"}, scan {k + 1} of {scans}'
                front_end.step(_scan(k, timed))
    if filled:
        return
    whole = hasattr(model, 'register')
    if whole:
        yield 'registration of two clouds'
        model.register(_scan(0, False).points, _scan(3, False).points, voxel_size_m=0.3)
    jit.mark_filled(jit.ALL if whole else WITHOUT_NETWORK)


def _scan(k: int, timed: bool) -> Scan:
    """A scan (8,000 points) of a box-shaped room from a sensor on its way."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-_HALF_M, _HALF_M, (8000, 3))
    axis = rng.integers(0, 3, len(points))
    points[np.arange(len(points)), axis] = _HALF_M[axis] * rng.choice([-1.0, 1.0], len(points))
    moved = (points - [0.05 * k, 0.0, 0.0]).astype(np.float32)
    times = np.linspace(0.0, 0.1, len(points)) if timed else None
    return Scan(moved, stamp=(1 + k) * NS_PER_S // 10, times=times)
