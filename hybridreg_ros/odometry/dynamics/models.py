# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The two small models of the mask, as fitted by `scripts/fit_mask.py`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled_fast

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]

PACKAGED = Path(__file__).with_name('models.npz')
_LIMIT = np.float32(4.0)
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
        """Log odds (M,) of inputs (M, F)."""
        odds: F32 = _log_odds(inputs, self.mean, self.scale, self.layers)
        return odds


@compiled_fast
def _log_odds(inputs, mean, scale, layers):  # type: ignore[no-untyped-def]
    """The kernel of `Perceptron`, in blocks that stay in the cache."""
    odds = np.empty(len(inputs), np.float32)
    (first, first_offset), (second, second_offset), (last, last_offset) = layers
    x = np.empty((_BLOCK, len(mean)), np.float32)
    for start in range(0, len(inputs), _BLOCK):
        count = min(_BLOCK, len(inputs) - start)
        for k in range(len(mean)):  # inputs lie column by column
            for row in range(count):
                value = (inputs[start + row, k] - mean[k]) / scale[k]
                x[row, k] = min(max(value, -_LIMIT), _LIMIT)
        h = _hidden(_hidden(x[:count], first, first_offset), second, second_offset)
        for row in range(count):
            total = last_offset[0]
            for k in range(h.shape[1]):
                total += h[row, k] * last[k, 0]
            odds[start + row] = total
    return odds


@compiled_fast
def _hidden(x, weights, offset):  # type: ignore[no-untyped-def]
    """What a hidden layer makes of its inputs (M, I): (M, O)."""
    out = np.dot(x, weights)
    for row in range(len(out)):
        for k in range(len(offset)):
            out[row, k] = max(out[row, k] + offset[k], np.float32(0.0))
    return out


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
