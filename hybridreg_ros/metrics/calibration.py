# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Is a confidence honest: ECE, reliability diagram, risk-coverage curve, logistic calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]
    Bools = NDArray[np.bool_]


class Reliability(NamedTuple):
    """Reliability diagram over B equal-width bins of confidence.

    Attributes:
        confidence: (B,) mean confidence of each bin, NaN where empty.
        accuracy: (B,) share of right results of each bin, NaN where empty.
        results: (B,) results per bin.
    """

    confidence: F64
    accuracy: F64
    results: NDArray[np.int64]


class RiskCoverage(NamedTuple):
    """Share of wrong results among the accepted ones, as the gate opens.

    Attributes:
        gate: (P,) confidence of the least confident accepted result, falling.
        coverage: (P,) share of results accepted.
        risk: (P,) share of the accepted ones that are wrong.
    """

    gate: F64
    coverage: F64
    risk: F64


class LogisticFit(NamedTuple):
    """P(right) = 1 / (1 + exp(-(bias + weights . features))).

    Attributes:
        weights: (F,) for the features as given (not standardised).
        bias: scalar.
        iterations: Newton steps taken.
    """

    weights: F64
    bias: float
    iterations: int


def reliability(confidence: NDArray[np.floating], right: Bools, bins: int = 10) -> Reliability:
    """Reliability diagram of confidences (P,) in [0, 1] against outcomes (P,).

    Raises:
        ValueError: lengths differ or a confidence lies outside [0, 1].

    Examples:
        >>> reliability(np.array([0.1, 0.9]), np.array([False, True]), bins=2).accuracy.tolist()
        [0.0, 1.0]
    """
    c, r = _checked(confidence, right)
    index = np.minimum((c * bins).astype(np.int64), bins - 1)
    count = np.bincount(index, minlength=bins)
    with np.errstate(invalid='ignore', divide='ignore'):
        mean_c = np.bincount(index, weights=c, minlength=bins) / count
        mean_r = np.bincount(index, weights=r, minlength=bins) / count
    return Reliability(mean_c, mean_r, count)


def expected_calibration_error(
    confidence: NDArray[np.floating], right: Bools, bins: int = 10
) -> float:
    """ECE: mean gap between confidence and accuracy, weighted by bin counts; NaN for no results.

    Args:
        confidence: (P,) in [0, 1].
        right: (P,) outcomes.
        bins: equal-width bins.

    Raises:
        ValueError: lengths differ or a confidence lies outside [0, 1].

    Examples:
        >>> round(expected_calibration_error(np.array([0.8, 0.8]), np.array([True, False])), 6)
        0.3
    """
    diagram = reliability(confidence, right, bins)
    total = int(diagram.results.sum())
    if total == 0:
        return float('nan')
    gap = np.abs(diagram.confidence - diagram.accuracy)
    return float(np.nansum(gap * diagram.results) / total)


def risk_coverage(confidence: NDArray[np.floating], right: Bools) -> RiskCoverage:
    """Risk-coverage curve of confidences (P,) against outcomes (P,), most confident first.

    Raises:
        ValueError: lengths differ or a confidence lies outside [0, 1].

    Examples:
        >>> risk_coverage(np.array([0.2, 0.9]), np.array([False, True])).risk.tolist()
        [0.0, 0.5]
    """
    c, r = _checked(confidence, right)
    order = np.argsort(-c, kind='stable')
    accepted = np.arange(1, len(c) + 1, dtype=np.float64)
    risk = np.cumsum(1.0 - r[order]) / accepted
    return RiskCoverage(c[order], accepted / max(len(c), 1), risk)


def sigmoid(x: NDArray[np.floating]) -> F64:
    """Logistic function without overflow.

    Examples:
        >>> sigmoid(np.array([-1000.0, 0.0, 1000.0])).tolist()
        [0.0, 0.5, 1.0]
    """
    result: F64 = 0.5 * (1.0 + np.tanh(0.5 * np.asarray(x, dtype=np.float64)))
    return result


def fit_logistic(
    features: NDArray[np.floating], right: Bools, *, ridge: float = 1e-2, max_iterations: int = 50
) -> LogisticFit:
    """Logistic regression by Newton's method, features standardised inside, ridge on the weights.

    Args:
        features: (P, F) finite.
        right: (P,) outcomes; both kinds must occur.
        ridge: L2 penalty on the standardised weights (the bias is free).
        max_iterations: Newton steps at most.

    Returns:
        Coefficients for the features as given.

    Raises:
        ValueError: fewer than two results, one outcome only, or features that are not finite.

    Examples:
        >>> x = np.array([[0.0], [1.0], [2.0], [3.0]])
        >>> fit = fit_logistic(x, np.array([False, True, False, True]))
        >>> bool(fit.weights[0] > 0)
        True
    """
    x = np.asarray(features, dtype=np.float64)
    y = np.asarray(right, dtype=np.float64)
    if x.ndim != 2 or len(x) != len(y) or len(y) < 2:
        raise ValueError(f'expected (P, F) features with P = {len(y)} >= 2, found {x.shape}')
    if not np.isfinite(x).all():
        raise ValueError('features must be finite')
    if y.min() == y.max():
        raise ValueError(f'expected right and wrong results, found only {bool(y[0])}')
    mean, scale = x.mean(axis=0), x.std(axis=0)
    scale[scale < 1e-12] = 1.0
    z = np.column_stack([(x - mean) / scale, np.ones(len(x))])
    beta, steps = _newton(z, y, ridge, max_iterations)
    weights = beta[:-1] / scale
    return LogisticFit(weights, float(beta[-1] - weights @ mean), steps)


def _newton(z: F64, y: F64, ridge: float, max_iterations: int) -> tuple[F64, int]:
    """Damped Newton steps on the penalised log-likelihood; last column of z (P, F+1) is ones."""
    penalty = np.full(z.shape[1], ridge)
    penalty[-1] = 0.0
    beta = np.zeros(z.shape[1])
    loss = _penalised_loss(z, y, beta, penalty)
    for step in range(1, max_iterations + 1):
        p = sigmoid(z @ beta)
        gradient = z.T @ (p - y) + penalty * beta
        hessian = (z * (p * (1.0 - p))[:, None]).T @ z + np.diag(penalty + 1e-9)
        delta = np.linalg.solve(hessian, gradient)
        rate = 1.0
        while rate > 1e-6 and _penalised_loss(z, y, beta - rate * delta, penalty) > loss:
            rate *= 0.5
        beta = beta - rate * delta
        loss = _penalised_loss(z, y, beta, penalty)
        if float(np.abs(rate * delta).max()) < 1e-9:
            return beta, step
    return beta, max_iterations


def _penalised_loss(z: F64, y: F64, beta: F64, penalty: F64) -> float:
    logits = z @ beta
    return float(np.sum(np.logaddexp(0.0, logits) - y * logits) + 0.5 * np.sum(penalty * beta**2))


def _checked(confidence: NDArray[np.floating], right: Bools) -> tuple[F64, F64]:
    """Both as float64.

    Raises:
        ValueError: lengths differ or a confidence lies outside [0, 1].
    """
    c = np.asarray(confidence, dtype=np.float64)
    r = np.asarray(right, dtype=np.float64)
    if c.shape != r.shape or c.ndim != 1:
        raise ValueError(f'expected two arrays (P,), found {c.shape} and {r.shape}')
    if len(c) and not (c.min() >= 0.0 and c.max() <= 1.0):
        raise ValueError(f'confidence must lie in [0, 1], found {c.min():g} to {c.max():g}')
    return c, r
