# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg bench --data`: what a pair costs, side by side with its ray casting alone."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hybridreg_ros.core import provenance
from hybridreg_ros.core.errors import HybridRegError
from hybridreg_ros.core.pages import peak_mb
from hybridreg_ros.core.progress import progress
from hybridreg_ros.data.hybridmatch.room_pairs import SCENES, SPLITS, TRAIN, make_samples
from hybridreg_ros.data.hybridmatch.splits_work import Block, make_block
from hybridreg_ros.data.meshes.raycast import CLOCK
from hybridreg_ros.replay.page.tables import text_table

if TYPE_CHECKING:
    import argparse

SEED = 9_500_000
_MOST_SCENES = 400


@dataclass(frozen=True)
class DataCost:
    """What the pairs of one split cost, on one core.

    Attributes:
        split: which.
        pairs: number of pairs made.
        scenes: number of scenes they took.
        cpu_s: processor seconds per pair, encoding included.
        cast_s: of these, seconds inside the ray caster.
        rays: per pair.
        disk_kb: per pair.
        peak_mb: largest resident memory of the process after these pairs.
    """

    split: str
    pairs: int
    scenes: int
    cpu_s: float
    cast_s: float
    rays: int
    disk_kb: float
    peak_mb: float


def run(args: argparse.Namespace) -> tuple[str, dict[str, Any]]:
    """Measure; returns the text to print and the figures."""
    splits = (*(f'{scene}-{TRAIN}' for scene in SCENES), *SPLITS)
    make_samples('room-match-rigid', SEED - 1)  # imports and caches are not what is measured
    make_samples('street-match-rigid', SEED - 1)
    costs = [cost_of(s, args.pairs) for s in progress(splits, len(splits), 'bench', 'split')]
    rows = [
        [
            'split',
            'pairs',
            'CPU ms a pair',
            'ray casting ms',
            'share %',
            'pairs/s on 2 cores',
            'MB per 1000',
            'peak MB',
        ]
    ]
    rows += [
        [
            c.split,
            str(c.pairs),
            f'{1e3 * c.cpu_s:.0f}',
            f'{1e3 * c.cast_s:.0f}',
            f'{100 * c.cast_s / c.cpu_s:.0f}',
            f'{2.0 / c.cpu_s:.1f}',
            f'{c.disk_kb:.0f}',
            f'{c.peak_mb:.0f}',
        ]
        for c in costs
    ]
    text = 'processor time of one process; two cores make twice as many pairs\n' + text_table(rows)
    return text, {'costs': costs, 'provenance': provenance.collect(seed=SEED).to_dict()}


def cost_of(split: str, pairs: int) -> DataCost:
    """Make at least `pairs` pairs of a split as a worker does, and measure.

    Raises:
        HybridRegError: the scenes do not give them.
    """
    began, cast, rays = time.process_time(), CLOCK.seconds, CLOCK.rays
    made, size = 0, 0
    for scenes in range(1, _MOST_SCENES + 1):
        block = make_block(Block(split, SEED + scenes, 1))
        made += len(block.rows)
        size += sum(len(blob) for files in block.files for blob in files.values())
        if made >= pairs:
            break
    else:
        raise HybridRegError(f'{split}: {_MOST_SCENES} scenes gave {made} of {pairs} pairs')
    return DataCost(
        split,
        made,
        scenes,
        (time.process_time() - began) / made,
        (CLOCK.seconds - cast) / made,
        (CLOCK.rays - rays) // made,
        size / made / 1e3,
        peak_mb(),
    )
