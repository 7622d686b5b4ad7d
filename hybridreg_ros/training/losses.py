# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Loss terms as pure functions: superpoint matching, point matching, uncertainty mask."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

LOG_2 = 0.6931471805599453


def overlap_cross_entropy(
    similarity: Tensor,
    overlap: Tensor,
    temperature: float = 0.07,
    positive: float = 0.1,
    weight: Tensor | None = None,
) -> Tensor:
    """Cross-entropy over the rows and the columns of the superpoint similarity.

    A row that has positives should spread its softmax over them in proportion to their overlap;
    rows count by the overlap of their best partner. Rows without positives are left to the mask.

    Args:
        similarity: (N, M) cosine similarities.
        overlap: (N, M) true overlap of the patches, [0, 1].
        temperature: of the softmax.
        positive: overlaps below this are no positives.
        weight: (N, M) factors of the softmax's terms, > 0: those of the mask, so that the loss is
            that of the masked correlation. None: all 1.

    Returns:
        Scalar; zero (with a gradient of zero) when nothing overlaps.
    """
    target = torch.where(overlap > positive, overlap, torch.zeros_like(overlap))
    logits = similarity / temperature
    if weight is not None:
        logits = logits + weight.log()
    rows = _soft_cross_entropy(logits, target)
    columns = _soft_cross_entropy(logits.T, target.T)
    return 0.5 * (rows + columns)


def _soft_cross_entropy(logits: Tensor, target: Tensor) -> Tensor:
    """Mean of the rows' cross-entropy to their normalised target, weighted by the row maximum."""
    weight = target.amax(dim=1)
    share = target / target.sum(dim=1, keepdim=True).clamp_min(1e-6)
    row_loss = -(share * F.log_softmax(logits, dim=1)).sum(dim=1)
    return (weight * row_loss).sum() / weight.sum().clamp_min(1e-6)


def overlap_circle_loss(
    similarity: Tensor,
    overlap: Tensor,
    *,
    positive: float = 0.1,
    positive_margin: float = 0.1,
    negative_margin: float = 1.4,
    scale: float = 24.0,
) -> Tensor:
    """Overlap-aware circle loss of GeoTransformer, both directions.

    Args:
        similarity: (N, M) cosine similarities; distances are sqrt(2 - 2 s).
        overlap: (N, M) true overlap, [0, 1]; negatives are pairs with overlap 0.
        positive: overlap above which a pair is a positive.
        positive_margin: distance at which a positive costs nothing.
        negative_margin: distance at which a negative costs nothing.
        scale: sharpness of the soft maximum.

    Returns:
        Scalar; zero when no row and no column has both kinds.
    """
    distance = torch.sqrt((2.0 - 2.0 * similarity).clamp_min(1e-8))
    is_positive, is_negative = overlap > positive, overlap == 0
    weight_p = (distance - positive_margin).clamp_min(0.0).detach() * torch.sqrt(overlap)
    weight_n = (negative_margin - distance).clamp_min(0.0).detach()
    logit_p = (scale * weight_p * (distance - positive_margin)).masked_fill(
        ~is_positive, float('-inf')
    )
    logit_n = (scale * weight_n * (negative_margin - distance)).masked_fill(
        ~is_negative, float('-inf')
    )
    both = [is_positive.any(d) & is_negative.any(d) for d in (1, 0)]
    terms = []
    for dim, usable in zip((1, 0), both, strict=True):
        if bool(usable.any()):
            p, n = (x if dim == 1 else x.T for x in (logit_p, logit_n))
            hard = torch.logsumexp(p[usable], dim=1) + torch.logsumexp(n[usable], dim=1)
            terms.append(F.softplus(hard).mean() / scale)
    return torch.stack(terms).mean() if terms else similarity.sum() * 0.0


def point_matching_loss(log_assignment: Tensor, labels: Tensor, valid: Tensor) -> Tensor:
    """Mean negative log-likelihood of the labelled entries of the transport plans.

    Args:
        log_assignment: (P, K+1, K+1) log plans; last row and column are the slack.
        labels: (P, K+1, K+1) bool, from `labels.fine_labels`.
        valid: (P,) bool, pairs that count.

    Returns:
        Scalar; zero when nothing is labelled.
    """
    wanted = labels & valid[:, None, None]
    count = wanted.sum().clamp_min(1)
    return -torch.where(wanted, log_assignment, torch.zeros_like(log_assignment)).sum() / count


def descriptor_loss(
    anchors: Tensor, others: Tensor, match: Tensor, near: Tensor, temperature: float = 0.07
) -> Tensor:
    """InfoNCE of matched fine points against every fine point of the other cloud.

    Args:
        anchors: (A, C) unit features of matched points of one cloud.
        others: (F, C) unit features of all fine points of the other cloud.
        match: (A,) int64 row of `others` that truly matches each anchor.
        near: (A, F) bool, points too close to the match to be called negatives; the match itself
            may be among them.
        temperature: of the softmax.

    Returns:
        Scalar; zero for no anchors.
    """
    if len(anchors) == 0:
        return anchors.sum() * 0.0
    logits = anchors @ others.T / temperature
    itself = F.one_hot(match, len(others)).bool()
    return F.cross_entropy(logits.masked_fill(near & ~itself, float('-inf')), match)


