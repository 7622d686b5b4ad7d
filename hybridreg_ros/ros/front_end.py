# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Builds the front end of the node and says in one line which weights it runs with."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hybridreg_ros.core import jit
from hybridreg_ros.core.errors import WeightsError
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.warm_up import warm_up

if TYPE_CHECKING:
    from collections.abc import Callable

    from hybridreg_ros.odometry.config import OdometryConfig

_log = logging.getLogger(__name__)


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


def build_front_end(
    config: OdometryConfig, weights: str, say: Callable[[str], object] = _log.info
) -> FrontEnd:
    """Load the weights, compile what is not compiled yet, and build the front end.

    Without packaged weights the front end still runs, on kiss-icp alone, and says so. A weights
    file that the user names must load.

    Args:
        config: settings of the front end.
        weights: path of a weights file, '' = the packaged ones.
        say: called with one line at once when kernels must be compiled, and with each step of it.

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
    filled = jit.is_filled()
    if not filled:
        say('compiling kernels, once after an installation or update (about a minute; '
            '`hybridreg warm-up` does it beforehand)')  # fmt: skip
    for step in warm_up(config, model):
        if not filled:
            say(f'compiling: {step}')
    return FrontEnd(HybridOdometry(config, model=model), text, has_weights)


def _load(weights: str) -> Any:
    from hybridreg_ros.model.register import HybridReg

    return HybridReg.from_pretrained(weights) if weights else HybridReg.from_pretrained()
