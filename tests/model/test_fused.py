# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Compiled differentiable operations against their torch twins, values and gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.nn import functional

from hybridreg_ros.model.reference.fused import group_norm_act, lookup_scores, neighbour_max


@pytest.mark.parametrize('slope', [0.1, 1.0])
@pytest.mark.parametrize('rows', [1, 57])
def test_group_norm_equals_torch(slope: float, rows: int) -> None:
    torch.manual_seed(0)
    x = (3.0 * torch.randn(rows, 24) + 1.0).requires_grad_()
    gain, bias = torch.randn(24, requires_grad=True), torch.randn(24, requires_grad=True)
    upstream = torch.randn(rows, 24)
    got = group_norm_act(x, gain, bias, 8, slope)
    grads = torch.autograd.grad(got, (x, gain, bias), upstream)
    normed = functional.group_norm(x.t()[None], 8, gain, bias)[0].t()
    expected = functional.leaky_relu(normed, slope)
    wanted = torch.autograd.grad(expected, (x, gain, bias), upstream)
    torch.testing.assert_close(got, expected, atol=2e-5, rtol=1e-4)
    for a, b in zip(grads, wanted, strict=True):
        torch.testing.assert_close(a, b, atol=2e-4, rtol=1e-3)


def test_neighbour_max_equals_torch() -> None:
    torch.manual_seed(0)
    x = torch.randn(20, 6, requires_grad=True)
    near = torch.randint(0, 20, (9, 4), dtype=torch.int32)
    near[2, 2:], near[3] = 20, 20
    got = neighbour_max(x, near)
    padded = torch.cat([x, torch.full((1, 6), -torch.inf)])
    expected = padded[near.long()].amax(dim=1)
    expected = torch.where(torch.isinf(expected), 0.0, expected)
    torch.testing.assert_close(got, expected)
    upstream = torch.randn(9, 6)
    near[near == 20] = 19  # amax splits ties of repeated rows; compare sums per channel instead
    (grad,) = torch.autograd.grad(got, x, upstream)
    rows = [m for m in range(9) if m != 3]
    torch.testing.assert_close(grad.sum(0), upstream[rows].sum(0))
    assert (grad != 0).sum() <= 8 * 6


def test_neighbour_max_keeps_negative_values() -> None:
    x = -torch.ones(3, 2) * torch.tensor([[3.0], [2.0], [1.0]])
    near = torch.tensor([[0, 1], [2, 3]], dtype=torch.int32)
    torch.testing.assert_close(neighbour_max(x, near), torch.tensor([[-2.0, -2.0], [-1.0, -1.0]]))


@pytest.mark.parametrize('angles', [0, 3])
def test_lookup_equals_gather(angles: int) -> None:
    torch.manual_seed(0)
    table = torch.randn(2, 11, 30, requires_grad=True)
    bins = torch.randint(0, 30, (11, 11, 1 + angles), dtype=torch.int16)
    got = lookup_scores(table, bins)
    n = torch.arange(11)[:, None, None]
    values = table[:, n, bins.long()]
    expected = values[..., 0] + (values[..., 1:].mean(-1) if angles else 0.0)
    torch.testing.assert_close(got, expected)
    upstream = torch.from_numpy(np.random.default_rng(0).normal(size=got.shape)).float()
    a = torch.autograd.grad(got, table, upstream)[0]
    b = torch.autograd.grad(expected, table, upstream)[0]
    torch.testing.assert_close(a, b, atol=1e-5, rtol=1e-5)
