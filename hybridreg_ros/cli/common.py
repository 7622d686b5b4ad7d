# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the commands share: progress bars on stderr, JSON results, configuration files."""

from __future__ import annotations

import dataclasses
import sys
from typing import TYPE_CHECKING, Any

from hybridreg_ros.core.config import load_yaml
from hybridreg_ros.core.errors import DependencyError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from hybridreg_ros.odometry.config import OdometryConfig


def bar(total: int | None, text: str, unit: str = 'frame') -> Any:
    """Progress bar on stderr (tqdm); it stays quiet when stderr is not a terminal.

    Raises:
        DependencyError: tqdm is not installed.
    """
    try:
        from tqdm import tqdm
    except ImportError:
        raise DependencyError(
            "progress bars need tqdm: pip install 'hybridreg_ros[replay]'"
        ) from None
    quiet = not sys.stderr.isatty()
    return tqdm(
        total=total, desc=text, unit=unit, file=sys.stderr, mininterval=5.0 if quiet else 0.1
    )


def progress(
    items: Iterable[Any], total: int | None, text: str, unit: str = 'frame'
) -> Iterator[Any]:
    """Items, with a progress bar."""
    with bar(total, text, unit) as shown:
        for item in items:
            yield item
            shown.update()


def write_result(args: argparse.Namespace, result: Any) -> None:
    """Write the result where --json says."""
    if args.json is not None:
        from hybridreg_ros.replay.outputs import write_json

        write_json(args.json, result)


def odometry_config(path: Path | None, registrar: str | None = None) -> OdometryConfig:
    """Settings of the front end from a YAML file (or defaults), with --registrar on top.

    Raises:
        ConfigError: unreadable file, unknown key, or a value out of range.
    """
    from hybridreg_ros.odometry.config import OdometryConfig

    config = OdometryConfig() if path is None else load_yaml(OdometryConfig, path)
    return config if registrar is None else dataclasses.replace(config, registrar=registrar)
