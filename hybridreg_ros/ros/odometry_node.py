# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Executable odometry_node: signals first, then everything that takes time to load."""

from __future__ import annotations

import sys

from hybridreg_ros.ros.stop_signals import StopSignals, leave


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to stop.

    Args:
        args: command line without the program's name; None = that of this process.

    Returns:
        0 after shutdown, 2 when the node cannot start (one line on stderr). SIGINT and SIGTERM
        end the process with 0 from within.
    """
    argv = sys.argv[1:] if args is None else args
    with StopSignals() as stop:
        from hybridreg_ros.ros.node import run

        code = run(argv, stop)
    if stop.asked:
        leave(code)  # a thread may be in a long call
    return code


if __name__ == '__main__':
    raise SystemExit(main())
