# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""Rows e to h of the paper's ablation, each trained on from the same weights for the same steps.

    python scripts/ablation.py config/train.yaml --trunk WEIGHTS --steps 10000 \
        --test data/test/room-match-30-50 data/test/room-lomatch-30-50

Every row sees the same samples in the same order and starts with the same mask head, drawn anew,
for that of the trunk has learned from one row's loss. A run that was killed goes on where it
stopped, and what has been scored is kept. Prints the table: LGR alone, as in the paper, and
refined. Not the whole of `register()`: its choice between poses and its confidence are fitted to
the weights that ship, not to these.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import torch

from hybridreg_ros.cli.main import main as main_of_hybridreg
from hybridreg_ros.core.config import load_yaml
from hybridreg_ros.model.checkpoint import load_checkpoint, save_network
from hybridreg_ros.model.reference.network import MaskHead
from hybridreg_ros.training.config import TrainConfig
from hybridreg_ros.training.loop import train

if TYPE_CHECKING:
    from collections.abc import Sequence


class Row(NamedTuple):
    """One row: what is trained, and whether the mask weighs the correlation in use."""

    title: str
    loss: dict[str, Any]
    masked: bool


ROWS = {
    'e': Row('no mask', {'mask': 'none'}, False),
    'f': Row('mask learned with L1', {'mask': 'l1'}, False),
    'g': Row('mask learned with NLL', {'mask': 'nll'}, False),
    'h': Row(
        'NLL, and it weighs the correlation', {'mask': 'nll', 'masked_correlation': True}, True
    ),
    'h-gradient': Row(
        'the same, with a gradient through the mean of the likelihood',
        {'mask': 'nll', 'mask_stop_gradient': False, 'masked_correlation': True},
        True,
    ),
    'ours': Row('mask learned with BCE', {'mask': 'bce', 'masked_correlation': True}, True),
}
"""Changes of the `LossConfig`; whatever else the config says is the same in all rows."""


def without_mask(trunk: str, out: Path) -> str:
    """Weights file in `out` that is the trunk but for a mask head drawn from seed 0."""
    checkpoint = load_checkpoint(trunk)
    torch.manual_seed(0)
    checkpoint.network.mask = MaskHead(checkpoint.network.config)
    out.mkdir(parents=True, exist_ok=True)
    path = out / 'trunk.safetensors'
    save_network(path, checkpoint.network, {**checkpoint.provenance, 'mask': 'drawn anew'})
    return str(path)


def row_config(base: TrainConfig, name: str, trunk: str, steps: int, out: Path) -> TrainConfig:
    """The training run of a row, from the common trunk, always for as many steps."""
    loss = dataclasses.replace(base.loss, masked_correlation=False)
    return dataclasses.replace(
        base,
        start_weights=trunk,
        steps=steps,
        max_hours=0.0,
        out=str(out / name),
        loss=dataclasses.replace(loss, **ROWS[name].loss),
    )


def score(name: str, out: Path, test: Sequence[Path], limit: int) -> list[dict[str, Any]]:
    """Rows of the report of LGR, one a split; what has been scored is kept."""
    method = 'lgr' if ROWS[name].masked else 'lgr-no-mask'
    kept, weights = out / name / method, out / name / 'last.safetensors'
    call = ['evaluate', *test, '--method', method, '--limit', limit, '--weights', weights]
    call += ['--keep', kept.with_suffix('.jsonl'), '--json', kept.with_suffix('.json')]
    if main_of_hybridreg([str(part) for part in call]):
        raise SystemExit(2)
    rows = json.loads(kept.with_suffix('.json').read_text(encoding='utf-8'))['rows']
    return [row for row in rows if row['split'] != 'all']


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('config', type=Path, help='training configuration common to all rows')
    parser.add_argument('--trunk', required=True, help='weights that all rows start from')
    parser.add_argument('--steps', type=int, default=10_000, help='optimiser steps of each row')
    parser.add_argument('--rows', nargs='+', choices=ROWS, default=list(ROWS))
    parser.add_argument('--test', nargs='+', type=Path, required=True, help='folders of pairs')
    parser.add_argument('--limit', type=int, default=200, help='pairs of each')
    parser.add_argument(
        '--out', type=Path, default=Path('runs/ablation'), help='folder of the runs'
    )
    args = parser.parse_args()
    base = load_yaml(TrainConfig, args.config)
    lines, trunk = [], without_mask(args.trunk, args.out)
    for name in args.rows:
        train(row_config(base, name, trunk, args.steps, args.out))
        scores = score(name, args.out, args.test, args.limit)
        header = [f'{part["split"]} (n = {part["pairs"]})' for part in scores]
        cells = [f'{100.0 * part["RR_coarse"]:.1f} / {100.0 * part["RR"]:.1f}' for part in scores]
        lines.append([name, ROWS[name].title, *cells])
    head = ['row', 'RR %: LGR alone / refined', *header]
    for line in (head, ['---'] * len(head), *lines):
        print('| ' + ' | '.join(line) + ' |')


if __name__ == '__main__':
    main()
