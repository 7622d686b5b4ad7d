# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sinkhorn: marginals, masks, stability, gradient."""

from __future__ import annotations

import pytest
import torch

from hybridreg_ros.model.network.matching import MASKED
from hybridreg_ros.model.network.sinkhorn import log_assignments
from hybridreg_ros.model.reference.transport import Transport


def _masks() -> tuple[torch.Tensor, torch.Tensor]:
    rows, columns = torch.ones(3, 8, dtype=torch.bool), torch.ones(3, 10, dtype=torch.bool)
    rows[1, 5:], columns[2, 7:] = False, False
    return rows, columns


@pytest.mark.parametrize('scale', [1.0, 30.0, 300.0])
def test_marginals(scale: float) -> None:
    torch.manual_seed(0)
    rows, columns = _masks()
    log = Transport(200)(scale * torch.randn(3, 8, 10), rows, columns)
    assert torch.isfinite(log).all()
    p = log.exp()
    if scale < 100.0:
        torch.testing.assert_close(p.sum(1)[:, :10], columns.float(), atol=1e-4, rtol=0)
        torch.testing.assert_close(p.sum(2)[:, :8], rows.float(), atol=2e-2, rtol=0)


def test_equals_logarithmic_sinkhorn() -> None:
    torch.manual_seed(0)
    scores, transport = 4.0 * torch.randn(2, 6, 6), Transport(20)
    full = torch.ones(2, 6, dtype=torch.bool)
    padded = torch.ones(2, 7, 7)
    padded[:, :6, :6] = scores
    mass = torch.ones(2, 7)
    mass[:, 6] = 6.0
    f, g = torch.zeros(2, 7), torch.zeros(2, 7)
    for _ in range(20):
        f = mass.log() - torch.logsumexp(padded + g[:, None, :], dim=2)
        g = mass.log() - torch.logsumexp(padded + f[:, :, None], dim=1)
    expected = padded + f[:, :, None] + g[:, None, :]
    torch.testing.assert_close(transport(scores, full, full), expected, atol=1e-4, rtol=1e-4)


def test_masked_entries_carry_nothing_and_change_nothing() -> None:
    torch.manual_seed(0)
    rows, columns = _masks()
    scores = torch.randn(3, 8, 10)
    transport = Transport(20)
    before = transport(scores, rows, columns)
    assert (before[1, 5:8] == MASKED).all()
    changed = scores.clone()
    changed[1, 5:] = 9.0
    torch.testing.assert_close(transport(changed, rows, columns), before)
    alone = transport(scores[1:2, :5], rows[1:2, :5], columns[1:2])
    torch.testing.assert_close(before[1, :5, :10], alone[0, :5, :10])


def test_gradient_reaches_scores_and_dustbin() -> None:
    torch.manual_seed(0)
    transport, scores = Transport(5), torch.randn(3, 8, 10, requires_grad=True)
    log = transport(scores, *_masks())
    log[log > 0.5 * MASKED].sum().backward()
    assert scores.grad is not None
    assert torch.isfinite(scores.grad).all()
    assert (scores.grad[1, 5:] == 0).all()
    assert transport.dustbin.grad is not None
    assert torch.isfinite(transport.dustbin.grad)


def test_gradient_equals_finite_differences() -> None:
    torch.manual_seed(0)
    transport = Transport(4).double()
    full = torch.ones(2, 5, dtype=torch.bool)
    scores = torch.randn(2, 5, 5, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda s: transport(s, full, full), scores, atol=1e-6)


@pytest.mark.parametrize('scale', [1.0, 30.0, 300.0])
def test_compiled_twin_without_gradient_gives_the_same(scale: float) -> None:
    torch.manual_seed(0)
    rows, columns = _masks()
    rows[0], columns[1] = False, False  # nothing real on one side
    transport, scores = Transport(20), scale * torch.randn(3, 8, 10)
    with_gradient = transport(scores, rows, columns).detach()
    arrays = (x.numpy() for x in (scores, rows, columns))
    compiled = torch.from_numpy(
        log_assignments(*arrays, float(transport.dustbin.detach()), 20, MASKED)
    )
    assert torch.equal(compiled == MASKED, with_gradient == MASKED)
    torch.testing.assert_close(compiled.exp(), with_gradient.exp(), atol=1e-4, rtol=1e-4)
