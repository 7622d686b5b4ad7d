# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg evaluate --moving`: the mask against the labels of recordings and generated pairs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.cli.common import budget_of, write_result
from hybridreg_ros.core import provenance
from hybridreg_ros.core.config import to_dict
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.core.progress import progress
from hybridreg_ros.data.loaders.labelled import open_labelled
from hybridreg_ros.training.moving import score_moving, to_markdown
from hybridreg_ros.training.variants import load_variant

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from hybridreg_ros.training.moving import MovingScore

OURS = 'hybridreg'


def run(args: argparse.Namespace) -> int:
    """Score every folder, print one table."""
    if args.method != OURS:
        raise ConfigError(f'method: expected {OURS} with --moving, found {args.method}')
    sources = {folder: open_labelled(folder, args.gap_s) for folder in args.data}
    model, budget = load_variant(OURS, args.weights, attempts=1), budget_of(args)

    def scored(folder: Path) -> MovingScore:
        pairs = sources[folder]
        rows = range(len(pairs))
        if args.limit is not None and args.limit < len(pairs):
            rows = np.linspace(0, len(pairs) - 1, args.limit).round().astype(int).tolist()
        name = folder.resolve().name
        shown = progress((pairs.labelled(row) for row in rows), len(rows), name, 'pair')
        return score_moving(model, shown, name, budget)

    scores = [scored(folder) for folder in args.data]
    table = to_markdown(scores)
    print(table, end='')
    if args.markdown is not None:
        args.markdown.parent.mkdir(parents=True, exist_ok=True)
        args.markdown.write_text(table, encoding='utf-8')
    about: dict[str, Any] = {
        'weights': 'packaged' if args.weights is None else provenance.sha256(args.weights),
        'gap_s': args.gap_s,
        'budget': None if budget is None else to_dict(budget),
        'git': provenance.git_hash(),
    }
    write_result(args, {'about': about, 'rows': [score.row() for score in scores]})
    return 0
