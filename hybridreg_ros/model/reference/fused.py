# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Differentiable operations compiled for the CPU, each with a plain torch twin for other devices.

They walk through memory once, where the torch version makes several temporary tensors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch.nn import functional

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.model.network.forward_attention import add_geometry
from hybridreg_ros.model.network.forward_backbone import scale_and_shift

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Tensor = torch.Tensor
    F32 = NDArray[np.float32]

_EPSILON = 1e-5


def tensor_of(values: Any, like: Tensor) -> Tensor:
    """An array or tensor as a tensor on the device of another, on the CPU without a copy."""
    return torch.as_tensor(values, device=like.device)


@compiled
def _norm_forward(x: F32, gain: F32, bias: F32, groups: int, slope: float) -> tuple[F32, F32, F32]:
    scale, shift, mean, rate = scale_and_shift(x, gain, bias, groups)
    y, k = np.empty_like(x), np.float32(slope)
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            z = x[i, c] * scale[c] + shift[c]
            y[i, c] = max(z, np.float32(0.0)) + k * min(z, np.float32(0.0))
    return y, mean, rate


@compiled
def _norm_backward(
    g: F32, x: F32, y: F32, gain: F32, centre: F32, rate: F32, groups: int, slope: float
) -> tuple[F32, F32, F32]:
    n, channels = x.shape
    width = channels // groups
    d_gain, d_bias = np.zeros(channels, np.float32), np.zeros(channels, np.float32)
    k, one = np.float32(slope), np.float32(1.0)
    for i in range(n):
        for c in range(channels):
            d = g[i, c] * (one if y[i, c] > 0.0 else k)
            d_bias[c] += d
            d_gain[c] += d * (x[i, c] - centre[c]) * rate[c]
    first, second = np.empty(channels, np.float32), np.empty(channels, np.float32)
    for q in range(groups):
        a, b = q * width, (q + 1) * width
        first[a:b] = (d_bias[a:b] * gain[a:b]).sum() / (n * width)
        second[a:b] = (d_gain[a:b] * gain[a:b]).sum() / (n * width)
    dx = np.empty((n, channels), np.float32)
    for i in range(n):
        for c in range(channels):
            d = g[i, c] * (one if y[i, c] > 0.0 else k) * gain[c]
            hat = (x[i, c] - centre[c]) * rate[c]
            dx[i, c] = rate[c] * (d - first[c] - hat * second[c])
    return dx, d_gain, d_bias


class _Norm(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, x: Tensor, gain: Tensor, bias: Tensor, groups: int, slope: float
    ) -> Tensor:
        x = x.contiguous()
        rows = (v.detach().numpy()[None] for v in (gain, bias))
        y, *statistics = _norm_forward(x.detach().numpy(), *rows, groups, slope)
        out = torch.from_numpy(y)
        ctx.save_for_backward(x, out, gain)
        ctx.statistics = *statistics, groups, slope
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        x, y, gain = (t.detach().numpy() for t in ctx.saved_tensors)
        parts = _norm_backward(grads[0].contiguous().numpy(), x, y, gain, *ctx.statistics)
        return (*(torch.from_numpy(p) for p in parts), None, None)


def group_norm_act(x: Tensor, gain: Tensor, bias: Tensor, groups: int, slope: float) -> Tensor:
    """Group normalisation over the points of one cloud, then leaky ReLU.

    Args:
        x: (N, C).
        gain: (C,).
        bias: (C,).
        groups: groups of channels that share mean and variance.
        slope: of the negative side; 1 leaves the values as they are.
    """
    if x.device.type == 'cpu':
        return _Norm.apply(x.float(), gain, bias, groups, slope)  # type: ignore[no-any-return,no-untyped-call]
    y = functional.group_norm(x.t().unsqueeze(0), groups, gain, bias, _EPSILON)
    return functional.leaky_relu(y.squeeze(0).t(), slope)


