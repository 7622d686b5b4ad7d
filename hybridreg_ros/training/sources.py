# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pairs from folders of shards that may still be growing."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import ConfigError, FileFormatError
from hybridreg_ros.data.hybridmatch.shards import open_split

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hybridreg_ros.data.pair import PointPair

RESCAN_S = 60.0


class ShardSource:
    """Random pairs of some folders; shards that appear while a run goes on are used too."""

    def __init__(self, folders: Sequence[str], shares: Sequence[float] = ()) -> None:
        """Open the folders.

        Args:
            folders: of shards.
            shares: how often a pair is drawn from each; empty = in proportion to their pairs.

        Raises:
            ConfigError: the number of shares differs from that of the folders, or all are zero.
            FileFormatError: a folder does not exist, or no folder holds a pair.
        """
        if shares and (len(shares) != len(folders) or sum(shares) <= 0.0):
            raise ConfigError(
                f'shares: expected {len(folders)} numbers, one per data folder and not all zero, '
                f'found {list(shares)}'
            )
        self._splits = [open_split(f) for f in folders]
        self._shares = tuple(shares)
        self._scanned = time.monotonic()
        if not any(len(s) for s in self._splits):
            raise FileFormatError(
                f'no pairs in {", ".join(folders)}: make some with `hybridreg generate`'
            )

    def draw(self, rng: np.random.Generator) -> PointPair:
        """A random pair."""
        if time.monotonic() - self._scanned > RESCAN_S:
            for split in self._splits:
                split.refresh()
            self._scanned = time.monotonic()
        counts = np.array([len(s) for s in self._splits], dtype=np.float64)
        weight = np.array(self._shares) * (counts > 0) if self._shares else counts
        split = self._splits[rng.choice(len(weight), p=weight / weight.sum())]
        return split[int(rng.integers(len(split)))]


def held_out_pairs(folders: Sequence[str], count: int) -> list[PointPair]:
    """At most `count` pairs, spread evenly over each folder; always the same ones.

    Raises:
        FileFormatError: a folder does not exist, or no folder holds a pair.
    """
    splits = [open_split(f) for f in folders]
    splits = [s for s in splits if len(s)]
    if not splits:
        raise FileFormatError(
            f'no pairs in {", ".join(folders)}: make some with `hybridreg generate`'
        )
    pairs = []
    for i, split in enumerate(splits):
        share = count // len(splits) + (i < count % len(splits))
        rows = np.unique(np.linspace(0, len(split) - 1, min(share, len(split))).round())
        pairs += [split[int(r)] for r in rows]
    return pairs