def false_match_loss(source: Tensor, target: Tensor, right: Tensor, temperature: float) -> Tensor:
    """How sure fine points are of wrong partners: those that have none should be sure of none.

    The likelihood of a pair is that by which matches are ranked (`model.descriptors`): its share
    of the row's softmax times that of the column's. InfoNCE teaches points that have a partner to
    find it; nothing there keeps two points that both have none from finding each other, and
    where clouds overlap little most points are such.

    Args:
        source: (F, C) unit features of all fine points of the source.
        target: (G, C) unit features of those of the target.
        right: (F, G) bool, pairs that are the same place of the static background, or nearly so.
        temperature: of both softmaxes.

    Returns:
        Scalar: mean over the points of both clouds of -log(1 - likelihood of all wrong partners).
    """
    logits = source @ target.T / temperature
    likelihood = logits.softmax(dim=1) * logits.softmax(dim=0)
    wrong = likelihood.masked_fill(right, 0.0)
    sides = [-torch.log1p(-wrong.sum(dim).clamp_max(1.0 - 1e-4)).mean() for dim in (0, 1)]
    return 0.5 * (sides[0] + sides[1])


def mask_bce(logit: Tensor, trusted: Tensor) -> Tensor:
    """Balanced binary cross-entropy of the mask: both classes weigh the same.

    Args:
        logit: (N,) logit of sigma2 (1 = do not trust).
        trusted: (N,) share of the superpoint that is static and seen by the other cloud, [0, 1].
    """
    wanted = 1.0 - trusted
    weight = _balance(wanted)
    return F.binary_cross_entropy_with_logits(logit, wanted, weight=weight)


def mask_l1(sigma2: Tensor, trusted: Tensor) -> Tensor:
    """Balanced mean absolute error of sigma2 (N,) against 1 - trusted (N,)."""
    wanted = 1.0 - trusted
    return (_balance(wanted) * (sigma2 - wanted).abs()).mean()


def _balance(wanted: Tensor) -> Tensor:
    """Weights (N,) of mean 1 that give the soft classes 0 and 1 the same total."""
    share = wanted.mean().clamp(0.05, 0.95)
    return 0.5 * wanted / share + 0.5 * (1.0 - wanted) / (1.0 - share)


def pair_log_variance(
    source_sigma2: Tensor, target_sigma2: Tensor, low: float = -4.0, high: float = 2.0
) -> Tensor:
    """Log variance (N, M) of every superpoint pair.

    The pair is as uncertain as its worse side: sigma2_ij = 1 - (1 - sigma2_i)(1 - sigma2_j). The
    log of its odds is clamped, so that a variance may exceed 1 where nothing can be predicted.
    """
    pair = 1.0 - (1.0 - source_sigma2)[:, None] * (1.0 - target_sigma2)[None, :]
    pair = pair.clamp(1e-4, 1.0 - 1e-4)
    return torch.log(pair / (1.0 - pair)).clamp(low, high)


def laplace_nll(
    correlation: Tensor, overlaps: Tensor, log_variance: Tensor, *, stop_gradient: bool = True
) -> Tensor:
    """Laplace negative log-likelihood per pair, soft correlation as mean, classes balanced.

    A Laplace density of variance exp(a) has
    -log p = 0.5 log 2 + 0.5 a + sqrt(2) exp(-a/2) |c - mu|.

    Args:
        correlation: (N, M) soft correlation mu, [0, 1].
        overlaps: (N, M) bool, c: the superpoints are static and overlap.
        log_variance: (N, M) a, clamped.
        stop_gradient: keep this loss from shaping the features (only the mask learns).

    Returns:
        Scalar: mean of the means over positive and over negative pairs.
    """
    nll = 0.5 * LOG_2 - _laplace_exponent(correlation, overlaps, log_variance, stop_gradient)
    parts = [nll[m].mean() for m in (overlaps, ~overlaps) if bool(m.any())]
    return torch.stack(parts).mean()


def laplace_log_sum_exp(
    correlation: Tensor, overlaps: Tensor, log_variance: Tensor, *, stop_gradient: bool = True
) -> Tensor:
    """The paper's form: -log mean over pairs of the Laplace density (arguments as `laplace_nll`).

    The mean instead of the paper's sum only shifts the value, so that it does not depend on N M.
    """
    exponent = _laplace_exponent(correlation, overlaps, log_variance, stop_gradient) - 0.5 * LOG_2
    total = torch.logsumexp(exponent.flatten(), dim=0)
    best: Tensor = math.log(exponent.numel()) - total
    return best


def _laplace_exponent(mu: Tensor, overlaps: Tensor, a: Tensor, stop_gradient: bool) -> Tensor:
    mean = mu.detach() if stop_gradient else mu
    error = (overlaps.to(mean.dtype) - mean).abs()
    exponent: Tensor = -0.5 * a - math.sqrt(2.0) * torch.exp(-0.5 * a) * error
    return exponent
