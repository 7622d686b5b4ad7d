# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch.nn import functional as F

from hybridreg_ros.training import losses


@pytest.fixture
def pair():
    generator = torch.Generator().manual_seed(0)
    f = torch.nn.functional.normalize(torch.randn(6, 8, generator=generator), dim=1)
    g = torch.nn.functional.normalize(torch.randn(5, 8, generator=generator), dim=1)
    overlap = torch.rand(6, 5, generator=generator)
    overlap[overlap < 0.6] = 0.0
    overlap[2] = 0.0
    overlap[3, 1] = 0.05
    return (f @ g.T).requires_grad_(), overlap


def naive_cross_entropy(s, overlap, temperature, positive):
    total = weights = 0.0
    for i in range(s.shape[0]):
        row = [float(o) if o > positive else 0.0 for o in overlap[i]]
        if max(row) == 0.0:
            continue
        z = sum(math.exp(float(x) / temperature) for x in s[i])
        nll = 0.0
        for j, o in enumerate(row):
            nll -= o / sum(row) * math.log(math.exp(float(s[i, j]) / temperature) / z)
        total += max(row) * nll
        weights += max(row)
    return total / weights


def test_overlap_cross_entropy_against_loops(pair):
    s, overlap = pair
    value = losses.overlap_cross_entropy(s, overlap, 0.1, 0.1)
    rows = naive_cross_entropy(s.detach().double(), overlap, 0.1, 0.1)
    columns = naive_cross_entropy(s.detach().double().T, overlap.T, 0.1, 0.1)
    assert value.item() == pytest.approx(0.5 * (rows + columns), rel=1e-5)


def test_masked_cross_entropy_is_that_of_the_weighted_softmax(pair):
    s, overlap = pair
    plain = losses.overlap_cross_entropy(s, overlap, 0.1, 0.1)
    same = losses.overlap_cross_entropy(s, overlap, 0.1, 0.1, torch.full_like(s, 0.3))
    assert same.item() == pytest.approx(plain.item(), rel=1e-5)
    weight = torch.rand(s.shape, generator=torch.Generator().manual_seed(2)) + 0.1
    value = losses.overlap_cross_entropy(s, overlap, 0.1, 0.1, weight)
    moved = (s + 0.1 * weight.log()).detach().double()
    rows, columns = (
        naive_cross_entropy(m, o, 0.1, 0.1) for m, o in ((moved, overlap), (moved.T, overlap.T))
    )
    assert value.item() == pytest.approx(0.5 * (rows + columns), rel=1e-5)
    helped = torch.where(overlap > 0.1, 1.0, 0.01)
    assert losses.overlap_cross_entropy(s, overlap, 0.1, 0.1, helped) < plain


def naive_circle(s, overlap, scale):
    rows = []
    for i in range(s.shape[0]):
        positives = negatives = 0.0
        for j in range(s.shape[1]):
            d = math.sqrt(max(2 - 2 * float(s[i, j]), 1e-8))
            o = float(overlap[i, j])
            if o > 0.1:
                positives += math.exp(scale * math.sqrt(o) * max(d - 0.1, 0) * (d - 0.1))
            elif o == 0:
                negatives += math.exp(scale * max(1.4 - d, 0) * (1.4 - d))
        if positives > 0 and negatives > 0:
            rows.append(math.log(1 + positives * negatives) / scale)
    return sum(rows) / len(rows)


def test_circle_loss_against_loops(pair):
    s, overlap = pair
    value = losses.overlap_circle_loss(s, overlap, scale=10.0)
    expected = 0.5 * (naive_circle(s, overlap, 10.0) + naive_circle(s.T, overlap.T, 10.0))
    assert value.item() == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize('loss', [losses.overlap_cross_entropy, losses.overlap_circle_loss])
def test_coarse_losses_fall_when_followed_and_are_finite_without_overlap(pair, loss):
    s, overlap = pair
    value = loss(s, overlap)
    (gradient,) = torch.autograd.grad(value, s)
    assert torch.isfinite(gradient).all()
    better = (s - 0.05 * gradient / gradient.norm()).detach()
    assert loss(better, overlap) < value
    nothing = loss(s, torch.zeros_like(overlap))
    (gradient,) = torch.autograd.grad(nothing, s)
    assert nothing.item() == 0.0
    assert (gradient == 0).all()


