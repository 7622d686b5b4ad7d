# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Builds the front end of the node and says in one line which weights it runs with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.errors import WeightsError
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.odometry.frontend import HybridOdometry

if TYPE_CHECKING:
    from hybridreg_ros.odometry.config import OdometryConfig

_WARM_UP_SCANS = 3


@dataclass(frozen=True, eq=False)
class FrontEnd:
    """A front end and the state of its network.

    Attributes:
        odometry: the front end.
        weights: one line about the weights.
        has_weights: False when the network was asked for and has none.
    """

    odometry: HybridOdometry
    weights: str
    has_weights: bool


def build_front_end(config: OdometryConfig, weights: str) -> FrontEnd:
    """Load the weights and build the front end.

    Without packaged weights the front end still runs, on kiss-icp alone, and says so. A weights
    file that the user names must load.

    Args:
        config: settings of the front end.
        weights: path of a weights file, '' = the packaged ones.

    Raises:
        WeightsError: the file named cannot be used.
        DependencyError: kiss-icp is not installed.
    """
    model, text, has_weights = None, 'not used: registrar kiss-icp', True
    if config.registrar != 'kiss-icp':
        try:
            model, text = _load(weights), weights or 'packaged'
        except WeightsError as error:
            if weights:
                raise
            text, has_weights = str(error), False
    _warm_up(config, model)
    return FrontEnd(HybridOdometry(config, model=model), text, has_weights)


def _warm_up(config: OdometryConfig, model: Any) -> None:
    """Let every branch see a made-up room, so that nothing is compiled while clouds wait."""
    rng = np.random.default_rng(0)
    half = np.array([6.0, 4.0, 1.5])
    points = rng.uniform(-half, half, (8000, 3))
    axis = rng.integers(0, 3, len(points))
    points[np.arange(len(points)), axis] = half[axis] * rng.choice([-1.0, 1.0], len(points))
    for branch in (None, model):
        front_end = HybridOdometry(config, model=branch)
        for k in range(_WARM_UP_SCANS):
            moved = (points - [0.05 * k, 0.0, 0.0]).astype(np.float32)
            front_end.step(Scan(moved, stamp=(1 + k) * NS_PER_S // 10))


def _load(weights: str) -> Any:
    from hybridreg_ros.model.register import HybridReg

    return HybridReg.from_pretrained(weights) if weights else HybridReg.from_pretrained()
