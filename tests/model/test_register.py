# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""register() as users call it: results, bad clouds, refinement, voxel size, confidence."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from hybridreg_ros import HybridReg
from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.model.budget import Budget
from hybridreg_ros.model.geometry.neighbours import CellList
from hybridreg_ros.model.geometry.normals import surface_normals
from hybridreg_ros.model.geometry.pyramid import build_pyramid
from hybridreg_ros.model.geometry.views import View
from hybridreg_ros.model.geometry.voxel_size import choose_voxel_size_m
from hybridreg_ros.model.network.matching import match
from hybridreg_ros.model.pose.confidence import ConfidenceFeatures, PairCalibration
from hybridreg_ros.model.pose.posterior import posterior_sigma2
from hybridreg_ros.model.pose.refine import refine

if TYPE_CHECKING:
    from hybridreg_ros.model.reference.network import HybridRegNet

SHIFT_M = np.array([0.8, -0.4, 0.4], np.float32)


@pytest.fixture(scope='module')
def model(compact_net: HybridRegNet) -> HybridReg:
    return HybridReg(compact_net.config, compact_net)


def test_result_of_a_shifted_copy(model: HybridReg, room: np.ndarray) -> None:
    holed = np.insert(room, 7, np.nan, axis=0)
    r = model.register(holed, room + SHIFT_M, voxel_size_m=0.05)
    true = se3.transform(np.eye(3), SHIFT_M.astype(float))
    np.testing.assert_allclose(r.T_target_source, true, atol=1e-3)
    assert r.T_target_source.dtype == np.float64
    assert 0.0 <= r.confidence <= 1.0
    assert r.source_uncertainty.shape == (len(holed),)
    assert r.target_uncertainty.shape == (len(room),)
    assert r.source_uncertainty.dtype == np.float32
    assert ((r.source_uncertainty >= 0) & (r.source_uncertainty <= 1)).all()
    assert r.source_uncertainty[7] == 1.0
    c = r.correspondences
    assert len(c) == len(c.source) == len(c.target)
    assert r.inliers <= len(c)
    assert set(r.timings_s) == {'encode', 'network', 'verify', 'refine', 'total'}


def test_register_equals_encode_and_match(model: HybridReg, room: np.ndarray) -> None:
    a, b = model.encode(room, 0.05), model.encode(room + SHIFT_M, 0.05)
    one, two = model.match(a, b), model.register(room, room + SHIFT_M, 0.05)
    one = model.finely(one, room, room + SHIFT_M)
    np.testing.assert_array_equal(one.T_target_source, two.T_target_source)
    np.testing.assert_array_equal(one.source_uncertainty, two.source_uncertainty)
    assert one.confidence == two.confidence


def test_encodings_keep_no_operators_of_the_backbone(model: HybridReg, room: np.ndarray) -> None:
    pyramid = build_pyramid(room, 0.05, model.config)
    kept = model.encode(room, 0.05)
    levels = kept.encoding.pyramid.levels
    assert all((v.conv, v.pool, v.pool_index) == (None, None, None) for v in levels)
    assert all(v.conv is not None for v in pyramid.levels)
    whole = dataclasses.replace(kept.encoding, pyramid=pyramid)
    coarse = model.net.correlate(whole, whole)
    one = match(whole, whole, coarse, model.net.dustbin, model.config)
    np.testing.assert_array_equal(one.weights, model.matches(kept, kept).weights)


def test_a_sequence_keeps_its_first_voxel_size(model: HybridReg, room: np.ndarray) -> None:
    sequence = model.sequence()
    first = sequence.encode(room)
    second = sequence.encode(1.2 * room)
    assert first.voxel_size_m == second.voxel_size_m == sequence.voxel_size_m
    assert sequence.match(second, first).T_keyframe_scan.shape == (4, 4)


def test_the_model_itself_keeps_nothing(model: HybridReg, room: np.ndarray) -> None:
    before = dict(vars(model))
    first, second = model.encode(room), model.encode(0.2 * room)
    assert second.voxel_size_m < first.voxel_size_m
    assert vars(model) == before
    with pytest.raises(RegistrationError, match='one voxel size'):
        model.match(second, first)


def test_a_budget_shrinks_all_levels(model: HybridReg, room: np.ndarray) -> None:
    budget = Budget(max_points=800, max_superpoints=40)
    full = model.encode(room).encoding.pyramid
    levels = model.sequence(budget).encode(room).encoding.pyramid.levels
    sizes = [len(level.points) for level in levels]
    assert sizes[0] <= 850
    assert sizes[-1] <= 52
    assert all(a < len(b.points) for a, b in zip(sizes, full.levels, strict=True))


