# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The weights of a network in a few arrays, as the compiled forward pass reads them.

Matrix i of a pack lies at `flat[shape[i, 0] :]` with `shape[i, 1]` rows and `shape[i, 2]` columns;
no rows: the network has no such matrix. Vectors are matrices of one row. The order is that of
`_backbone`, `_transformer` and `_static`, and the compiled functions count along it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import WeightsError
from hybridreg_ros.core.jit import compiled
from hybridreg_ros.model.geometry.sight import COUNT

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from typing import Any

    from numpy.typing import NDArray

    from hybridreg_ros.model.config import ModelConfig

    F32 = NDArray[np.float32]
    I64 = NDArray[np.int64]
    Pack = tuple[F32, I64]
    Matrices = Iterator[F32 | None]

PER_UNARY = 3
"""Matrices of a `Unary`: linear layer, gain, bias."""
PER_BLOCK = 12
"""Matrices of a residual block: reduce, convolution with its norm, expand, shortcut."""
PER_ATTENTION = 13
"""Matrices of an attention layer, the last of them the geometry table as each head sees it (of
angles that are not averaged: what turns the queries)."""


@dataclass(frozen=True, eq=False)
class Weights:
    """A network, packed.

    Attributes:
        backbone: stem (3), residual blocks (12 each), decoder but its last layer (3 each), last
            layer of the decoder and projection (2 each).
        transformer: self- and cross-attention of every block (13 each), cross-attention of the
            mask (13), its two layers (2 each), output (2), and the geometry table whose rows are
            asked one by one where the angles are not averaged.
        static: points (2), means (2 for each level), from above (1 for each level but the
            coarsest), fine features, own (2), around, output (2); None without a static head.
        dustbin: score of a fine point without a partner.
    """

    backbone: Pack
    transformer: Pack
    static: Pack | None
    dustbin: float


@compiled
def matrix(flat: F32, shape: I64, i: int) -> F32:
    """Matrix i of a pack, (rows, columns) without a copy."""
    first, rows, columns = shape[i]
    return flat[first : first + rows * columns].reshape(rows, columns)


