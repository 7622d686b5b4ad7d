# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""KPConv against a naive loop, and its gradient against the plain sparse product."""

from __future__ import annotations

import numpy as np
import torch

from hybridreg_ros.model.geometry.kernel import KernelOperator, kernel_operator, kernel_points
from hybridreg_ros.model.geometry.neighbours import CellList
from hybridreg_ros.model.reference.backbone import KPConv, aggregate, influence_sums


def _operator(
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, KernelOperator]:
    support = rng.uniform(0, 4, (60, 3)).astype(np.float32)
    queries = rng.uniform(-1, 5, (25, 3)).astype(np.float32)
    near = CellList.build(support, 1.5).search(queries, 1.5, 9)
    kernel = kernel_points(7, 0.8)
    return queries, support, near, kernel_operator(queries, support, near, kernel, 0.9)


def test_kernel_points_are_even() -> None:
    points = kernel_points(15, 1.5)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), [0.0] + [1.5] * 14, atol=1e-6)
    gaps = np.linalg.norm(points[:, None] - points[None], axis=2) + 9.0 * np.eye(15)
    assert gaps.min() > 0.8
    assert np.abs(points.mean(axis=0)).max() < 0.1


def test_convolution_equals_naive_loop(rng: np.random.Generator) -> None:
    queries, support, near, operator = _operator(rng)
    conv = KPConv(7, 4, 5)
    x = torch.randn(60, 4, generator=torch.Generator().manual_seed(1))
    weights = conv.weight.detach().numpy().reshape(7, 4, 5)
    kernel, expected = kernel_points(7, 0.8), np.zeros((25, 5))
    for m in range(25):
        valid = [j for j in near[m] if j < 60]
        for j in valid:
            offset = support[j] - queries[m]
            for k in range(7):
                influence = max(0.0, 1.0 - np.linalg.norm(offset - kernel[k]) / 0.9)
                expected[m] += influence * (x[j].numpy() @ weights[k]) / len(valid)
    np.testing.assert_allclose(conv(x, operator).detach(), expected, atol=1e-5)
    assert (near == 60).all(axis=1).any(), 'no query without neighbours in this test'


def test_gradient_equals_that_of_the_sparse_product(rng: np.random.Generator) -> None:
    operator = _operator(rng)[3]
    x = torch.randn(60, 4, requires_grad=True)
    twin = x.detach().clone().requires_grad_()
    out = aggregate(x, operator)
    out.square().sum().backward()
    at = torch.from_numpy(operator.rows), torch.from_numpy(operator.columns)
    weights = torch.from_numpy(operator.weights)
    dense = torch.zeros(25 * 7, 60).index_put_(at, weights, accumulate=True)
    (dense @ twin).square().sum().backward()
    torch.testing.assert_close(out, (dense @ twin).view(25, -1))
    torch.testing.assert_close(x.grad, twin.grad)


def test_influence_sums_are_what_ones_aggregate_to(rng: np.random.Generator) -> None:
    operator = _operator(rng)[3]
    ones = torch.ones(60, 1)
    sums = influence_sums(operator, ones)
    assert float(sums.max()) > 0.0
    torch.testing.assert_close(sums, aggregate(ones, operator))


def test_no_gradient_is_made_for_constant_input(rng: np.random.Generator) -> None:
    conv = KPConv(7, 1, 3)
    conv(torch.ones(60, 1), _operator(rng)[3]).sum().backward()
    assert conv.weight.grad is not None
    assert conv.weight.grad.abs().sum() > 0
