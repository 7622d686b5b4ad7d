# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Scores of a dynamic mask against true labels: IoU, precision, recall of the moving class."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

NAN = float('nan')


@dataclass(frozen=True)
class MaskCounts:
    """Confusion counts of one frame or many; adding two adds their points.

    Attributes:
        tp: moving points called moving.
        fp: static points called moving.
        fn: moving points called static.
        tn: static points called static.

    Examples:
        >>> MaskCounts(1, 2, 3, 4) + MaskCounts(1, 0, 0, 0)
        MaskCounts(tp=2, fp=2, fn=3, tn=4)
    """

    tp: int = 0
    fp: int = 0
    fn: int = 0
    tn: int = 0

    def __add__(self, other: MaskCounts) -> MaskCounts:
        """Counts of both."""
        return MaskCounts(
            self.tp + other.tp, self.fp + other.fp, self.fn + other.fn, self.tn + other.tn
        )

    @property
    def total(self) -> int:
        """Number of points."""
        return self.tp + self.fp + self.fn + self.tn


@dataclass(frozen=True)
class MaskScore:
    """Quality of a mask; NaN where the quotient has no meaning (nothing moves, nothing called).

    Attributes:
        iou: tp / (tp + fp + fn).
        precision: tp / (tp + fp).
        recall: tp / (tp + fn).
        false_share: fp / (fp + tn), share of static points called moving.
        moving_share: share of points that truly move.
        counts: the counts behind.
    """

    iou: float
    precision: float
    recall: float
    false_share: float
    moving_share: float
    counts: MaskCounts


def count(predicted: NDArray[Any], truth: NDArray[Any]) -> MaskCounts:
    """Confusion counts of one mask.

    Args:
        predicted: (N,) bool, True = called moving.
        truth: (N,) bool, True = moves.

    Raises:
        ValueError: the arrays differ in shape or are not one value per point.

    Examples:
        >>> count(np.array([True, True, False, False]), np.array([True, False, True, False]))
        MaskCounts(tp=1, fp=1, fn=1, tn=1)
    """
    p, t = np.asarray(predicted, dtype=bool), np.asarray(truth, dtype=bool)
    if p.shape != t.shape or p.ndim != 1:
        raise ValueError(f'expected two (N,) masks, found {p.shape} and {t.shape}')
    return MaskCounts(
        tp=int((p & t).sum()),
        fp=int((p & ~t).sum()),
        fn=int((~p & t).sum()),
        tn=int((~p & ~t).sum()),
    )


def score(counts: MaskCounts) -> MaskScore:
    """Quotients of confusion counts.

    Examples:
        >>> score(MaskCounts(tp=6, fp=2, fn=2, tn=90)).iou
        0.6
    """
    return MaskScore(
        iou=_ratio(counts.tp, counts.tp + counts.fp + counts.fn),
        precision=_ratio(counts.tp, counts.tp + counts.fp),
        recall=_ratio(counts.tp, counts.tp + counts.fn),
        false_share=_ratio(counts.fp, counts.fp + counts.tn),
        moving_share=_ratio(counts.tp + counts.fn, counts.total),
        counts=counts,
    )


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else NAN
