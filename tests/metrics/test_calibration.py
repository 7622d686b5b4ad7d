# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import doctest

import numpy as np
import pytest
from scipy.optimize import minimize

from hybridreg_ros.metrics import calibration as cal


def test_doctests():
    result = doctest.testmod(cal)
    assert result.attempted > 5
    assert result.failed == 0


def test_ece_of_an_honest_and_a_boasting_confidence():
    rng = np.random.default_rng(0)
    confidence = rng.random(20_000)
    right = rng.random(20_000) < confidence
    assert cal.expected_calibration_error(confidence, right) < 0.02
    boast = np.full(20_000, 1.0)
    expected = 1.0 - right.mean()
    assert cal.expected_calibration_error(boast, right) == pytest.approx(expected)
    assert np.isnan(cal.expected_calibration_error(np.zeros(0), np.zeros(0, bool)))


def test_ece_against_a_loop():
    rng = np.random.default_rng(1)
    c, r = rng.random(57), rng.random(57) < 0.5
    expected = 0.0
    for b in range(10):
        inside = [i for i in range(57) if b / 10 <= c[i] < (b + 1) / 10]
        if inside:
            gap = abs(float(np.mean(c[inside])) - float(np.mean(r[inside])))
            expected += len(inside) / 57 * gap
    assert cal.expected_calibration_error(c, r) == pytest.approx(expected)


def test_risk_coverage_against_a_loop():
    rng = np.random.default_rng(2)
    c, r = rng.random(20), rng.random(20) < 0.7
    curve = cal.risk_coverage(c, r)
    for gate, coverage, risk in zip(*curve, strict=True):
        accepted = c >= gate
        assert coverage == pytest.approx(accepted.mean())
        assert risk == pytest.approx((~r[accepted]).mean())


def test_logistic_against_scipy():
    rng = np.random.default_rng(3)
    x = rng.normal(size=(300, 3)) * [1.0, 50.0, 0.01] + [5.0, -3.0, 0.0]
    logits = 1.5 * (x[:, 0] - 5) - 0.02 * (x[:, 1] + 3)
    y = rng.random(300) < cal.sigmoid(logits)
    fit = cal.fit_logistic(x, y, ridge=1e-3)
    mean, std = x.mean(0), x.std(0)

    def loss(beta):
        s = (x - mean) / std @ beta[:3] + beta[3]
        return np.sum(np.logaddexp(0, s) - y * s) + 0.5e-3 * np.sum(beta[:3] ** 2)

    best = minimize(loss, np.zeros(4), method='BFGS').x
    np.testing.assert_allclose(fit.weights * std, best[:3], atol=1e-3)
    np.testing.assert_allclose(fit.bias + fit.weights @ mean, best[3], atol=1e-3)
    p = cal.sigmoid(x @ fit.weights + fit.bias)
    assert p.mean() == pytest.approx(y.mean(), abs=1e-6)


def test_logistic_survives_separable_and_constant_features():
    x = np.column_stack([np.linspace(-1, 1, 20), np.ones(20)])
    fit = cal.fit_logistic(x, x[:, 0] > 0)
    assert np.isfinite(fit.weights).all()
    assert fit.weights[0] > 1.0
    assert fit.weights[1] == 0.0


def test_bad_input():
    right = np.array([True, False])
    with pytest.raises(ValueError, match='expected two arrays'):
        cal.reliability(np.array([0.5]), right)
    with pytest.raises(ValueError, match=r'must lie in \[0, 1\]'):
        cal.reliability(np.array([0.5, 1.5]), right)
    with pytest.raises(ValueError, match='only True'):
        cal.fit_logistic(np.ones((2, 1)), np.array([True, True]))
    with pytest.raises(ValueError, match='finite'):
        cal.fit_logistic(np.array([[np.nan], [1.0]]), right)
    with pytest.raises(ValueError, match=r'\(P, F\) features'):
        cal.fit_logistic(np.ones((3, 1)), right)
