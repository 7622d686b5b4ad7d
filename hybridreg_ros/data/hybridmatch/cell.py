# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Cell: what the pairs of one split have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Cell:
    """What a pair must be to belong to a cell of the data set.

    Attributes:
        overlap: lowest and highest overlap of the static background.
        dynamic: lowest and highest share of moving points; ignored for frozen pairs.
        crowd: lowest and highest share of points on whatever could move, whether or not it does;
            None asks for nothing. It is the same for all levels of a split, so that they show
            the same kind of scenes and views and differ in what moves alone.
        frozen: movers stand still between the clouds and count as background.
        fused: highest number of images fused into one cloud (more than 1 only when frozen).
        fusing: share of the clouds that are fused from several images.
    """

    overlap: tuple[float, float]
    dynamic: tuple[float, float] = (0.0, 0.0)
    crowd: tuple[float, float] | None = None
    frozen: bool = False
    fused: int = 2
    fusing: float = 0.0

    @property
    def part(self) -> bool:
        """Whether only a part of what could move does."""
        return not self.frozen and self.crowd is not None and self.dynamic[1] <= self.crowd[0]
