# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The two small models of the mask, as fitted by `scripts/fit_mask.py`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]

PACKAGED = Path(__file__).with_name('models.npz')
_LIMIT = 4.0
_BLOCK = 2048


@dataclass(frozen=True, eq=False)
class Perceptron:
    """Inputs in standard deviations, two hidden layers, log odds.

    Attributes:
        mean: (F,) of the inputs.
        scale: (F,) their standard deviations.
        layers: weights (I, O) and offsets (O,) of each layer.
    """

    mean: F32
    scale: F32
    layers: tuple[tuple[F32, F32], ...]

    def __call__(self, inputs: F32) -> F32:
        """Log odds (M,) of inputs (M, F), in blocks that stay in the cache."""
        odds = np.empty(len(inputs), np.float32)
        for start in range(0, len(inputs), _BLOCK):
            x = (inputs[start : start + _BLOCK] - self.mean) / self.scale
            np.clip(x, -_LIMIT, _LIMIT, out=x)
            for weights, offset in self.layers[:-1]:
                x = x @ weights
                x += offset
                np.maximum(x, np.float32(0.0), out=x)
            weights, offset = self.layers[-1]
            odds[start : start + _BLOCK] = (x @ weights + offset)[:, 0]
        return odds


@dataclass(frozen=True, eq=False)
class Models:
    """Log odds that a cell moves, by its own evidence, and in the context of its part."""

    alone: Perceptron
    in_context: Perceptron


@cache
def packaged() -> Models:
    """The models that ship."""
    with np.load(PACKAGED) as kept:
        return Models(*(_perceptron(kept, name) for name in ('alone', 'in_context')))


def _perceptron(kept: np.lib.npyio.NpzFile, name: str) -> Perceptron:
    layers = tuple(
        (kept[f'{name}_weights_{k}'].astype(np.float32), kept[f'{name}_offset_{k}'])
        for k in range(3)
    )
    return Perceptron(kept[f'{name}_mean'], kept[f'{name}_scale'], layers)
