# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Session: rclpy from init to shutdown, ended in order by Ctrl-C or SIGTERM.

rclpy's own handlers invalidate the context at once, while other threads still publish; here a
signal only asks to stop, so that the cloud in work is finished and published.
"""

from __future__ import annotations

import contextlib
import signal
from typing import TYPE_CHECKING

import rclpy
from rclpy.signals import SignalHandlerOptions

from hybridreg_ros.ros import fastdds

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Session:
    """A running rclpy.

    Attributes:
        stopping: True once a signal asked to stop.
        transport: what fastdds.prepare decided.
    """

    def __init__(self, transport: fastdds.Transport) -> None:
        self.stopping = False
        self.transport = transport

    @property
    def active(self) -> bool:
        """Whether work shall go on."""
        return not self.stopping and bool(rclpy.ok())

    def on_signal(self, number: int, _: FrameType | None) -> None:
        """Ask to stop; a second signal interrupts at once.

        Raises:
            KeyboardInterrupt: this is not the first signal.
        """
        if self.stopping:
            raise KeyboardInterrupt
        self.stopping = True


@contextlib.contextmanager
def ros_session(args: list[str] | None) -> Iterator[Session]:
    """Prepare the transport, initialise rclpy, and shut it down at the end.

    Args:
        args: command line with ROS arguments; None = that of this process.
    """
    session = Session(fastdds.prepare())
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    before = {number: signal.signal(number, session.on_signal) for number in _SIGNALS}
    try:
        yield session
    except KeyboardInterrupt:
        session.stopping = True
    finally:
        rclpy.try_shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)
