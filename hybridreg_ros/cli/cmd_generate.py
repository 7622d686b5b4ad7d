# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg generate`: pairs of a HybridMatch split; started again, it goes on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybridreg_ros.cli.common import bar, write_result
from hybridreg_ros.data.preview import write_preview
from hybridreg_ros.data.splits import generate_split

if TYPE_CHECKING:
    import argparse


def run(args: argparse.Namespace) -> int:
    """Generate, and say what was made."""
    with bar(args.pairs, args.split, 'pair') as shown:

        def report(done: int, wanted: int) -> None:
            shown.update(done - shown.n)

        summary = generate_split(
            args.split,
            args.pairs,
            args.seed,
            args.out,
            workers=args.workers,
            scheduler=args.scheduler,
            layout=args.layout,
            progress=report,
        )
    if args.preview:
        for path in write_preview(args.out, summary):
            print(f'preview: {path}')
    print(f'{args.out}: {summary.pairs} pairs of {summary.split} from {summary.scenes} scenes')
    for name, spread in summary.distributions.items():
        print(
            f'  {name:<16} min {spread.minimum:.3g}  median {spread.median:.3g}  '
            f'max {spread.maximum:.3g}'
        )
    write_result(args, summary)
    return 0
