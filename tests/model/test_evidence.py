# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Evidence: trust weighs the fit, features that meet are compared, and both ways count alike."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros.core import se3
from hybridreg_ros.model.geometry.neighbours import CellList
from hybridreg_ros.model.geometry.normals import surface_normals
from hybridreg_ros.model.geometry.pyramid import build_pyramid
from hybridreg_ros.model.geometry.views import View, fits
from hybridreg_ros.model.pose.evidence import CloudEvidence, trusted_fit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.reference.network import HybridRegNet

    F32 = NDArray[np.float32]

RADIUS = 1.5
STAY = np.eye(4)
SENSOR = np.array([40.0, 40.0, 30.0])


@pytest.fixture
def view(room: F32) -> View:
    """A furnished corner, voxels."""
    points = room / np.float32(0.05)
    near = CellList.build(points, 3.0).search(points, 3.0, 12)
    return View.build(points, surface_normals(points, near), SENSOR)


def _evidence(view: View, rng: np.random.Generator) -> CloudEvidence:
    """Full trust, and features that change over some 20 voxels."""
    count = len(view.points)
    waves = rng.normal(scale=0.1, size=(3, 12))
    features = np.sin(view.points @ waves + rng.uniform(0, 6, 12)).astype(np.float32)
    features /= np.linalg.norm(features, axis=1, keepdims=True)
    return CloudEvidence(np.zeros(count, np.float32), np.arange(count), features)


def test_with_equal_trust_it_is_the_plain_fit(view: View, rng: np.random.Generator) -> None:
    e = _evidence(view, rng)
    for T in (STAY, se3.exp(np.array([0.4, -0.3, 0.2, 0.0, 0.0, 0.01]))):
        fit, _ = trusted_fit(T, (view, view), (e, e), RADIUS)
        assert fit == pytest.approx(fits(T[None], view, view, RADIUS)[0], rel=1e-5)


def test_distrusted_points_do_not_count(view: View, rng: np.random.Generator) -> None:
    """One half of the cloud was carried away: distrusting it restores the fit."""
    away = view.points[:, 0] > np.median(view.points[:, 0])
    points = view.points.copy()
    points[away, 2] += 30.0
    moved = dataclasses.replace(view, points=points, sample=points[view.rows])
    e = _evidence(view, rng)
    wary = dataclasses.replace(e, sigma2=np.where(away, 1.0, 0.0).astype(np.float32))
    plain, _ = trusted_fit(STAY, (moved, view), (e, e), RADIUS)
    trusted, _ = trusted_fit(STAY, (moved, view), (wary, wary), RADIUS)
    whole, _ = trusted_fit(STAY, (view, view), (e, e), RADIUS)
    assert plain < 0.8 * whole
    assert trusted > 0.9 * whole


def test_resemblance_tells_the_same_place_from_one_of_the_same_shape(
    view: View, rng: np.random.Generator
) -> None:
    own, other = _evidence(view, rng), _evidence(view, rng)
    _, same = trusted_fit(STAY, (view, view), (own, own), RADIUS)
    _, foreign = trusted_fit(STAY, (view, view), (own, other), RADIUS)
    assert same > 0.9
    assert foreign < 0.5


def test_resemblance_of_few_meetings_is_small(view: View, rng: np.random.Generator) -> None:
    e = _evidence(view, rng)
    few = dataclasses.replace(view, rows=view.rows[:3])
    _, alike = trusted_fit(STAY, (few, few), (e, e), RADIUS)
    assert 0.0 < alike < 0.3


def test_swapped_clouds_give_the_same(view: View, rng: np.random.Generator) -> None:
    a, b = _evidence(view, rng), _evidence(view, rng)
    b = dataclasses.replace(b, sigma2=rng.random(len(b.sigma2)).astype(np.float32))
    T = se3.exp(np.array([0.4, -0.3, 0.2, 0.0, 0.0, 0.01]))
    there = trusted_fit(T, (view, view), (a, b), RADIUS)
    back = trusted_fit(se3.inverse(T), (view, view), (b, a), RADIUS)
    np.testing.assert_allclose(there, back, rtol=1e-6)


def test_evidence_of_an_encoding(compact_net: HybridRegNet, room: F32) -> None:
    pyramid = build_pyramid(room, 0.05, compact_net.config)
    encoding = compact_net.for_use().encode(pyramid)
    e = CloudEvidence.of(encoding, np.full(len(pyramid.superpoints), 0.25, np.float32))
    np.testing.assert_allclose(e.sigma2, 0.25, atol=1e-6)
    assert e.sigma2.shape == (len(pyramid.levels[0].points),)
    np.testing.assert_allclose(np.linalg.norm(e.features, axis=1), 1.0, rtol=1e-5)
    gap = np.abs(pyramid.levels[0].points - pyramid.fine_points[e.owner])
    assert gap.max() <= 2.0  # a fine point holds what is in its voxel of two finest ones