def middle_width(outputs: int, config: ModelConfig) -> int:
    """Width at which a residual block of so many outputs convolves."""
    return max(outputs // config.bottleneck, 8)


def packed(config: ModelConfig, parameters: Mapping[str, NDArray[Any]]) -> Weights:
    """The parameters of a network by name, packed.

    Raises:
        WeightsError: one is missing, unknown, or of another shape than the config says.
    """
    read = _Reader(parameters)
    found = Weights(
        _pack(_backbone(read, config)),
        _pack(_transformer(read, config)),
        _pack(_static(read, config)) if config.static_width else None,
        float(read('transport.dustbin')),
    )
    if read.left:
        names = ', '.join(sorted(read.left)[:2])
        raise WeightsError(f'{len(read.left)} unknown parameters ({names})')
    return found


class _Reader:
    """Parameters by name and shape; `left` are those that nobody has asked for yet."""

    def __init__(self, parameters: Mapping[str, NDArray[Any]]) -> None:
        self.left = dict(parameters)

    def __call__(self, name: str, *shape: int) -> F32:
        found = self.left.pop(name, None)
        if found is None:
            raise WeightsError(f'parameter {name} is missing')
        if found.shape != shape:
            raise WeightsError(f'{name} expected shape {shape}, found {found.shape}')
        return found.astype(np.float32)

    def linear(self, name: str, inputs: int, outputs: int) -> Iterator[F32]:
        """Weight (inputs, outputs) and bias."""
        yield self.turned(name, inputs, outputs)
        yield self(f'{name}.bias', outputs)

    def turned(self, name: str, inputs: int, outputs: int) -> F32:
        """Weight (inputs, outputs) of a linear layer, stored the other way round."""
        return self(f'{name}.weight', outputs, inputs).T

    def norm(self, name: str, channels: int) -> Iterator[F32]:
        """Gain and bias."""
        yield from (self(f'{name}.weight', channels), self(f'{name}.bias', channels))

    def unary(self, name: str, inputs: int, outputs: int) -> Iterator[F32]:
        """The matrices of a `Unary`."""
        yield self.turned(f'{name}.linear', inputs, outputs)
        yield from self.norm(f'{name}.norm', outputs)


def _pack(matrices: Matrices) -> Pack:
    """Matrices and vectors one after the other; None leaves a place without rows."""
    parts, shape, size = [], [], 0
    for m in matrices:
        if m is None:
            shape.append((0, 0, 0))
            continue
        array = np.atleast_2d(m)
        parts.append(array.ravel())
        shape.append((size, *array.shape))
        size += array.size
    return np.concatenate(parts), np.array(shape, np.int64)


def _backbone(read: _Reader, config: ModelConfig) -> Matrices:
    widths, last = config.widths, config.levels - 1
    yield read('backbone.stem.weight', config.kernel_points, config.stem)
    yield from read.norm('backbone.stem_norm', config.stem)
    yield from _residual(read, 'backbone.first', config.stem, widths[0], config)
    for i in range(last):
        inputs, outputs = widths[i : i + 2]
        yield from _residual(read, f'backbone.strided.{i}', inputs, inputs, config)
        for k in range(1 + config.extra_blocks):
            name = f'backbone.stages.{i}.{k}'
            yield from _residual(read, name, outputs if k else inputs, outputs, config)
    width = widths[-1]
    for step, level in enumerate(range(last - 1, config.fine_level - 1, -1)):
        name, inputs = f'backbone.decoder.{step}', width + widths[level]
        if level == config.fine_level:
            yield from read.linear(name, inputs, config.fine_dim)
        else:
            yield from read.unary(name, inputs, widths[level])
        width = widths[level]
    yield from read.linear('project', widths[-1], config.dim)


def _residual(
    read: _Reader, name: str, inputs: int, outputs: int, config: ModelConfig
) -> Matrices:
    middle = middle_width(outputs, config)
    none = (None,) * PER_UNARY
    yield from read.unary(f'{name}.reduce', inputs, middle) if inputs != middle else none
    yield read(f'{name}.conv.weight', config.kernel_points * middle, middle)
    yield from read.norm(f'{name}.norm', middle)
    yield from read.unary(f'{name}.expand', middle, outputs)
    yield from read.unary(f'{name}.shortcut', inputs, outputs) if inputs != outputs else none


def _transformer(read: _Reader, config: ModelConfig) -> Matrices:
    dim, table, averaged = config.dim, _table(read, config), config.angle_reduction == 'mean'
    for i in range(config.blocks):
        yield from _attention(read, f'self_layers.{i}', config)
        # (heads * width, bins): the rows of one head are its own matrix
        position = read(f'self_layers.{i}.position.weight', dim, dim)
        yield position @ table.T if averaged else position
        yield from _attention(read, f'cross_layers.{i}', config)
        yield None
    yield from _attention(read, 'mask.cross', config)
    yield None
    yield from read.linear('mask.hidden', 2 * dim, dim)
    yield from read.linear('mask.output', dim, config.mask_outputs)
    yield from read.linear('output', dim, dim)
    yield None if averaged else table


def _attention(read: _Reader, name: str, config: ModelConfig) -> Matrices:
    """Scaled queries, keys and values in one product, then the rest in its order."""
    dim, scale = config.dim, (config.dim // config.heads) ** -0.5
    q, k, v = (
        tuple(read.linear(f'{name}.{part}', dim, dim)) for part in ('query', 'key', 'value')
    )
    for ours, key, value in zip(q, k, v, strict=True):
        yield np.concatenate([ours * scale, key, value], axis=-1)
    yield from read.linear(f'{name}.merge', dim, dim)
    yield from read.norm(f'{name}.norm', dim)
    yield from read.linear(f'{name}.feed.widen', dim, 2 * dim)
    yield from read.linear(f'{name}.feed.narrow', 2 * dim, dim)
    yield from read.norm(f'{name}.feed.norm', dim)


def _table(read: _Reader, config: ModelConfig) -> F32:
    """Rows (B, dim) of the pairwise embedding: distance bins, then angle bins."""
    dim, waves = config.dim, bin_sinusoids(config)
    distance, bias = read.linear('table.distance', dim, dim)
    return np.concatenate(
        [
            waves[: config.distance_bins] @ distance + bias,
            waves[config.distance_bins :] @ read.turned('table.angle', dim, dim),
        ]
    )


def bin_sinusoids(config: ModelConfig) -> F32:
    """Sinusoids (B, dim) of the distance bins, then of the angle bins."""
    distance = np.arange(config.distance_bins, dtype=np.float32) * config.distance_step
    angle = np.arange(config.angle_bins, dtype=np.float32) * (180.0 / (config.angle_bins - 1))
    phases = distance / config.sigma_distance, angle / config.sigma_angle_deg
    return sinusoids(np.concatenate(phases), config.dim)


def sinusoids(values: F32, dim: int) -> F32:
    """Sine and cosine of values (N,) at dim / 2 frequencies from 1 down to 1e-4: (N, dim)."""
    half = np.arange(0, dim, 2, dtype=np.float32)
    phase = values[:, None] * np.exp(half * (-math.log(10_000.0) / dim))
    return np.stack([np.sin(phase), np.cos(phase)], axis=2).reshape(len(values), dim)


def _static(read: _Reader, config: ModelConfig) -> Matrices:
    width = config.static_width
    yield from read.linear('static.point', COUNT + 2, width)
    for level in range(config.levels):
        yield from read.linear(f'static.mean.{level}', width, width)
    for level in range(config.levels - 1):
        yield read.turned(f'static.above.{level}', width, width)
    yield read.turned('static.fine', config.fine_dim, width)
    yield from read.linear('static.own', width, width)
    yield read.turned('static.around', width, width)
    yield from read.linear('static.output', width, 2)
