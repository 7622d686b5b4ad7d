# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Shapes: volumes by formula, closed skins, sizes, and the small geometry below them."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from hybridreg_ros.data.meshes import shapes
from hybridreg_ros.data.meshes.csg import csg, deformed, free_form, isosurface
from hybridreg_ros.data.meshes.geometry import (
    SmoothNoise,
    bounds,
    fitted,
    random_rotation,
    voxel_thin,
)
from hybridreg_ros.data.meshes.scene import Mesh, merge
from hybridreg_ros.data.rooms.furniture_fittings import FAMILIES


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    return float(abs(np.einsum('ij,ij->i', a, np.cross(b, c)).sum()) / 6.0)


def open_edges(mesh: Mesh) -> int:
    """Edges that do not belong to exactly two triangles."""
    edges = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return sum(n != 2 for n in Counter(map(tuple, edges.tolist())).values())


SQUARE = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]
CLOSED = {
    'box': (shapes.box([1.0, 2.0, 3.0]), 6.0),
    'cylinder': (shapes.cylinder(0.5, 2.0, 64), 0.5 * np.pi),
    'prism': (shapes.extrusion(SQUARE, 2.0), 2.0),
    'tapered': (shapes.extrusion(SQUARE, 3.0, top_scale=0.5), 1.0 + 0.25 + 0.5),
    'ball': (shapes.superquadric([1.0, 2.0, 0.5], 1.0, 1.0, 41, 60), 4.0 / 3.0 * np.pi),
    'torus': (shapes.torus(2.0, 0.5, 60, 40), 2.0 * np.pi**2 * 2.0 * 0.25),
    'tube': (shapes.tube([[0, 0, 0], [0, 0, 1], [0, 0, 2]], 0.5, 40), 0.5 * np.pi),
}


@pytest.mark.parametrize('name', CLOSED)
def test_volume_is_that_of_the_solid(name: str) -> None:
    mesh, expected = CLOSED[name]
    assert open_edges(mesh) == 0
    assert volume(mesh) == pytest.approx(expected, rel=0.02)


def test_surface_nets_close_around_a_ball() -> None:
    axis = np.linspace(-1.2, 1.2, 25)
    x, y, z = np.meshgrid(axis, axis, axis, indexing='ij')
    mesh = isosurface(np.sqrt(x**2 + y**2 + z**2) - 1.0)
    assert open_edges(mesh) == 0
    assert volume(mesh) * 0.1**3 == pytest.approx(4.0 / 3.0 * np.pi, rel=0.03)
    radius = np.linalg.norm(mesh.vertices * 0.1 - 1.2, axis=1)
    assert np.abs(radius - 1.0).max() < 0.03


def test_free_forms_stand_on_the_ground_and_have_their_size() -> None:
    rng = np.random.default_rng(5)
    for size in (0.1, 0.5, 2.0):
        for _ in range(12):
            mesh = free_form(rng, size)
            low, high = bounds(mesh)
            assert np.isfinite(mesh.vertices).all()
            assert mesh.faces.min() >= 0
            assert mesh.faces.max() < len(mesh.vertices)
            assert low[2] == pytest.approx(0.0, abs=1e-4)
            assert (high - low).max() == pytest.approx(size, rel=1e-3)


def test_no_two_free_forms_are_alike() -> None:
    rng = np.random.default_rng(6)
    seen = {free_form(rng, 1.0).vertices.tobytes() for _ in range(20)}
    assert len(seen) == 20


def test_the_same_seed_gives_the_same_shape() -> None:
    one, two = (csg(np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(one.vertices, two.vertices)
    np.testing.assert_array_equal(one.faces, two.faces)
    a, b = (deformed(np.random.default_rng(4), one) for _ in range(2))
    np.testing.assert_array_equal(a.vertices, b.vertices)


@pytest.mark.parametrize('family', sorted(FAMILIES))
def test_furniture_stands_on_the_floor_and_is_furniture_sized(family: str) -> None:
    rng = np.random.default_rng(8)
    make = FAMILIES[family][0]
    seen = set()
    for _ in range(5):
        piece = make(rng)
        low, high = bounds(piece.mesh)
        assert np.isfinite(piece.mesh.vertices).all()
        assert low[2] > -0.02
        assert 0.03 < (high - low).max() < 6.0
        seen.add(piece.mesh.vertices.tobytes())
    assert len(seen) == 5, 'every piece differs'


def test_there_are_ten_furniture_families() -> None:
    assert len(FAMILIES) >= 10


def test_merge_keeps_every_triangle() -> None:
    both = merge([shapes.box([1, 1, 1]), shapes.box([1, 1, 1], [5.0, 0.0, 0.0])])
    assert volume(both) == pytest.approx(2.0)
    assert len(merge([]).faces) == 0


def test_fitted_has_the_size_asked_for() -> None:
    low, high = bounds(fitted(shapes.torus(1.0, 0.3), [1.0, 2.0, 3.0]))
    np.testing.assert_allclose(high - low, [1.0, 2.0, 3.0], rtol=1e-5)
    np.testing.assert_allclose(low, [-0.5, -1.0, 0.0], atol=1e-5)


def test_random_rotations_are_rotations(rng: np.random.Generator) -> None:
    for _ in range(10):
        R = random_rotation(rng)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)


def test_smooth_noise_has_its_amplitude_and_is_smooth(rng: np.random.Generator) -> None:
    points = rng.uniform(-50.0, 50.0, (4000, 3))
    noise = [SmoothNoise(np.random.default_rng(k), (1.0, 4.0), 0.2) for k in range(20)]
    spread = np.std([n(points) for n in noise])
    assert spread == pytest.approx(0.2, rel=0.1)
    step = np.abs(noise[0](points + np.array([1e-3, 0.0, 0.0])) - noise[0](points)).max()
    assert step < 0.2 * 2.0 * np.pi * 1e-3 * 4.0


def test_thinning_keeps_one_point_per_voxel(rng: np.random.Generator) -> None:
    points = rng.uniform(-1.0, 1.0, (5000, 3)).astype(np.float32)
    rows = voxel_thin(points, 0.2)
    cells = np.floor(points / 0.2).astype(int)
    assert len(rows) == len(np.unique(cells, axis=0))
    assert len(np.unique(cells[rows], axis=0)) == len(rows)
    first = {tuple(c): k for k, c in reversed(list(enumerate(cells.tolist())))}
    assert sorted(rows.tolist()) == sorted(first.values())
    assert len(voxel_thin(points[:0], 0.2)) == 0
