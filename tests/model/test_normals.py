# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Normals from neighbour lists: of planes at any tilt, and none where too few points are."""

from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.core import se3
from hybridreg_ros.model.geometry.neighbours import CellList
from hybridreg_ros.model.geometry.normals import surface_normals


@pytest.mark.parametrize('turn', [(0.0, 0.0, 0.0), (0.4, -0.9, 0.2), (1.5, 0.1, 0.0)])
def test_of_a_tilted_plane(turn: tuple[float, float, float]) -> None:
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    flat = np.stack([x.ravel(), y.ravel(), np.zeros(400)], axis=1)
    R = se3.so3_exp(np.array(turn))
    points = (flat @ R.T).astype(np.float32)
    near = CellList.build(points, 2.0).search(points, 2.0, 20)
    normals = surface_normals(points, near)
    np.testing.assert_allclose(np.abs(normals @ R[:, 2].astype(np.float32)), 1.0, atol=1e-3)


def test_none_without_neighbours() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [50, 0, 0]], np.float32)
    near = CellList.build(points, 2.0).search(points, 2.0, 8)
    np.testing.assert_array_equal(surface_normals(points, near), 0.0)


def test_same_as_an_eigenvalue_solver() -> None:
    rng = np.random.default_rng(3)
    points = (rng.normal(0, 1, (200, 3)) * [3.0, 2.0, 0.5]).astype(np.float32)
    near = CellList.build(points, 2.0).search(points, 2.0, 12)
    normals = surface_normals(points, near)
    for i in np.flatnonzero((near < 200).sum(axis=1) >= 6)[:50]:
        hood = points[near[i][near[i] < 200]].astype(np.float64)
        values, vectors = np.linalg.eigh(np.cov(hood.T))
        if values[0] < 0.8 * values[1]:
            assert abs(vectors[:, 0] @ normals[i]) > 0.99