def test_point_matching_loss_against_loops():
    generator = torch.Generator().manual_seed(1)
    log_plan = torch.randn(3, 4, 4, generator=generator, requires_grad=True)
    labels = torch.rand(3, 4, 4, generator=generator) < 0.3
    valid = torch.tensor([True, False, True])
    terms = [
        -log_plan[p, i, j].item()
        for p in (0, 2)
        for i in range(4)
        for j in range(4)
        if labels[p, i, j]
    ]
    value = losses.point_matching_loss(log_plan, labels, valid)
    assert value.item() == pytest.approx(sum(terms) / len(terms), rel=1e-5)
    none = losses.point_matching_loss(log_plan, torch.zeros_like(labels), valid)
    none.backward()
    assert none.item() == 0.0
    assert log_plan.grad is not None
    assert torch.isfinite(log_plan.grad).all()


def test_point_matching_loss_ignores_unlabelled_minus_infinity():
    log_plan = torch.full((1, 2, 2), float('-inf'))
    log_plan[0, 0, 0] = -1.0
    labels = torch.zeros(1, 2, 2, dtype=torch.bool)
    labels[0, 0, 0] = True
    assert losses.point_matching_loss(log_plan, labels, torch.tensor([True])).item() == 1.0


def test_descriptor_loss_against_loops_and_empty():
    generator = torch.Generator().manual_seed(2)
    a = torch.nn.functional.normalize(torch.randn(5, 4, generator=generator), dim=1)
    b = torch.nn.functional.normalize(torch.randn(8, 4, generator=generator), dim=1)
    match = torch.tensor([3, 0, 7, 7, 1])
    near = torch.zeros(5, 8, dtype=torch.bool)
    near[0, 3] = near[0, 4] = near[2, 6] = True
    total = 0.0
    for i in range(5):
        m = int(match[i])
        rivals = [j for j in range(8) if j == m or not near[i, j]]
        z = sum(math.exp(float(a[i] @ b[j]) / 0.2) for j in rivals)
        total -= math.log(math.exp(float(a[i] @ b[m]) / 0.2) / z) / 5
    assert losses.descriptor_loss(a, b, match, near, 0.2).item() == pytest.approx(total, rel=1e-5)
    assert losses.descriptor_loss(a[:0], b, match[:0], near[:0], 0.2).item() == 0.0


def test_mask_losses_balance_the_classes():
    trusted = torch.tensor([1.0, 0.0, 0.0, 0.0])
    wrong_on_one = torch.tensor([1.0, 1.0, 1.0, 1.0])
    wrong_on_three = torch.tensor([0.0, 0.0, 0.0, 0.0])
    one, three = (losses.mask_l1(s, trusted).item() for s in (wrong_on_one, wrong_on_three))
    assert one == pytest.approx(three)
    assert losses.mask_l1(1.0 - trusted, trusted).item() == 0.0
    logit = torch.tensor([-8.0, 8.0, 8.0, 8.0], requires_grad=True)
    good = losses.mask_bce(logit, trusted)
    assert good.item() < 1e-3
    assert losses.mask_bce(-logit, trusted).item() > 5.0
    good.backward()
    assert logit.grad is not None
    assert torch.isfinite(logit.grad).all()


def test_pair_log_variance_follows_the_worse_side_and_is_clamped():
    s, t = torch.tensor([0.0, 0.9, 1.0]), torch.tensor([0.0, 0.9])
    a = losses.pair_log_variance(s, t)
    assert a[0, 0].item() == -4.0
    assert a[2, 0].item() == a[2, 1].item() == 2.0
    assert a[1, 0].item() == pytest.approx(min(math.log(0.9 / 0.1), 2.0))
    mild = losses.pair_log_variance(torch.tensor([0.3]), torch.tensor([0.5]), high=9.0)
    assert mild.item() == pytest.approx(math.log(0.65 / 0.35), rel=1e-5)


