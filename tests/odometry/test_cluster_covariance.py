# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Cluster-robust covariance: the covariance of a pose by how much the parts of a scan disagree."""

from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.odometry.registration import kernels
from hybridreg_ros.odometry.registration.cluster_covariance import cluster_covariance
from hybridreg_ros.odometry.registration.surfaces import unpaired
from hybridreg_ros.odometry.selection.reported_confidence import disagreement

SIZE_M = 0.1
SPREAD_M = 0.01


def _world(errors: np.ndarray, seed: int = 0) -> tuple:
    """Points on the six sides of many cubes; `errors` (P, 3) is how far each cube is displaced."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(*[np.arange(-3, 4)] * 3), axis=-1).reshape(-1, 3) * 1.6 + 0.4
    grid = grid[: len(errors)]
    rows: list[np.ndarray] = []
    sides: list[np.ndarray] = []
    offs: list[np.ndarray] = []
    for centre, error in zip(grid, errors, strict=True):
        for axis in range(3):
            at = rng.uniform(-0.3, 0.3, (8, 3))
            rows.append(centre + at)
            sides.append(np.tile(np.eye(3)[axis], (8, 1)))
            offs.append(np.full(8, error[axis]))
    points, normals = np.concatenate(rows), np.concatenate(sides)
    surfaces = unpaired(len(points))
    surfaces.kind[:] = kernels.PLANE
    surfaces.normal[:] = normals
    surfaces.anchor[:] = points - np.concatenate(offs)[:, None] * normals
    scales = np.full(len(points), SPREAD_M)
    ones = np.ones(len(points))
    H, _, _ = kernels.normal_equations(points, ones, np.eye(4), surfaces, scales, 1.0)
    return points, ones, np.eye(4), surfaces, scales, H, SIZE_M


def test_it_is_the_spread_of_poses_over_many_draws_of_the_parts() -> None:
    rng, parts, spread = np.random.default_rng(3), 200, 0.003
    told, poses = [], []
    for _ in range(60):
        world = _world(rng.normal(0.0, spread, (parts, 3)))
        told.append(cluster_covariance(*world))
        points, ones, _, surfaces, scales, H, _ = world
        _, b, _ = kernels.normal_equations(points, ones, np.eye(4), surfaces, scales, 1.0)
        poses.append(np.linalg.solve(H, -b))
    found = np.mean(told, axis=0)
    true = np.cov(np.array(poses).T)
    ratio = np.sqrt(np.diag(found) / np.diag(true))
    assert ratio.min() > 0.75
    assert ratio.max() < 1.33


def test_points_that_err_alike_count_as_one() -> None:
    parts, spread = 343, 0.002
    world = _world(np.random.default_rng(4).normal(0.0, spread, (parts, 3)))
    shift = np.sqrt(np.diag(cluster_covariance(*world))[:3])
    # One error per part and axis, not one for each of its eight points that face along it.
    np.testing.assert_allclose(shift, spread / parts**0.5, rtol=0.25)


def test_parts_that_pull_apart_show_and_those_that_agree_do_not() -> None:
    agree = np.tile([0.004, 0.0, 0.0], (60, 1))  # a common error is no disagreement
    apart = np.where(np.arange(60)[:, None] % 2 == 0, agree, -agree)
    calm, torn = cluster_covariance(*_world(agree)), cluster_covariance(*_world(apart))
    assert np.sqrt(torn[0, 0]) > 4.0 * np.sqrt(calm[0, 0])
    assert np.sqrt(torn[0, 0]) > 4.0 * np.sqrt(torn[1, 1])
    assert disagreement(torn, SIZE_M) > disagreement(calm, SIZE_M)


def test_too_few_parts_say_that_nothing_is_known() -> None:
    points, ones, T, surfaces, scales, H, size_m = _world(np.zeros((2, 3)))
    assert cluster_covariance(points, ones, T, surfaces, scales, H, size_m)[0, 0] == pytest.approx(
        100.0
    )
    none = cluster_covariance(points, 0.0 * ones, T, surfaces, scales, 0.0 * H, size_m)
    assert none[3, 3] == pytest.approx(100.0)


def test_disagreement_is_in_voxels_and_degrees() -> None:
    covariance = np.diag([0.3, 0.1, 0.1, *np.deg2rad([4.0, 1.0, 1.0])]) ** 2
    assert disagreement(covariance, 0.1) == pytest.approx(np.log10(5.003))
    assert disagreement(np.zeros((6, 6)), 0.1) == pytest.approx(np.log10(0.003))