@compiled
def _max_forward(x: F32, near: NDArray[np.int32]) -> tuple[F32, NDArray[np.int32]]:
    n, channels = x.shape
    out = np.zeros((near.shape[0], channels), np.float32)
    arg = np.full((near.shape[0], channels), -1, np.int32)
    for m in range(near.shape[0]):
        for h in range(near.shape[1]):
            j = near[m, h]
            if j >= n:
                break
            for c in range(channels):
                if h == 0 or x[j, c] > out[m, c]:
                    out[m, c] = x[j, c]
                    arg[m, c] = j
    return out, arg


@compiled
def _max_backward(g: F32, arg: NDArray[np.int32], n: int) -> F32:
    out = np.zeros((n, g.shape[1]), np.float32)
    for m in range(g.shape[0]):
        for c in range(g.shape[1]):
            if arg[m, c] >= 0:
                out[arg[m, c], c] += g[m, c]
    return out


class _NeighbourMax(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, near: Any) -> Tensor:
        out, arg = _max_forward(x.detach().contiguous().numpy(), np.asarray(near))
        ctx.arg, ctx.inputs = arg, x.shape[0]
        return torch.from_numpy(out)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        g = grads[0].contiguous().numpy()
        return torch.from_numpy(_max_backward(g, ctx.arg, ctx.inputs)), None


def neighbour_max(x: Tensor, near: Any) -> Tensor:
    """Largest feature among the neighbours of each output point.

    Args:
        x: (N, C) features.
        near: (M, H) int32 neighbours, array or tensor, padded with N; a row of padding gives
            zeros.

    Returns:
        (M, C).
    """
    if x.device.type == 'cpu':
        return _NeighbourMax.apply(x.float(), near)  # type: ignore[no-any-return,no-untyped-call]
    padded = torch.cat([x, x.new_full((1, x.shape[1]), -torch.inf)])
    best = padded[tensor_of(near, x).long()].amax(dim=1)
    return torch.where(torch.isinf(best), torch.zeros_like(best), best)


@compiled
def _lookup_forward(table: F32, bins: NDArray[np.int16]) -> F32:
    out = np.zeros((table.shape[0], bins.shape[0], bins.shape[1]), np.float32)
    for h in range(table.shape[0]):
        add_geometry(out[h], table[h], bins)
    return out


@compiled
def _lookup_backward(g: F32, bins: NDArray[np.int16], rows: int) -> F32:
    heads, s, others = g.shape
    count = bins.shape[2]
    out = np.zeros((heads, s, rows), np.float32)
    share = np.float32(1.0 / max(count - 1, 1))
    for n in range(s):
        for h in range(heads):
            for m in range(others):
                out[h, n, bins[n, m, 0]] += g[h, n, m]
                for k in range(1, count):
                    out[h, n, bins[n, m, k]] += g[h, n, m] * share
    return out


class _Lookup(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, table: Tensor, bins: Any) -> Tensor:
        ctx.bins, ctx.rows = np.asarray(bins), table.shape[2]
        return torch.from_numpy(_lookup_forward(table.detach().contiguous().numpy(), ctx.bins))

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        g = grads[0].contiguous().numpy()
        return torch.from_numpy(_lookup_backward(g, ctx.bins, ctx.rows)), None


def lookup_scores(table: Tensor, bins: Any) -> Tensor:
    """Geometric attention scores from per-query tables: distance term plus mean angle term.

    Args:
        table: (H, S, B) score of head h, query n with table row b.
        bins: (S, S, 1 + A) int16 rows for every pair, array or tensor: one distance, A angles.

    Returns:
        (H, S, S).
    """
    if table.device.type == 'cpu':
        return _Lookup.apply(table.float(), bins)  # type: ignore[no-any-return,no-untyped-call]
    heads, s, _ = table.shape
    rows = tensor_of(bins, table).long().reshape(1, s, -1).expand(heads, s, -1)
    values = table.gather(2, rows).view(heads, s, bins.shape[1], bins.shape[2])
    scores = values[..., 0]
    if bins.shape[2] > 1:
        scores = scores + values[..., 1:].mean(dim=3)
    return scores
