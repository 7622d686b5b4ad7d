# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fit the weights by which verification chooses a pose, to training pairs with little overlap.

    python scripts/fit_score.py data/street-train data/room-train --pairs 300 --keep out/score

Prints how many pairs are won by the weights in use, by fitted ones on scenes they were not fitted
to, and by a perfect choice, then the fitted weights (`WEIGHTS` in model/pose/score.py).
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.data.loaders.openers import open_pairs
from hybridreg_ros.model.pose.score import TRACES, UNMASKED_WEIGHTS, WEIGHTS
from hybridreg_ros.training.choice import Contest, contest, fit_weights, held_out_wins, won
from hybridreg_ros.training.variants import load_variant

if TYPE_CHECKING:
    from hybridreg_ros.model.register import HybridReg

MOST_OVERLAP = 0.45


def collect(model: HybridReg, folder: Path, pairs: int, keep: Path) -> list[Contest]:
    """Contests of the first pairs of a folder with little overlap, in an order drawn once.

    What has been measured is kept in an npz file, and not measured again.
    """
    known = _load(keep)
    found: list[Contest] = []
    wanted = open_pairs(folder)
    for row in np.random.default_rng(0).permutation(len(wanted)):
        if len(found) == pairs:
            break
        pair = wanted[int(row)]
        if pair.overlap > MOST_OVERLAP:
            continue
        try:
            known[pair.name] = known.get(pair.name) or contest(model, pair)
        except RegistrationError as error:
            print(f'{pair.name}: {error}')
            continue
        found.append(known[pair.name])
        if len(found) % 50 == 0:
            _save(keep, known)
    _save(keep, known)
    return found


def _load(path: Path) -> dict[str, Contest]:
    if not path.exists():
        return {}
    with np.load(path) as kept:
        return {
            name: Contest(name.rsplit('-', 1)[0], kept[name][:, :-1], kept[name][:, -1] > 0.5)
            for name in kept.files
        }


def _save(path: Path, contests: dict[str, Contest]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {n: np.column_stack([c.traces, c.right]) for n, c in contests.items()}
    np.savez_compressed(path, **arrays)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('data', nargs='+', type=Path, help='folders of training shards')
    parser.add_argument('--weights', help='checkpoint instead of ours')
    parser.add_argument('--no-mask', action='store_true', help='for `use_mask: false`')
    parser.add_argument('--pairs', type=int, default=300, help='of each folder')
    parser.add_argument('--keep', type=Path, default=Path('out/score'), help='folder of traces')
    args = parser.parse_args()
    model = load_variant('no-mask' if args.no_mask else 'hybridreg', args.weights)
    in_use = UNMASKED_WEIGHTS if args.no_mask else WEIGHTS
    parts = [collect(model, d, args.pairs, args.keep / f'{d.name}.npz') for d in args.data]
    contests = [c for part in parts for c in part]
    fitted, held_out = fit_weights(contests), held_out_wins(contests)
    start = 0
    print('| pairs of | n | weights in use % | fitted, other scenes % | perfect choice % |')
    print('|---|---|---|---|---|')
    for folder, part in zip(args.data, parts, strict=True):
        shares = (
            won(part, in_use).mean(),
            held_out[start : start + len(part)].mean(),
            np.mean([c.right.any() for c in part]),
        )
        start += len(part)
        print(f'| {folder.name} | {len(part)} | ' + ' | '.join(f'{100 * s:.1f}' for s in shares))
    print(', '.join(f'{n} {w:.2f}' for n, w in zip(TRACES, fitted, strict=True)))


if __name__ == '__main__':
    main()
