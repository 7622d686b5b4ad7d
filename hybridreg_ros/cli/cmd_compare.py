# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg compare`: results of replay against each other."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybridreg_ros.cli.common import told
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.replay.compare import compare, runs_of
from hybridreg_ros.replay.page.comparison import rows, write_comparison
from hybridreg_ros.replay.page.tables import text_table

if TYPE_CHECKING:
    import argparse


def run(args: argparse.Namespace) -> int:
    """Compare, print the table, write the page."""
    names = [path.name or str(path) for path in args.runs]
    if len(set(names)) < len(names):
        names = [str(path) for path in args.runs]
    if len(set(names)) < 2:
        raise ConfigError('compare: name two folders of results or more, the base first')
    runs = dict(zip(names, map(runs_of, args.runs), strict=True))
    found = compare(runs)
    write_comparison(args.out, runs, found)
    text = f'{text_table(rows(found))}\nwritten: {args.out}'
    return told(args, text, {'base': names[0], 'rows': found})