def test_register_within_a_budget_tries_the_full_size_when_in_doubt(
    model: HybridReg, room: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried, attempt = [], HybridReg._attempt

    def seen(self: HybridReg, *args: Any) -> Any:
        tried.append(args[2])
        return attempt(self, *args)

    monkeypatch.setattr(HybridReg, '_attempt', seen)
    sure = HybridReg(dataclasses.replace(model.config, sure=0.0), model.net)
    assert sure.register(room, room + SHIFT_M, budget=Budget(800, 40)).attempts == 1
    full = choose_voxel_size_m(room, room + SHIFT_M)
    assert tried[0] > 1.1 * full
    never = HybridReg(dataclasses.replace(model.config, sure=1.0, attempts=2), model.net)
    assert never.register(room, room + SHIFT_M, budget=Budget(800, 40)).attempts == 2
    assert tried[1:] == [tried[0], full]


def test_voxel_factor_is_that_of_the_weights(compact_net: HybridRegNet, room: np.ndarray) -> None:
    config = dataclasses.replace(compact_net.config, voxel_factor=1.3)
    model = HybridReg(config, compact_net)
    suits = choose_voxel_size_m(room)
    assert model.encode(room).voxel_size_m == pytest.approx(1.3 * suits)
    assert model.register(room, room + SHIFT_M).voxel_size_m == pytest.approx(
        1.3 * choose_voxel_size_m(room, room + SHIFT_M)
    )
    assert model.register(room, room + SHIFT_M, 0.05).voxel_size_m == 0.05


def test_unrelated_clouds_get_low_confidence(model: HybridReg, rng: np.random.Generator) -> None:
    a, b = rng.uniform(-2, 2, (2, 1500, 3)).astype(np.float32)
    assert model.register(a, b).confidence < 0.5


@pytest.mark.parametrize('count', [3, 50])
def test_tiny_clouds(model: HybridReg, rng: np.random.Generator, count: int) -> None:
    cloud = rng.uniform(-1, 1, (count, 3)).astype(np.float32)
    r = model.register(cloud, cloud)
    assert np.isfinite(r.T_target_source).all()
    assert r.confidence < 0.5
    assert r.source_uncertainty.shape == (count,)


def test_one_plane_gets_low_confidence(model: HybridReg, rng: np.random.Generator) -> None:
    plane = rng.uniform(-2, 2, (4000, 3)).astype(np.float32) * np.array([1, 1, 0], np.float32)
    assert model.register(plane, plane + np.array([0.3, 0.1, 0], np.float32)).confidence < 0.5


@pytest.mark.parametrize('count', [0, 1, 2])
def test_too_few_points(model: HybridReg, room: np.ndarray, count: int) -> None:
    with pytest.raises(RegistrationError, match=r'no extent|at least 3'):
        model.register(room[:count], room)


def test_equal_points(model: HybridReg, room: np.ndarray) -> None:
    with pytest.raises(RegistrationError, match='no extent'):
        model.register(np.ones((400, 3)), room)


def test_all_nan(model: HybridReg, room: np.ndarray) -> None:
    with pytest.raises(RegistrationError, match='no extent'):
        model.register(np.full((400, 3), np.nan), room)


def test_millimetres(model: HybridReg, room: np.ndarray) -> None:
    with pytest.raises(RegistrationError, match='looks like millimetres'):
        model.register(1000.0 * room, 1000.0 * room)
    with pytest.raises(RegistrationError, match=r'looks like millimetres|other units'):
        model.register(1000.0 * room, room)
    with pytest.raises(RegistrationError, match='other units'):
        model.register(100.0 * room, room)


def test_huge_coordinates(model: HybridReg, room: np.ndarray) -> None:
    with pytest.raises(RegistrationError, match='too large for voxels'):
        model.register(room + 3e5, room)
    with pytest.raises(RegistrationError, match='no extent'):
        model.register(room + 1e9, room)  # one float32 number for all points


@pytest.mark.parametrize('bad', [np.zeros((5, 4)), np.zeros(9), np.full((4, 3), 'x')])
def test_wrong_shape_or_type(model: HybridReg, bad: np.ndarray) -> None:
    with pytest.raises(RegistrationError, match=r'expected real numbers of shape \(N, 3\)'):
        model.encode(bad)


@pytest.mark.parametrize(
    ('scale', 'low', 'high'), [(1.0, 0.045, 0.06), (0.05, 0.001, 0.01), (20.0, 0.25, 0.31)]
)
def test_voxel_size_follows_the_sensor(
    room: np.ndarray, scale: float, low: float, high: float
) -> None:
    cloud = room * np.float32(scale)
    assert low <= choose_voxel_size_m(cloud, cloud) <= high


def _view(points: np.ndarray) -> View:
    near = CellList.build(points, 3.0).search(points, 3.0, 12)
    return View.build(points, surface_normals(points, near), np.zeros(3))


def test_refinement_mends_a_small_error(room: np.ndarray) -> None:
    surface = _view(room / np.float32(0.05))
    wrong = se3.exp(np.array([1.0, -0.8, 0.5, 0.02, -0.03, 0.02]))
    refined = refine(surface, surface, wrong)
    assert refined.accepted
    np.testing.assert_allclose(refined.V_target_source, np.eye(4), atol=0.05)
    assert refined.overlap > 0.98  # the grid knows one point per cell, not always the nearest
    assert refined.correction > 0.5


def test_refinement_keeps_the_pose_where_it_would_harm(
    room: np.ndarray, rng: np.random.Generator
) -> None:
    surface = _view(room / np.float32(0.05))
    far = se3.exp(np.array([500.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    refined = refine(surface, surface, far)
    np.testing.assert_array_equal(refined.V_target_source, far)
    assert refined.overlap == 0.0


def test_refinement_ignores_what_moved(room: np.ndarray) -> None:
    """A part of the source moved on its own by more than the last radius: the rest decides."""
    voxels = room / np.float32(0.05)
    moving = (voxels[:, 0] > 30.0) & (voxels[:, 1] > 20.0)
    assert 0.05 < moving.mean() < 0.4
    source = _view(voxels + moving[:, None] * np.array([0, 4.0, 0], np.float32))
    refined = refine(source, _view(voxels), se3.exp(np.array([0.5, 0.3, 0.2, 0.01, 0, 0.01])))
    np.testing.assert_allclose(refined.V_target_source[:3, 3], 0.0, atol=0.1)


def test_last_alignment_is_finer_than_the_voxels(
    model: HybridReg, room: np.ndarray, rng: np.random.Generator
) -> None:
    """Two noisy clouds without a point in common, a pose that is off by a quarter of a voxel."""
    noisy = room + rng.normal(0.0, 0.003, room.shape).astype(np.float32)
    source, target = noisy[::2], noisy[1::2] + SHIFT_M
    true = se3.transform(np.eye(3), SHIFT_M.astype(float))
    off = se3.exp(np.array([0.02, -0.015, 0.01, 0.004, 0.0, -0.004])) @ true
    rough = model.match(model.encode(source, 0.1), model.encode(target, 0.1))
    fine = model.finely(dataclasses.replace(rough, T_target_source=off), source, target)
    moved = se3.apply(fine.T_target_source, room) - se3.apply(true, room)
    assert np.sqrt((moved**2).sum(axis=1).mean()) < 0.004
    assert fine.confidence == rough.confidence


def test_posterior_uncertainty_follows_the_pose(room: np.ndarray) -> None:
    voxels = room / np.float32(0.05)
    moving = voxels[:, 0] > 60.0
    assert 0.05 < moving.mean() < 0.9
    source = _view(voxels + moving[:, None] * np.array([0, 0, 30.0], np.float32))
    prior = np.full(len(voxels), 0.5, np.float32)
    sure = posterior_sigma2(prior, source, _view(voxels), np.eye(4), 1.0)
    assert sure[~moving].mean() < 0.1
    assert sure[moving].mean() > 0.8
    np.testing.assert_allclose(
        posterior_sigma2(prior, source, _view(voxels), np.eye(4), 0.0), prior
    )


def test_confidence_grows_with_the_evidence() -> None:
    good = ConfidenceFeatures(5.0, 0.8, 0.8, 0.7, 0.4, 0.6, 0.3, 0.5, 900)
    weak = ConfidenceFeatures(2.0, 0.1, 0.1, 0.2, 0.8, 0.3, 0.05, 3.0, 900)
    plane = ConfidenceFeatures(5.0, 0.8, 0.5, 0.7, 0.4, 0.6, 0.002, 0.5, 900)
    calibration = PairCalibration()
    assert calibration.probability(good) > 0.8
    assert calibration.probability(weak) < 0.1
    assert calibration.probability(plane) < 0.3
    assert calibration.probability(ConfidenceFeatures(residual=float('nan'))) == 0.0
