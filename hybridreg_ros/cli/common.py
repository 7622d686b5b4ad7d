# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the commands share: progress bars on stderr, JSON results, configuration files."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import argparse

    from hybridreg_ros.model.budget import Budget


def write_result(args: argparse.Namespace, result: Any) -> None:
    """Write the result where --json says; '-' prints it, and all other text goes to stderr."""
    if args.json is not None:
        from hybridreg_ros.replay.outputs import plain, write_json

        if str(args.json) == '-':
            print(json.dumps(plain(result), indent=1, allow_nan=False), file=args.stdout)
        else:
            write_json(args.json, result)


def budget_of(args: argparse.Namespace) -> Budget | None:
    """What --max-points and --max-superpoints ask for; None when neither is given."""
    given = {
        key: value
        for key in ('max_points', 'max_superpoints')
        if (value := getattr(args, key)) is not None
    }
    if not given:
        return None
    from hybridreg_ros.model.budget import Budget

    return Budget(**given)


def told(args: argparse.Namespace, text: str, result: Any) -> int:
    """Print a text, write the result where --json says; exit code 0."""
    print(text)
    write_result(args, result)
    return 0
