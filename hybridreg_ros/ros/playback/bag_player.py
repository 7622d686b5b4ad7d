# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Executable bag_player: plays a rosbag2 into ROS topics, with QoS and /clock on request."""

from __future__ import annotations

import sys

from hybridreg_ros.ros.stop_signals import StopSignals, leave


def main(args: list[str] | None = None) -> int:
    """Play a bag.

    Args:
        args: command line without the program's name; None = that of this process.

    Returns:
        0 at the end of the bag, 2 after an error (one line on stderr). SIGINT and SIGTERM end the
        process with 0 from within.
    """
    argv = sys.argv[1:] if args is None else args
    with StopSignals() as stop:
        code = _run(argv, stop)
    if stop.asked:
        leave(code)
    return code


def _run(argv: list[str], stop: StopSignals) -> int:
    from hybridreg_ros.core.errors import HybridRegError
    from hybridreg_ros.ros.playback.arguments import parser
    from hybridreg_ros.ros.session import own_arguments

    try:
        parsed = parser().parse_args(own_arguments('bag_player', argv))
        from hybridreg_ros.ros.playback.playing import run

        run(parsed, argv, stop)
    except HybridRegError as error:
        sys.stderr.write(f'bag_player: {error}\n')
        return 2
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
