# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The geometric transformer without gradients, compiled (twin: `reference/attention.py`).

A layer is a few matrix products; look-up of the geometry, softmax and layer normalisation go
through each row while it is in the cache.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled, compiled_fast
from hybridreg_ros.model.network.forward_backbone import add_bias
from hybridreg_ros.model.network.packed import PER_ATTENTION, matrix

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    I32 = NDArray[np.int32]
    Bins = NDArray[np.int16]
    Pack = tuple[F32, NDArray[np.int64]]

_EPSILON = np.float32(1e-5)
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_LOG2_E, _LN_2 = np.float32(1.44269504), np.float32(0.693147181)
_LEAST = np.float32(-87.0)


@compiled_fast
def exponentials(x: F32, shift: float, power: I32, scale: F32) -> float:
    """exp(x - shift) of (N,) in place, relative error 3e-7; returns the sum.

    exp(r + k ln 2) is a polynomial times 2^k, whose bits are written as an integer: `power` (N,)
    is memory that `scale` (N,) reads as float32. Exponents must be below 88; those below -87 give
    about 1e-38.
    """
    low = np.float32(shift)
    for i in range(x.shape[0]):
        v = max(x[i] - low, _LEAST)
        k = np.floor(v * _LOG2_E + np.float32(0.5))
        r = v - k * _LN_2
        p = np.float32(8.3333333e-3) + r * np.float32(1.3888889e-3)
        p = np.float32(4.1666667e-2) + r * p
        p = np.float32(1.6666667e-1) + r * p
        p = np.float32(0.5) + r * p
        x[i] = _ONE + r * (_ONE + r * p)
        power[i] = (np.int32(k) + np.int32(127)) << np.int32(23)
    total = _ZERO
    for i in range(x.shape[0]):
        x[i] *= scale[i]
        total += x[i]
    return float(total)


@compiled_fast
def _attended(scores: F32, power: I32, scale: F32) -> None:
    """Softmax of every row (S, T), in place."""
    for n in range(scores.shape[0]):
        row = scores[n]
        top = row[0]
        for m in range(row.shape[0]):
            top = max(top, row[m])
        share = _ONE / exponentials(row, top, power, scale)
        for m in range(row.shape[0]):
            row[m] *= share


@compiled_fast
def add_geometry(scores: F32, table: F32, bins: Bins) -> None:
    """Add the score of the distance and the mean of those of the angles, in place.

    Args:
        scores: (S, S).
        table: (S, B) score of query n with row b of the geometry table.
        bins: (S, S, 1 + A) rows of the table for every pair.
    """
    angles = bins.shape[2] - 1
    share = np.float32(1.0 / max(angles, 1))
    for n in range(scores.shape[0]):
        row, own, at = scores[n], table[n], bins[n]
        for m in range(row.shape[0]):
            total = _ZERO
            for k in range(1, 1 + angles):
                total += own[np.uint64(at[m, k])]
            row[m] += own[np.uint64(at[m, 0])] + total * share


@compiled_fast
def _add_largest_geometry(scores: F32, asked: F32, table: F32, bins: Bins) -> None:
    """Add the products of queries with rows of the geometry table, in place.

    The row of a pair is that of its distance plus the largest of its angles, channel by channel.

    Args:
        scores: (S, S).
        asked: (S, dim) queries of a head, turned as the rows of the table would be.
        table: (B, dim).
        bins: (S, S, 1 + A) rows of the table for every pair.
    """
    for n in range(scores.shape[0]):
        for m in range(scores.shape[1]):
            at = bins[n, m]
            near, total = table[np.uint64(at[0])], _ZERO
            for c in range(table.shape[1]):
                top = table[np.uint64(at[1]), c]
                for k in range(2, at.shape[0]):
                    top = max(top, table[np.uint64(at[k]), c])
                total += asked[n, c] * (near[c] + top)
            scores[n, m] += total


@compiled_fast
def _normalised(x: F32, y: F32, gain: F32, bias: F32) -> F32:
    """Layer normalisation of x + y, (S, C)."""
    n, channels = x.shape
    out = np.empty((n, channels), np.float32)
    for i in range(n):
        row, a, b = out[i], x[i], y[i]
        total = square = _ZERO
        for c in range(channels):
            row[c] = a[c] + b[c]
            total += row[c]
        mean = total / np.float32(channels)
        for c in range(channels):
            square += (row[c] - mean) * (row[c] - mean)
        rate = _ONE / np.sqrt(square / np.float32(channels) + _EPSILON)
        for c in range(channels):
            row[c] = (row[c] - mean) * rate * gain[0, c] + bias[0, c]
    return out


@compiled
def linear(x: F32, pack: Pack, at: int) -> F32:
    """X @ weight + bias, with matrices `at` and `at + 1` of a pack."""
    y: F32 = np.dot(x, matrix(pack[0], pack[1], at))
    add_bias(y, matrix(pack[0], pack[1], at + 1))
    return y


@compiled
def rectify(x: F32) -> None:
    """ReLU of (N, C), in place."""
    for i in range(x.shape[0]):
        row = x[i]
        for c in range(x.shape[1]):
            row[c] = max(row[c], _ZERO)


