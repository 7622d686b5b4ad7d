# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""KPConv-FPN without gradients in one compiled call (twin: `reference/backbone.py`).

A residual block gathers a few hundred points at a time, so that what the kernel points gathered is
still in the cache when the matrix product reads it; normalisation, skip connection and activation
walk through memory once.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled, compiled_fast
from hybridreg_ros.model.network.packed import PER_BLOCK, PER_UNARY, matrix

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]
    I32 = NDArray[np.int32]
    I64 = NDArray[np.int64]
    Operator = tuple[I32, I32, F32]
    Pack = tuple[F32, I64]

SLOPE = np.float32(0.1)
_EPSILON = 1e-5
_SUM_ROWS = 64
_GATHERED = 131_072
"""Numbers that the kernel points gather before they meet the weights: 512 kB."""


@compiled_fast
def scale_and_shift(x: F32, gain: F32, bias: F32, groups: int) -> tuple[F32, F32, F32, F32]:
    """What group normalisation over the points (N, C) multiplies with and adds, (C,) each.

    And the mean of every channel's group and one over its standard deviation, (C,) each.
    """
    n, channels = x.shape
    width = channels // math.gcd(groups, channels)
    total, square = np.zeros(channels), np.zeros(channels)
    a, b = np.empty(channels, np.float32), np.empty(channels, np.float32)
    means, rates = np.empty(channels, np.float32), np.empty(channels, np.float32)
    for first in range(0, n, _SUM_ROWS):  # short float32 sums, gathered in float64
        a[:] = np.float32(0.0)
        b[:] = np.float32(0.0)
        for i in range(first, min(first + _SUM_ROWS, n)):
            row = x[i]
            for c in range(channels):
                a[c] += row[c]
                b[c] += row[c] * row[c]
        for c in range(channels):
            total[c] += a[c]
            square[c] += b[c]
    for low in range(0, channels, width):
        high = low + width
        mean = total[low:high].sum() / (n * width)
        variance = max(square[low:high].sum() / (n * width) - mean * mean, 0.0)
        rate = 1.0 / np.sqrt(variance + _EPSILON)
        for c in range(low, high):
            a[c] = gain[0, c] * rate
            b[c] = bias[0, c] - mean * a[c]
            means[c], rates[c] = mean, rate
    return a, b, means, rates


@compiled_fast
def _normalise(x: F32, gain: F32, bias: F32, groups: int) -> None:
    """Group normalisation and leaky ReLU of (N, C), in place."""
    scale, shift, _, _ = scale_and_shift(x, gain, bias, groups)
    for i in range(x.shape[0]):
        row = x[i]
        for c in range(x.shape[1]):
            z = row[c] * scale[c] + shift[c]
            row[c] = max(z, SLOPE * z)


@compiled_fast
def gather(x: F32, operator: Operator, entry: int, stop: int, low: int, out: F32) -> None:
    """What the entries entry ... stop of a sparse operator gather; `out` begins with row `low`."""
    rows, columns, weights = operator
    out[:] = np.float32(0.0)
    for e in range(entry, stop):
        w, to, of = weights[e], out[np.uint64(rows[e] - low)], x[np.uint64(columns[e])]
        for c in range(x.shape[1]):
            to[c] += w * of[c]


