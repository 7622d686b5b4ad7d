# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""KPConv-FPN: fine features and superpoint features of one cloud (Thomas et al. 2019)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import nn

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.model.network.forward_backbone import gather
from hybridreg_ros.model.network.packed import middle_width
from hybridreg_ros.model.reference.fused import group_norm_act, neighbour_max, tensor_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.model.geometry.kernel import KernelOperator
    from hybridreg_ros.model.geometry.pyramid import Pyramid

    Tensor = torch.Tensor

SLOPE = 0.1


@compiled
def _weighted_rows(
    x: NDArray[np.float32],
    read: NDArray[np.int32],
    write: NDArray[np.int32],
    weights: NDArray[np.float32],
    count: int,
) -> NDArray[np.float32]:
    """Rows `read` of x (·, C) times the weights, added up in rows `write` of (count, C)."""
    out = np.empty((count, x.shape[1]), np.float32)
    gather(x, (write, read, weights), 0, weights.shape[0], 0, out)
    return out


class _Aggregate(torch.autograd.Function):
    """Sparse product on the CPU: compiled gather forward, compiled scatter backward."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, operator: KernelOperator) -> Tensor:
        ctx.operator = operator
        rows, columns, weights = _arrays(operator)
        count = operator.outputs * operator.kernel_points
        values = x.detach().contiguous().numpy()
        return torch.from_numpy(_weighted_rows(values, columns, rows, weights, count))

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, None]:
        if not ctx.needs_input_grad[0]:
            return None, None
        rows, columns, weights = _arrays(ctx.operator)
        g = grads[0].contiguous().numpy()
        return torch.from_numpy(
            _weighted_rows(g, rows, columns, weights, ctx.operator.inputs)
        ), None


def _arrays(
    operator: KernelOperator,
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]:
    """Rows, columns and weights, whether they are arrays or tensors."""
    return np.asarray(operator.rows), np.asarray(operator.columns), np.asarray(operator.weights)


def aggregate(x: Tensor, operator: KernelOperator) -> Tensor:
    """Features gathered by every kernel point.

    Args:
        x: (N, C) float32 input features.
        operator: influence weights from N inputs to M outputs.

    Returns:
        (M, K * C) float32, ready for one matrix product with the (K * C, C_out) weights.
    """
    if x.device.type == 'cpu':
        gathered = _Aggregate.apply(x.float(), operator)  # type: ignore[no-untyped-call]
    else:
        matrix = torch.sparse_coo_tensor(
            torch.stack([tensor_of(a, x) for a in (operator.rows, operator.columns)]),
            tensor_of(operator.weights, x),
            (operator.outputs * operator.kernel_points, operator.inputs),
            is_coalesced=True,
        )
        with torch.autocast(x.device.type, enabled=False):
            gathered = matrix @ x.float()
    return gathered.view(operator.outputs, -1)  # type: ignore[no-any-return]


def influence_sums(operator: KernelOperator, like: Tensor) -> Tensor:
    """What `aggregate` makes of ones: (M, K) float32, sum of the influences of every row.

    Args:
        operator: influence weights to M outputs.
        like: a tensor on the device of the result.
    """
    sums = torch.zeros(operator.outputs * operator.kernel_points, device=like.device)
    rows, weights = tensor_of(operator.rows, like), tensor_of(operator.weights, like)
    return sums.index_add_(0, rows, weights).view(operator.outputs, -1)


class Norm(nn.Module):
    """Group normalisation of one cloud, followed by leaky ReLU unless `activate` is False."""

    def __init__(self, channels: int, groups: int, activate: bool = True) -> None:
        super().__init__()
        self.groups = math.gcd(groups, channels)
        self.slope = SLOPE if activate else 1.0
        self.weight = nn.Parameter(torch.ones(channels))
        self.bias = nn.Parameter(torch.zeros(channels))

    def forward(self, x: Tensor) -> Tensor:
        """Features (N, C) to (N, C)."""
        return group_norm_act(x, self.weight, self.bias, self.groups, self.slope)


class KPConv(nn.Module):
    """Rigid kernel point convolution: gather by influence, then one matrix product."""

    def __init__(self, kernel_points: int, inputs: int, outputs: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(kernel_points * inputs, outputs))
        bound = math.sqrt(3.0 / (inputs * kernel_points / 3.0))
        nn.init.uniform_(self.weight, -bound, bound)

    def forward(self, x: Tensor, operator: KernelOperator) -> Tensor:
        """Features (N, C_in) of the inputs to (M, C_out) of the outputs of `operator`."""
        return aggregate(x, operator) @ self.weight


class Unary(nn.Module):
    """Linear layer, group normalisation, and leaky ReLU unless `activate` is False."""

    def __init__(self, inputs: int, outputs: int, groups: int, activate: bool = True) -> None:
        super().__init__()
        self.linear = nn.Linear(inputs, outputs, bias=False)
        self.norm = Norm(outputs, groups, activate)

    def forward(self, x: Tensor) -> Tensor:
        """Features (N, C_in) to (N, C_out)."""
        out: Tensor = self.norm(self.linear(x))
        return out


class Residual(nn.Module):
    """Bottleneck block: 1x1, KPConv, 1x1, plus the input (max-pooled when strided)."""

    def __init__(self, inputs: int, outputs: int, config: ModelConfig) -> None:
        super().__init__()
        middle, groups = middle_width(outputs, config), config.groups
        self.reduce = Unary(inputs, middle, groups) if inputs != middle else nn.Identity()
        self.conv = KPConv(config.kernel_points, middle, middle)
        self.norm = Norm(middle, groups)
        self.expand = Unary(middle, outputs, groups, activate=False)
        self.shortcut: nn.Module = nn.Identity()
        if inputs != outputs:
            self.shortcut = Unary(inputs, outputs, groups, activate=False)

    def forward(self, x: Tensor, operator: KernelOperator, pool: Any = None) -> Tensor:
        """Features (N, C_in) to (M, C_out); `pool` (M, H): neighbours of a strided block."""
        y = self.expand(self.norm(self.conv(self.reduce(x), operator)))
        kept = x if pool is None else neighbour_max(x, pool)
        return nn.functional.leaky_relu(y + self.shortcut(kept), SLOPE)


class Backbone(nn.Module):
    """Encoder over all levels, decoder down to the fine level."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        widths, groups = config.widths, config.groups
        self.fine_level = config.fine_level
        self.stem = KPConv(config.kernel_points, 1, config.stem)
        self.stem_norm = Norm(config.stem, groups)
        self.first = Residual(config.stem, widths[0], config)
        self.strided = nn.ModuleList(Residual(w, w, config) for w in widths[:-1])
        self.stages = nn.ModuleList(
            nn.ModuleList(
                Residual(widths[i] if k == 0 else widths[i + 1], widths[i + 1], config)
                for k in range(1 + config.extra_blocks)
            )
            for i in range(len(widths) - 1)
        )
        self.decoder = nn.ModuleList()
        for level in range(len(widths) - 2, config.fine_level - 1, -1):
            inputs = widths[level + 1] + widths[level]
            if level == config.fine_level:
                self.decoder.append(nn.Linear(inputs, config.fine_dim))
            else:
                self.decoder.append(Unary(inputs, widths[level], groups))

    def forward(self, pyramid: Pyramid) -> tuple[Tensor, Tensor]:
        """Features of one cloud.

        Returns:
            (F, fine_dim) of the fine points and (S, widths[-1]) of the superpoints.
        """
        levels = pyramid.levels
        assert levels[0].conv is not None, 'this pyramid was stripped once it was encoded'
        ones = influence_sums(levels[0].conv, self.stem.weight)  # the input: ones
        x = self.stem_norm(ones @ self.stem.weight)
        x = self.first(x, levels[0].conv)
        skips = [x]
        for i, (strided, blocks) in enumerate(zip(self.strided, self.stages, strict=True)):
            x = strided(x, levels[i].pool, levels[i].pool_index)
            for block in blocks:  # type: ignore[attr-defined]
                x = block(x, levels[i + 1].conv)
            skips.append(x)
        fine = x
        for step, layer in enumerate(self.decoder):
            level = len(levels) - 2 - step
            fine = layer(
                torch.cat([skips[level], fine[tensor_of(levels[level].up_index, fine)]], dim=1)
            )
        return fine, x
