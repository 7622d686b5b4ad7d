# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg ship`: a training checkpoint becomes a weights file with a fitted confidence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybridreg_ros.cli.common import budget_of, write_result
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.core.progress import progress
from hybridreg_ros.data.loaders.openers import open_pairs
from hybridreg_ros.training.report import to_markdown
from hybridreg_ros.training.shipping import ship

if TYPE_CHECKING:
    import argparse


def run(args: argparse.Namespace) -> int:
    """Score the validation pairs, fit, write."""
    sources = [open_pairs(folder) for folder in args.data]
    total = sum(len(source) for source in sources)
    pairs = (source[row] for source in sources for row in range(len(source)))
    about = {'calibration_data': [folder.name for folder in args.data]}
    try:
        shown = progress(pairs, total, 'ship', 'pair')
        report = ship(args.weights, shown, args.out, about, budget_of(args))
    except ValueError as error:
        raise ConfigError(f'the confidence cannot be fitted to {total} pairs: {error}') from None
    print(to_markdown([report]), end='')
    print(f'{args.out}: {args.out.stat().st_size / 1e6:.1f} MB')
    write_result(args, {'out': str(args.out), 'rows': report.rows()})
    return 0
