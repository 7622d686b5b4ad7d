# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg echo`: the odometry of a running node, as lines to read."""

from __future__ import annotations

import contextlib
import sys
from typing import TYPE_CHECKING

from hybridreg_ros.cli.common import write_result
from hybridreg_ros.core.errors import DependencyError

if TYPE_CHECKING:
    import argparse


def run(args: argparse.Namespace) -> int:
    """Print each message until Ctrl-C or --count; what diagnostics find goes to stderr.

    Raises:
        DependencyError: rclpy is not installed.
        HybridRegError: nothing came for --wait seconds.
    """
    try:
        from hybridreg_ros.ros.playback.echo import echo
    except ModuleNotFoundError as error:
        raise DependencyError(
            f"echo needs {error.name}: pip install 'hybridreg_ros[ros]', or source ROS 2 Jazzy"
        ) from None
    shown = 0

    def say(text: str) -> None:
        nonlocal shown
        shown += 1
        print(text, flush=True)

    def remark(text: str) -> None:
        print(f'{args.node}: {text}', file=sys.stderr, flush=True)

    with contextlib.suppress(KeyboardInterrupt):
        echo(say, remark, args.node, args.count, args.wait)
    write_result(args, {'messages': shown})
    return 0
