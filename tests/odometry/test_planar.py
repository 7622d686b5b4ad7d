# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The best planar pose of a fit, against a general optimiser."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.registration.alignment import Fit
from hybridreg_ros.odometry.registration.planar import VARIANCE, in_plane


def test_is_the_best_of_the_planar_poses(rng):
    up = np.array([0.3, -0.2, 0.9]) / np.linalg.norm([0.3, -0.2, 0.9])
    flat = np.array([1.0, 0.5, 0.0])
    flat -= (flat @ up) * up
    J = rng.normal(size=(40, 6)) * [30.0, 20.0, 40.0, 90.0, 80.0, 50.0]
    information = J.T @ J
    T = se3.transform(se3.so3_exp(0.4 * up + rng.normal(0.0, 1e-3, 3)), flat + 2e-3 * up)
    fit = in_plane(Fit(T, information, 0.9, np.eye(6)), up)

    along = np.linalg.svd(up[None])[2][1:]

    def pose_of(x: np.ndarray) -> np.ndarray:
        return se3.transform(se3.so3_exp((0.4 + x[2]) * up), flat + x[:2] @ along)

    def cost(x: np.ndarray) -> float:
        pose = pose_of(x)
        step = np.concatenate([pose[:3, 3] - T[:3, 3], se3.so3_log(pose[:3, :3] @ T[:3, :3].T)])
        return float(step @ information @ step)

    best = pose_of(minimize(cost, np.zeros(3), method='Nelder-Mead', tol=1e-12).x)
    np.testing.assert_allclose(fit.T_odom_sensor, best, atol=2e-5)
    spread = np.linalg.inv(fit.information)
    A = np.concatenate([np.pad(up[None], ((0, 0), (0, 3))), np.pad(along, ((0, 0), (3, 0)))])
    np.testing.assert_allclose(A @ spread @ A.T, VARIANCE * np.eye(3), rtol=1e-3, atol=1e-9)
    free = np.concatenate([np.pad(along, ((0, 0), (0, 3))), np.pad(up[None], ((0, 0), (3, 0)))])
    np.testing.assert_allclose(
        np.linalg.inv(free @ spread @ free.T), free @ information @ free.T, rtol=1e-6
    )


@pytest.mark.parametrize('rank', [0, 2])
def test_what_the_points_do_not_hold_does_no_harm(rank):
    information = np.zeros((6, 6))
    information[:rank, :rank] = 1e6 * np.eye(rank)
    T = se3.exp(np.array([0.1, 0.2, 0.01, 0.01, -0.01, 0.3]))
    pose = in_plane(Fit(T, information, 0.1, np.eye(6)), np.array([0.0, 0.0, 1.0])).T_odom_sensor
    np.testing.assert_allclose(pose[2, 3], 0.0, atol=1e-9)
    np.testing.assert_allclose(pose[2, :3], [0.0, 0.0, 1.0], atol=1e-3)
    assert np.isfinite(pose).all()