def test_laplace_nll_against_scipy():
    from scipy.stats import laplace

    generator = torch.Generator().manual_seed(3)
    mu, a = torch.rand(3, 4, generator=generator), torch.randn(3, 4, generator=generator)
    c = torch.rand(3, 4, generator=generator) < 0.4
    parts: dict[bool, list[Any]] = {True: [], False: []}
    density = []
    for i in range(3):
        for j in range(4):
            sigma = math.exp(0.5 * a[i, j].item())
            log_p = laplace.logpdf(float(c[i, j]), mu[i, j].item(), sigma / math.sqrt(2))
            parts[bool(c[i, j])].append(-log_p)
            density.append(math.exp(log_p))
    expected = sum(sum(v) / len(v) for v in parts.values()) / 2
    assert losses.laplace_nll(mu, c, a).item() == pytest.approx(expected, rel=1e-4)
    best = losses.laplace_log_sum_exp(mu, c, a)
    assert best.item() == pytest.approx(-math.log(sum(density) / len(density)), rel=1e-4)


@pytest.mark.parametrize('loss', [losses.laplace_nll, losses.laplace_log_sum_exp])
@pytest.mark.parametrize('stop', [True, False])
def test_stop_gradient_is_selectable(loss, stop):
    mu = torch.full((2, 2), 0.4, requires_grad=True)
    s = torch.tensor([0.2, 0.7], requires_grad=True)
    c = torch.tensor([[True, False], [False, False]])
    loss(mu, c, losses.pair_log_variance(s, s), stop_gradient=stop).backward()
    assert (mu.grad is None) == stop
    assert s.grad is not None
    assert torch.isfinite(s.grad).all()
    assert s.grad.abs().max() > 0


def test_laplace_nll_wants_large_variance_where_it_is_wrong():
    c = torch.tensor([[True, False]])
    bad, good = torch.tensor([[0.0, 1.0]]), torch.tensor([[1.0, 0.0]])
    low, high = torch.full((1, 2), -4.0), torch.full((1, 2), 1.0)
    assert losses.laplace_nll(bad, c, high) < losses.laplace_nll(bad, c, low)
    assert losses.laplace_nll(good, c, low) < losses.laplace_nll(good, c, high)


def test_false_match_loss_against_loops():
    generator = torch.Generator().manual_seed(5)
    x, y = (F.normalize(torch.randn(n, 4, generator=generator).double(), dim=1) for n in (5, 7))
    right = torch.rand(5, 7, generator=generator) < 0.3
    e = torch.exp(x @ y.T / 0.2)
    rows, columns = torch.zeros(5).double(), torch.zeros(7).double()
    for i in range(5):
        for j in range(7):
            if not right[i, j]:
                p = e[i, j] / e[i].sum() * (e[i, j] / e[:, j].sum())
                rows[i] += p
                columns[j] += p
    wanted = -0.5 * (torch.log(1 - rows).mean() + torch.log(1 - columns).mean())
    value = losses.false_match_loss(x, y, right, 0.2)
    assert value.item() == pytest.approx(wanted.item(), rel=1e-6)


def test_false_match_loss_parts_points_that_have_no_partner():
    """InfoNCE never meets two points without partners; here they stop being sure of each other."""
    generator = torch.Generator().manual_seed(6)
    features = torch.randn(2, 9, 4, generator=generator)
    features[1, 0] = features[0, 0]
    features.requires_grad_()
    right = torch.zeros(9, 9, dtype=torch.bool)

    def sure():
        x, y = F.normalize(features, dim=2)
        logits = x @ y.T / 0.05
        return float((logits.softmax(1) * logits.softmax(0))[0, 0].detach())

    before = sure()
    optimizer = torch.optim.Adam([features], lr=0.05)
    for _ in range(40):
        optimizer.zero_grad()
        source, target = F.normalize(features, dim=2)
        losses.false_match_loss(source, target, right, 0.05).backward()
        optimizer.step()
    assert before > 0.8
    assert sure() < 0.3
