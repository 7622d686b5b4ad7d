# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Is the difference between two runs more than chance: bootstrap of paired values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

SAMPLES = 2000
LEVEL = 0.95


@dataclass(frozen=True)
class Difference:
    """Mean of paired differences.

    Attributes:
        mean: of other - base.
        low: lower end of the interval that holds the true mean with a probability of 95 %.
        high: upper end.
        pairs: number of pairs.
    """

    mean: float
    low: float
    high: float
    pairs: int

    @property
    def is_sure(self) -> bool:
        """Whether zero lies outside the interval."""
        return self.low > 0.0 or self.high < 0.0


def paired(differences: Sequence[NDArray[np.float64]], seed: int = 0) -> Difference | None:
    """Mean difference over sequences of paired values, with its bootstrap interval.

    Errors of neighbouring frames are alike, so blocks of frames are drawn instead of frames, each
    about as long as the cube root of the sequence [1]; sequences are drawn as well where there are
    several, since the next one will be another. Every sequence counts the same.

    [1] Hall, Horowitz and Jing, On blocking rules for the bootstrap with dependent data, 1995.

    Args:
        differences: (N_k,) other - base per frame of each sequence; empty ones are left out.
        seed: of the draws.

    Returns:
        None without a pair.

    Examples:
        >>> d = paired([np.array([1.0, 1.0, 1.0, 1.0])])
        >>> (d.mean, d.low, d.high, d.pairs, d.is_sure)
        (1.0, 1.0, 1.0, 4, True)
    """
    some = [d[np.isfinite(d)] for d in differences]
    some = [d for d in some if len(d)]
    if not some:
        return None
    rng = np.random.default_rng(seed)
    means = np.stack([_block_means(d, rng) for d in some])  # (sequences, SAMPLES)
    drawn = rng.integers(0, len(some), (len(some), SAMPLES))
    totals = np.take_along_axis(means, drawn, axis=0).mean(axis=0)
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.percentile(totals, [tail, 100.0 - tail])
    mean = float(np.mean([d.mean() for d in some]))
    return Difference(mean, float(low), float(high), sum(map(len, some)))


def _block_means(values: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Means (SAMPLES,) of a sequence put together anew from blocks of itself (a circle)."""
    n = len(values)
    size = max(1, round(n ** (1.0 / 3.0)))
    sums = np.concatenate([[0.0], np.cumsum(np.concatenate([values, values[: size - 1]]))])
    blocks = (sums[size:] - sums[:-size]) / size
    starts = rng.integers(0, n, (SAMPLES, -(-n // size)))
    found: NDArray[np.float64] = blocks[starts].mean(axis=1)
    return found
