# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Builds the front end of the node and says in one line which weights it runs with."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hybridreg_ros.core import jit
from hybridreg_ros.core.errors import HybridRegError, WeightsError
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.motion.prediction import Motion
from hybridreg_ros.odometry.warm_up import WITHOUT_NETWORK, warm_up

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
    config: OdometryConfig,
    weights: str,
    say: Callable[[str], object] = _log.info,
    motion: Callable[[], Motion] = Motion,
) -> FrontEnd:
    """Load the weights, compile what is not compiled yet, and build the front end.

    Without packaged weights the front end still runs, on kiss-icp alone, and says so. A weights
    file that the user names must load.

    Args:
        config: settings of the front end.
        weights: path of a weights file, '' = the packaged ones.
        say: called with one line at once when kernels must be compiled, and with each step of it.
        motion: makes the motion model.

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
    filled = jit.is_filled(WITHOUT_NETWORK if model is None else jit.ALL)
    if not filled:
        say(
            'compiling kernels, once after an installation or update (one to two minutes; '
            '`hybridreg warm-up` does it beforehand)'
        )
    for step in warm_up(config, model, filled):
        if not filled:
            say(f'compiling: {step}')
    return FrontEnd(HybridOdometry(config, model=model, motion=motion), text, has_weights)


class Building:
    """Builds a front end in a thread of its own, so that the node answers meanwhile.

    Attributes:
        state: what it is at, '' before the start and once it is done.
    """

    def __init__(
        self,
        config: OdometryConfig,
        weights: str,
        say: Callable[[str], object],
        on_done: Callable[[], object],
        motion: Callable[[], Motion] = Motion,
    ) -> None:
        """Start to build.

        Args:
            config: settings of the front end.
            weights: path of a weights file, '' = the packaged ones.
            say: called in the thread with one line for each step of a compilation.
            on_done: called in the thread once `result` will answer.
            motion: makes the motion model.
        """
        self.state = 'loading'
        self._made: FrontEnd | None = None
        self._error: HybridRegError | None = None
        self._arguments = (config, weights)
        self._say, self._on_done, self._motion = say, on_done, motion
        threading.Thread(target=self._run, name='hybridreg_build', daemon=True).start()

    def result(self) -> FrontEnd:
        """The front end, when it is done.

        Raises:
            WeightsError: the file named cannot be used.
            DependencyError: kiss-icp is not installed.
            RuntimeError: a bug ended the thread.
        """
        if self._error is not None:
            raise self._error
        if self._made is None:
            raise RuntimeError('the front end was not built; its thread has logged why')
        return self._made

    def _run(self) -> None:
        try:
            self._made = build_front_end(*self._arguments, self._step, self._motion)
        except HybridRegError as error:
            self._error = error
        finally:
            self.state = ''
            self._on_done()

    def _step(self, text: str) -> None:
        self.state = text
        self._say(text)


def _load(weights: str) -> Any:
    from hybridreg_ros.model.register import HybridReg

    return HybridReg.from_pretrained(weights) if weights else HybridReg.from_pretrained()
