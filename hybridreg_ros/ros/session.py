# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Session: rclpy from init to shutdown, ended in order by Ctrl-C or SIGTERM.

rclpy's own handlers invalidate the context at once, while other threads still publish; here a
signal only asks to stop, so that the cloud in work can be finished and published.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import rclpy
from rclpy.signals import SignalHandlerOptions

from hybridreg_ros.ros import fastdds

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rclpy.executors import Executor

    from hybridreg_ros.ros.stop_signals import StopSignals


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


@contextlib.contextmanager
def ros_session(args: list[str] | None, stop: StopSignals) -> Iterator[Session]:
    """Prepare the transport, initialise rclpy, and shut it down at the end.

    Args:
        args: command line with ROS arguments; None = that of this process.
        stop: waits for the signals already.
    """
    transport = fastdds.prepare()
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    stop.end_in_order(_nothing)
    try:
        yield Session(transport, stop)
    finally:
        rclpy.try_shutdown()
