# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hybridreg_ros.core import se3

twists = st.lists(st.floats(-1.7, 1.7), min_size=6, max_size=6).map(np.array)


@settings(max_examples=100, deadline=None)
@given(twists)
def test_exp_is_the_matrix_exponential(xi):
    A = np.zeros((4, 4))
    A[:3, :3], A[:3, 3] = se3.hat(xi[3:]), xi[:3]
    np.testing.assert_allclose(se3.exp(xi), scipy.linalg.expm(A), atol=1e-9)


@settings(max_examples=100, deadline=None)
@given(twists)
def test_log_undoes_exp(xi):
    T = se3.exp(xi)
    np.testing.assert_allclose(se3.exp(se3.log(T)), T, atol=1e-9)
    np.testing.assert_allclose(se3.inverse(T) @ T, np.eye(4), atol=1e-12)
    assert se3.is_rigid(T)


@pytest.mark.parametrize('angle', [0.0, 1e-9, 1e-5, 1.0, np.pi - 1e-3, np.pi - 1e-5, np.pi])
@pytest.mark.parametrize('axis', [(1, 0, 0), (0, 0.6, 0.8), (-0.36, 0.48, -0.8)])
def test_log_of_small_and_half_turns(angle, axis):
    R = Rotation.from_rotvec(angle * np.array(axis)).as_matrix()
    np.testing.assert_allclose(se3.so3_exp(se3.so3_log(R)), R, atol=1e-7)
    assert se3.rotation_angle_deg(R) == pytest.approx(np.rad2deg(angle), abs=1e-4)


def test_interpolation_ends_and_middle(rng):
    T_a, T_b = se3.exp(rng.normal(size=6)), se3.exp(rng.normal(size=6) * 0.3)
    np.testing.assert_allclose(se3.interpolate(T_a, T_b, 0.0), T_a, atol=1e-12)
    np.testing.assert_allclose(se3.interpolate(T_a, T_b, 1.0), T_b, atol=1e-9)
    half = se3.interpolate(T_a, T_b, 0.5)
    np.testing.assert_allclose(half @ se3.inverse(T_a) @ half, T_b, atol=1e-9)


def test_kabsch_against_scipy(rng):
    source = rng.normal(size=(30, 3))
    T = se3.exp(rng.normal(size=6))
    weights = rng.uniform(0.1, 1, 30)
    target = se3.apply(T, source) + rng.normal(scale=0.1, size=(30, 3))
    found = se3.kabsch(source, target, weights)
    w = weights / weights.sum()
    s, t = source - w @ source, target - w @ target
    expected, _ = Rotation.align_vectors(t, s, weights=weights)
    np.testing.assert_allclose(found[:3, :3], expected.as_matrix(), atol=1e-7)


def test_kabsch_never_reflects(rng):
    source = rng.normal(size=(10, 3))
    mirrored = source * [1, 1, -1]
    assert np.linalg.det(se3.kabsch(source, mirrored)[:3, :3]) == pytest.approx(1.0)
    flat = source * [1, 1, 0]
    T = se3.exp(rng.normal(size=6))
    np.testing.assert_allclose(se3.kabsch(flat, se3.apply(T, flat)), T, atol=1e-9)


def test_kabsch_without_weight_is_identity():
    np.testing.assert_array_equal(se3.kabsch(np.zeros((0, 3)), np.zeros((0, 3))), np.eye(4))
    points = np.ones((3, 3))
    np.testing.assert_array_equal(se3.kabsch(points, points, np.zeros(3)), np.eye(4))


def test_orthonormalise_and_is_rigid(rng):
    T = se3.exp(rng.normal(size=6))
    noisy = T.copy()
    noisy[:3, :3] += rng.normal(scale=1e-3, size=(3, 3))
    assert not se3.is_rigid(noisy)
    assert se3.is_rigid(se3.orthonormalise(noisy))
    np.testing.assert_allclose(se3.orthonormalise(noisy), T, atol=5e-3)
    assert not se3.is_rigid(np.full((4, 4), np.nan))
    assert not se3.is_rigid(np.diag([1.0, 1.0, -1.0, 1.0]))


def test_apply_keeps_dtype(rng):
    points = rng.normal(size=(4, 3)).astype(np.float32)
    assert se3.apply(se3.exp(rng.normal(size=6)), points).dtype == np.float32
