# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Session: rclpy from init to shutdown, ended in order by Ctrl-C or SIGTERM.

rclpy's own handlers invalidate the context at once, while other threads still publish; here a
signal only asks to stop, so that the cloud in work can be finished and published.
"""

from __future__ import annotations

import contextlib
import itertools
import re
from pathlib import Path
from typing import TYPE_CHECKING

import rclpy
import yaml
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.ros import fastdds

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rclpy.executors import Executor

    from hybridreg_ros.ros.stop_signals import StopSignals


_REFUSALS = (
    rclpy_implementation.RCLError,
    rclpy_implementation.RCLInvalidROSArgsError,
    rclpy_implementation.UnknownROSArgsError,
)
_PLACES = re.compile(
    r',? at [^\s:]+:\d+|failed to initialize rcl: |Failed to parse ROS arguments: '
)
"""Of rcl's own sources, in its errors."""


class Session:
    """A running rclpy.

    Attributes:
        transport: what fastdds.prepare decided.
    """

    def __init__(self, transport: fastdds.Transport, stop: StopSignals) -> None:
        self.transport = transport
        self._stop = stop

    @property
    def active(self) -> bool:
        """Whether work shall go on."""
        return not self._stop.asked and bool(rclpy.ok())

    def spin(self, executor: Executor) -> None:
        """Serve callbacks until a signal comes or the context is shut down.

        Raises:
            Exception: whatever a callback raised.
        """
        self._stop.end_in_order(lambda: executor.create_task(_nothing))
        while self.active:
            executor.spin_once()


def _nothing() -> None:
    """What an executor runs to look up."""


def check_parameter_files(args: list[str]) -> None:
    """Make sure that the files of --params-file hold parameters: rcl passes over those without.

    Raises:
        ConfigError: a file cannot be read, or holds something else.
    """
    for option, name in itertools.pairwise(args):
        if option != '--params-file':
            continue
        try:
            content = yaml.safe_load(Path(name).read_text(encoding='utf-8'))
        except OSError as error:
            raise ConfigError(f'parameter file {name}: {error.strerror}') from error
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise ConfigError(f'parameter file {name}: {" ".join(str(error).split())}') from error
        if content is not None and not isinstance(content, dict):
            found = type(content).__name__
            raise ConfigError(f'parameter file {name}: expected node names, found a {found}')


@contextlib.contextmanager
def _refusals() -> Iterator[None]:
    try:
        yield
    except _REFUSALS as error:
        text = ' '.join(_PLACES.sub('', str(error)).split())
        raise ConfigError(f'ROS arguments not understood: {text}') from error


def own_arguments(program: str, args: list[str]) -> list[str]:
    """The command line without its ROS arguments.

    Args:
        program: name of the executable.
        args: command line without it.

    Raises:
        ConfigError: rclpy does not understand the ROS arguments, or a parameter file.
    """
    check_parameter_files(args)
    with _refusals():
        own: list[str] = remove_ros_args([program, *args])[1:]
    return own


@contextlib.contextmanager
def ros_session(args: list[str], stop: StopSignals) -> Iterator[Session]:
    """Prepare the transport, initialise rclpy, and shut it down at the end.

    Args:
        args: command line with ROS arguments, without the program's name.
        stop: waits for the signals already.

    Raises:
        ConfigError: rclpy does not understand the arguments.
    """
    transport = fastdds.prepare()
    with _refusals():
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    stop.end_in_order(_nothing)
    try:
        yield Session(transport, stop)
    finally:
        rclpy.try_shutdown()