@compiled
def _convolved(x: F32, operator: Operator, outputs: int, weight: F32) -> F32:
    """KPConv: features (N, C) to (outputs, C_out)."""
    channels = x.shape[1]
    kernel = weight.shape[0] // channels
    step = min(max(32, _GATHERED // weight.shape[0]), outputs)
    gathered = np.empty((step, weight.shape[0]), np.float32)
    out = np.empty((outputs, weight.shape[1]), np.float32)
    single = gathered.reshape(step * kernel, channels)
    entry = 0
    for first in range(0, outputs, step):
        count = min(step, outputs - first)
        stop = np.searchsorted(operator[0], (first + count) * kernel)
        gather(x, operator, entry, stop, first * kernel, single[: count * kernel])
        np.dot(gathered[:count], weight, out[first : first + count])
        entry = stop
    return out


@compiled_fast
def _largest(x: F32, near: I32) -> F32:
    """Largest feature among the neighbours (M, H) of each output, zeros without any: (M, C)."""
    n, channels = x.shape
    out = np.zeros((near.shape[0], channels), np.float32)
    for m in range(near.shape[0]):
        row = out[m]
        for h in range(near.shape[1]):
            j = near[m, h]
            if j >= n:
                break
            other = x[j]
            if h == 0:
                row[:] = other
                continue
            for c in range(channels):
                row[c] = max(row[c], other[c])
    return out


@compiled_fast
def _joined(y: F32, scale: F32, shift: F32, kept: F32, rate: F32, add: F32) -> None:
    """Leaky ReLU of y * scale + shift + kept * rate + add, (N, C), in place of y."""
    for i in range(y.shape[0]):
        row, other = y[i], kept[i]
        for c in range(y.shape[1]):
            z = row[c] * scale[c] + shift[c] + other[c] * rate[c] + add[c]
            row[c] = max(z, SLOPE * z)


@compiled
def _residual(
    x: F32, operator: Operator, outputs: int, near: I32, pack: Pack, at: int, groups: int
) -> F32:
    """A residual block; `near` (M, H) of a strided one, (0, 0) otherwise: (M, C_out)."""
    flat, shape = pack
    z = x
    if shape[at, 1]:
        z = np.dot(x, matrix(flat, shape, at))
        _normalise(z, matrix(flat, shape, at + 1), matrix(flat, shape, at + 2), groups)
    z = _convolved(z, operator, outputs, matrix(flat, shape, at + 3))
    _normalise(z, matrix(flat, shape, at + 4), matrix(flat, shape, at + 5), groups)
    y: F32 = np.dot(z, matrix(flat, shape, at + 6))
    scale, shift, _, _ = scale_and_shift(
        y, matrix(flat, shape, at + 7), matrix(flat, shape, at + 8), groups
    )
    kept = _largest(x, near) if near.shape[0] else x
    rate, add = np.ones(y.shape[1], np.float32), np.zeros(y.shape[1], np.float32)
    if shape[at + 9, 1]:
        kept = np.dot(kept, matrix(flat, shape, at + 9))
        rate, add, _, _ = scale_and_shift(
            kept, matrix(flat, shape, at + 10), matrix(flat, shape, at + 11), groups
        )
    _joined(y, scale, shift, kept, rate, add)
    return y


@compiled
def _raised(skip: F32, fine: F32, up: I64, weight: F32) -> F32:
    """[skip, fine[up]] @ weight without the rows that `up` repeats."""
    own = skip.shape[1]
    out: F32 = np.dot(skip, weight[:own])
    coarse = np.dot(fine, weight[own:])
    for i in range(out.shape[0]):
        row, other = out[i], coarse[up[i]]
        for c in range(out.shape[1]):
            row[c] += other[c]
    return out


@compiled
def _stem(operator: Operator, outputs: int, weight: F32) -> F32:
    """KPConv of ones: (outputs, C)."""
    rows, _, weights = operator
    sums = np.zeros(outputs * weight.shape[0], np.float32)
    for e in range(weights.shape[0]):
        sums[rows[e]] += weights[e]
    out: F32 = np.dot(sums.reshape(outputs, weight.shape[0]), weight)
    return out


@compiled
def add_bias(x: F32, bias: F32) -> None:
    """Add a vector (1, C) to every row (N, C), in place."""
    for i in range(x.shape[0]):
        row = x[i]
        for c in range(x.shape[1]):
            row[c] += bias[0, c]


@compiled
def backbone(
    pack: Pack,
    convolutions: tuple[Operator, ...],
    pools: tuple[Operator, ...],
    pool_index: tuple[I32, ...],
    up_index: tuple[I64, ...],
    blocks: int,
    fine_level: int,
    groups: int,
) -> tuple[F32, F32]:
    """Features of one cloud.

    Args:
        pack: `Weights.backbone`.
        convolutions: kernel operator of every level, finest first.
        pools: of every level but the coarsest, to the next coarser one.
        pool_index: (M, H) int32 neighbours of the coarser points, padded with N.
        up_index: (N,) int64 coarser point of each point.
        blocks: residual blocks per level after the strided one.
        fine_level: level of the fine points.
        groups: of the normalisation.

    Returns:
        (F, fine_dim) of the fine points and (S, dim) projected features of the superpoints.
    """
    flat, shape = pack
    none = np.zeros((0, 0), np.int32)
    x = _stem(convolutions[0], up_index[0].shape[0], matrix(flat, shape, 0))
    _normalise(x, matrix(flat, shape, 1), matrix(flat, shape, 2), groups)
    at = np.int64(3)  # not a literal, for which numba would compile all once more
    x = _residual(x, convolutions[0], x.shape[0], none, pack, at, groups)
    at += PER_BLOCK
    skips = [x]
    for level in range(len(pools)):
        near = pool_index[level]
        x = _residual(x, pools[level], near.shape[0], near, pack, at, groups)
        at += PER_BLOCK
        for _ in range(blocks):
            operator = convolutions[level + 1]
            x = _residual(x, operator, x.shape[0], none, pack, at, groups)
            at += PER_BLOCK
        skips.append(x)
    fine = x
    for level in range(len(pools) - 1, fine_level - 1, -1):
        fine = _raised(skips[level], fine, up_index[level], matrix(flat, shape, at))
        if level > fine_level:
            _normalise(fine, matrix(flat, shape, at + 1), matrix(flat, shape, at + 2), groups)
            at += PER_UNARY
        else:
            add_bias(fine, matrix(flat, shape, at + 1))
            at += 2
    coarse = np.dot(x, matrix(flat, shape, at))
    add_bias(coarse, matrix(flat, shape, at + 1))
    return fine, coarse
