# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg dump-config`: every setting of the front end with its description and range."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybridreg_ros.cli.common import write_result
from hybridreg_ros.core.config import dump_yaml, to_dict
from hybridreg_ros.replay.session import odometry_config

if TYPE_CHECKING:
    import argparse


def run(args: argparse.Namespace) -> int:
    """Print or write the settings as a ROS parameter file, which `--config` reads too."""
    config = odometry_config(args.config)
    text = '/**:\n  ros__parameters:\n' + dump_yaml(config, indent=4)
    if args.out is None:
        print(text, end='')
    else:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(text, encoding='utf-8')
    write_result(args, to_dict(config))
    return 0