@compiled
def _mixed(
    of: F32, by: F32, geometry: bool, bins: Bins, pack: Pack, at: int, heads: int, out: F32
) -> None:
    """Values of one cloud mixed for the queries of another, or of the same, heads side by side.

    Args:
        of: (S, 3 dim) queries, keys and values of the cloud that asks.
        by: (T, 3 dim) of the cloud that is asked.
        geometry: whether the layer has a geometry table.
        bins: (S, S, 1 + A) of the cloud, where there is geometry.
        pack: of the transformer; its last matrix is the table that all layers share, if any.
        at: number of the layer's own table in it, or of what turns its queries.
        heads: of the attention.
        out: (S, dim), filled.
    """
    dim = out.shape[1]
    width = dim // heads
    power = np.empty(by.shape[0], np.int32)
    scale = power.view(np.float32)
    scores = np.empty((of.shape[0], by.shape[0]), np.float32)
    for h in range(heads):
        low, high = h * width, (h + 1) * width
        q = np.ascontiguousarray(of[:, low:high])
        k = np.ascontiguousarray(by[:, dim + low : dim + high].T)
        v = np.ascontiguousarray(by[:, 2 * dim + low : 2 * dim + high])
        np.dot(q, k, scores)
        if geometry:
            asked = np.dot(q, matrix(pack[0], pack[1], at)[low:high])
            shared = matrix(pack[0], pack[1], pack[1].shape[0] - 1)
            if shared.shape[0]:
                _add_largest_geometry(scores, asked, shared, bins)
            else:
                add_geometry(scores, asked, bins)
        _attended(scores, power, scale)
        out[:, low:high] = np.dot(scores, v)


@compiled
def _finished(x: F32, mixed: F32, pack: Pack, at: int) -> F32:
    """Output of the heads, skip, norm and feed-forward, (S, dim)."""
    flat, shape = pack
    y = linear(mixed, pack, at + 2)
    z = _normalised(x, y, matrix(flat, shape, at + 4), matrix(flat, shape, at + 5))
    wide = linear(z, pack, at + 6)
    rectify(wide)
    y = linear(wide, pack, at + 8)
    out: F32 = _normalised(z, y, matrix(flat, shape, at + 10), matrix(flat, shape, at + 11))
    return out


@compiled
def self_attention(x: F32, bins: Bins, pack: Pack, at: int, heads: int) -> F32:
    """Self-attention (S, dim) with the geometry of the cloud; `at`: first matrix of the layer."""
    z = linear(x, pack, at)
    mixed = np.empty_like(x)
    _mixed(z, z, True, bins, pack, at + PER_ATTENTION - 1, heads, mixed)
    out: F32 = _finished(x, mixed, pack, at)
    return out


@compiled
def cross_attention(
    x: F32, y: F32, bins: Bins, pack: Pack, at: int, heads: int
) -> tuple[F32, F32]:
    """Both clouds, (S, dim) and (T, dim), after each has looked at the other; no geometry."""
    zx, zy = linear(x, pack, at), linear(y, pack, at)
    mx, my = np.empty_like(x), np.empty_like(y)
    _mixed(zx, zy, False, bins, pack, at, heads, mx)
    _mixed(zy, zx, False, bins, pack, at, heads, my)
    return _finished(x, mx, pack, at), _finished(y, my, pack, at)


@compiled
def unit_rows(x: F32) -> F32:
    """Rows (S, C) of unit length."""
    out = np.empty_like(x)
    for i in range(x.shape[0]):
        row, to = x[i], out[i]
        total = _ZERO
        for c in range(x.shape[1]):
            total += row[c] * row[c]
        share = _ONE / max(np.sqrt(total), np.float32(1e-12))
        for c in range(x.shape[1]):
            to[c] = row[c] * share
    return out


@compiled
def _logits(x: F32, crossed: F32, pack: Pack, at: int) -> F32:
    """Logits (S, n) of the mask."""
    flat, shape = pack
    weight, dim = matrix(flat, shape, at), x.shape[1]
    hidden = np.dot(x, weight[:dim])
    hidden += np.dot(crossed, weight[dim:])
    add_bias(hidden, matrix(flat, shape, at + 1))
    rectify(hidden)
    out: F32 = linear(hidden, pack, at + 2)
    return out


@compiled
def correlate(
    x: F32, y: F32, x_bins: Bins, y_bins: Bins, pack: Pack, blocks: int, heads: int
) -> tuple[F32, F32, F32, F32]:
    """Transformer and mask head over the superpoints of two encoded clouds.

    Args:
        x: (S, dim) features of the source, after its first self-attention.
        y: (T, dim) of the target.
        x_bins: (S, S, 1 + A) rows of the geometry table for every pair.
        y_bins: (T, T, 1 + A).
        pack: `Weights.transformer`.
        blocks: pairs of self- and cross-attention.
        heads: of the attention.

    Returns:
        (S, dim) and (T, dim) unit features, (S, n) and (T, n) logits of the mask.
    """
    at = np.int64(0)  # not a literal, for which numba would compile all once more
    before_x, before_y = x, y
    for block in range(blocks):
        if block:
            x = self_attention(x, x_bins, pack, at, heads)
            y = self_attention(y, y_bins, pack, at, heads)
        before_x, before_y = x, y
        x, y = cross_attention(x, y, x_bins, pack, at + PER_ATTENTION, heads)
        at += 2 * PER_ATTENTION
    cx, cy = cross_attention(before_x, before_y, x_bins, pack, at, heads)
    at += PER_ATTENTION
    x_logits, y_logits = _logits(before_x, cx, pack, at), _logits(before_y, cy, pack, at)
    x, y = unit_rows(linear(x, pack, at + 4)), unit_rows(linear(y, pack, at + 4))
    return x, y, x_logits, y_logits
