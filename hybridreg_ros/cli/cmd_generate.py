# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg generate`: pairs of one HybridMatch split or of all; started again, it goes on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybridreg_ros.cli.common import write_result
from hybridreg_ros.core.errors import ConfigError, require
from hybridreg_ros.core.progress import bar
from hybridreg_ros.data.hybridmatch.preview import write_preview
from hybridreg_ros.data.hybridmatch.room_pairs import SPLITS, scene_of
from hybridreg_ros.data.hybridmatch.splits import PAIRS, first_seed, generate_split

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from hybridreg_ros.data.hybridmatch.splits_summary import SplitSummary

ALL = 'all'


def run(args: argparse.Namespace) -> int:
    """Generate, and say what was made.

    Raises:
        ConfigError: arguments contradict each other, or the split is unknown.
    """
    require('a generated pair', 'data', 'embreex')
    if args.preview:
        require('--preview', 'data', 'matplotlib')
    if args.split == ALL:
        if args.seed is not None:
            raise ConfigError('generate all: every split has its own seeds; leave --seed out')
        made = [_one(args, split, args.out / split) for split in SPLITS]
        write_result(args, made)
    else:
        write_result(args, _one(args, args.split, args.out))
    return 0


def _one(args: argparse.Namespace, split: str, out: Path) -> SplitSummary:
    """Fill one folder."""
    seed = first_seed(args.part, split) if args.seed is None else args.seed
    pairs = args.pairs or PAIRS.get(args.part, {}).get(scene_of(split))
    if pairs is None:
        raise ConfigError(f'--part {args.part} has no default number of pairs: give --pairs')
    with bar(pairs, split, 'pair') as shown:

        def report(done: int, wanted: int) -> None:
            shown.update(done - shown.n)

        summary = generate_split(
            split,
            pairs,
            seed,
            out,
            workers=args.workers,
            scheduler=args.scheduler,
            layout=args.layout,
            progress=report,
        )
    if args.preview:
        for path in write_preview(out, summary):
            print(f'preview: {path}')
    print(f'{out}: {summary.pairs} pairs of {summary.split} from {summary.scenes} scenes')
    for name, spread in summary.distributions.items():
        print(
            f'  {name:<16} min {spread.minimum:.3g}  median {spread.median:.3g}  '
            f'max {spread.maximum:.3g}'
        )
    return summary
