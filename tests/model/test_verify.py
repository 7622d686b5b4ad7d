# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Verification: finds a planted motion where LGR fails, repeats itself, is its own inverse."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros import HybridReg
from hybridreg_ros.core import se3
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.geometry.grid import Grid
from hybridreg_ros.model.geometry.neighbours import CellList
from hybridreg_ros.model.geometry.normals import surface_normals
from hybridreg_ros.model.geometry.views import View, fits, intrusions
from hybridreg_ros.model.network.estimators import PointMatches, lgr
from hybridreg_ros.model.pose.hypotheses import Candidates, consistent_hypotheses, distinct
from hybridreg_ros.model.pose.plane_icp import plane_icp
from hybridreg_ros.model.pose.verify import Verified, propose, verify

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.reference.network import HybridRegNet

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

TRUE = se3.exp(np.array([12.0, -7.0, 3.0, 0.1, -0.2, 0.6]))
SENSOR = np.array([40.0, 40.0, 30.0])


def _view(points: F32, sensor: F64) -> View:
    near = CellList.build(points, 3.0).search(points, 3.0, 12)
    return View.build(points, surface_normals(points, near), sensor)


@pytest.fixture
def clouds(room: F32) -> tuple[F32, F32]:
    """A room in voxels and the same moved, each with other points."""
    voxels = room / np.float32(0.05)
    return voxels[::2].copy(), se3.apply(TRUE, voxels[1::2]).astype(np.float32)


@pytest.fixture
def views(clouds: tuple[F32, F32]) -> tuple[View, View]:
    return _view(clouds[0], SENSOR), _view(clouds[1], se3.apply(TRUE, SENSOR[None])[0])


def _matches(rng: np.random.Generator, source: F32, outliers: float) -> PointMatches:
    """60 patches of 8 matches; outliers are wrong one by one, but five patches lie together."""
    near = source[rng.integers(0, len(source), 60)]
    rows = np.array([np.argsort(((source - c) ** 2).sum(axis=1))[:8] for c in near]).ravel()
    s = source[rows].astype(np.float64)
    t = se3.apply(TRUE, s) + rng.normal(0, 0.3, s.shape)
    bad = rng.random(len(s)) < outliers
    t[bad] = rng.uniform(t.min(axis=0), t.max(axis=0), (int(bad.sum()), 3))
    patch = np.repeat(np.arange(60), 8)
    lie = se3.exp(np.array([-60.0, 20.0, 0.0, 0.0, 0.0, 2.0]))
    together = (patch < 10) & (np.arange(480) % 8 < 6)
    t[together] = se3.apply(lie, s[together])
    return PointMatches(s, t, rng.uniform(0.1, 1.0, len(s)), patch)


def _error(T: F64, true: F64) -> tuple[float, float]:
    error = se3.inverse(true) @ T
    return se3.rotation_angle_deg(error[:3, :3]), float(np.linalg.norm(error[:3, 3]))


def _run(matches: PointMatches, views: tuple[View, View]) -> Verified:
    first = lgr(matches, 2.0, 5).V_target_source
    descriptors = Candidates(matches.source, matches.target, matches.weights)
    return verify(propose(descriptors, views), first, descriptors, views)


def test_finds_the_motion_where_lgr_fails(
    rng: np.random.Generator, clouds: tuple[F32, F32], views: tuple[View, View]
) -> None:
    matches = _matches(rng, clouds[0], 0.88)
    gap = np.linalg.norm(se3.apply(TRUE, matches.source) - matches.target, axis=1)
    assert (gap > 2.0).mean() > 0.85
    turn, shift = _error(lgr(matches, 2.0, 5).V_target_source, TRUE)
    assert turn > 10.0 or shift > 10.0
    found = _run(matches, views)
    turn, shift = _error(found.V_target_source, TRUE)
    assert turn < 1.0
    assert shift < 1.0
    first = lgr(matches, 2.0, 5).V_target_source
    assert found.fit > 3.0 * fits(first[None], *views, 1.5)[0]
    assert found.lead > 0.1
    assert found.intrusion < 0.05


def test_repeats_itself(
    rng: np.random.Generator, clouds: tuple[F32, F32], views: tuple[View, View]
) -> None:
    matches = _matches(rng, clouds[0], 0.8)
    one, two = _run(matches, views), _run(matches, views)
    np.testing.assert_array_equal(one.V_target_source, two.V_target_source)
    assert (one.fit, one.lead, one.agreement) == (two.fit, two.lead, two.agreement)


def test_swapped_clouds_give_the_inverse(
    rng: np.random.Generator, clouds: tuple[F32, F32], views: tuple[View, View]
) -> None:
    m = _matches(rng, clouds[0], 0.8)
    swapped = PointMatches(m.target, m.source, m.weights, m.patch)
    there = _run(m, views).V_target_source
    back = _run(swapped, (views[1], views[0])).V_target_source
    turn, shift = _error(back, se3.inverse(there))
    assert turn < 1.0
    assert shift < 1.0


def test_identity_where_all_agrees(clouds: tuple[F32, F32]) -> None:
    view = _view(clouds[0], SENSOR)
    s = clouds[0][:200].astype(np.float64)
    matches = PointMatches(s, s, np.ones(200), np.arange(200) // 10)
    found = _run(matches, (view, view))
    np.testing.assert_allclose(found.V_target_source, np.eye(4), atol=0.03)
    assert found.fit > 0.8  # not 1: at edges the surface's normal is not the point's own
    assert found.agreement == pytest.approx(1.0)
    assert found.matched == 200


def test_fit_counts_only_surfaces_that_face_alike(clouds: tuple[F32, F32]) -> None:
    view = _view(clouds[0], SENSOR)
    turned = dataclasses.replace(
        view, sample_normals=np.ascontiguousarray(np.roll(view.sample_normals, 1, axis=1))
    )
    as_is = fits(np.eye(4)[None], view, view, 1.5)[0]
    assert fits(np.eye(4)[None], turned, turned, 1.5)[0] < 0.3 * as_is


@pytest.mark.parametrize('count', [0, 2])
def test_without_matches_the_first_pose_is_judged(count: int, views: tuple[View, View]) -> None:
    few = Candidates(np.ones((count, 3)), np.ones((count, 3)), np.ones(count))
    found = verify(propose(few, views), TRUE, few, views)
    assert _error(found.V_target_source, TRUE)[1] < 1.0
    assert found.lead == 1.0


def test_hypotheses_need_three_matches(rng: np.random.Generator) -> None:
    s = rng.uniform(-20, 20, (40, 3))
    matches = Candidates(s, se3.apply(TRUE, s), np.ones(40))
    poses = consistent_hypotheses(matches, 2.0, 5, 10)
    assert poses.shape == (5, 4, 4)
    np.testing.assert_allclose(poses, np.broadcast_to(TRUE, (5, 4, 4)), atol=1e-9)
    two = Candidates(s[:2], matches.target[:2], matches.weights[:2])
    assert consistent_hypotheses(two, 2.0, 5, 10).shape == (0, 4, 4)


def test_distinct_keeps_the_best_of_each_group() -> None:
    shifts = np.array([0.0, 1.0, 10.0, 10.5, 30.0])
    T = np.tile(np.eye(4), (5, 1, 1))
    T[:, 0, 3] = shifts
    kept = distinct(T, np.array([1.0, 2.0, 5.0, 3.0, 0.5]), np.zeros((1, 3)), 4.0, 3)
    assert kept.tolist() == [2, 1, 4]


def test_fit_falls_away_from_the_truth(views: tuple[View, View]) -> None:
    off = se3.exp(np.array([3.0, 3.0, 3.0, 0.0, 0.0, 0.0])) @ TRUE
    far = se3.exp(np.array([1e4, 0.0, 0.0, 0.0, 0.0, 0.0])) @ TRUE
    right, near, none = fits(np.array([TRUE, off, far]), *views, 1.5)
    assert right > 3.0 * near > none == 0.0


def test_points_in_free_space_are_counted(room: F32) -> None:
    """A wall seen from 40 voxels; moved towards the sensor it stands where it looked through."""
    y, z = (c.ravel() for c in np.mgrid[-20:20:60j, -20:20:60j])
    wall = _view(np.c_[np.full(len(y), 40.0), y, z].astype(np.float32), np.zeros(3))
    T = np.tile(np.eye(4), (3, 1, 1))
    T[1, 0, 3], T[2, 0, 3] = -15.0, 15.0
    stays, nearer, behind = intrusions(T, wall, wall, 3.0, 0.03)
    assert stays == 0.0
    assert nearer > 0.15
    assert behind > 0.15  # then the source's sensor looked through the target


def test_plane_icp_mends_a_rough_pose(views: tuple[View, View]) -> None:
    rough = se3.exp(np.array([1.0, -0.8, 0.5, 0.02, -0.03, 0.02])) @ TRUE
    stages = [(views[1].wide, 3.0, 8), (views[1].grid, 1.5, 8)]
    mended = plane_icp(rough[None], *views, stages)[0]
    assert se3.is_rigid(mended)
    turn, shift = _error(mended, TRUE)
    assert turn < 0.5
    assert shift < 0.4


def test_register_keeps_the_pose_of_lgr(compact_net: HybridRegNet, room: F32) -> None:
    assert ModelConfig().estimator == 'verified'
    model = HybridReg(compact_net.config, compact_net)
    r = model.register(room, room + np.array([0.8, -0.4, 0.4], np.float32), voxel_size_m=0.05)
    plain = HybridReg(ModelConfig(estimator='lgr'), compact_net)
    other = plain.register(room, room + np.array([0.8, -0.4, 0.4], np.float32), voxel_size_m=0.05)
    np.testing.assert_array_equal(r.T_lgr, other.T_lgr)
    assert r.features.fit > 0.5
    assert other.features.fit == 0.0


def test_grid_of_a_cloud_that_fills_space_stays_small() -> None:
    points = np.random.default_rng(0).uniform(-5000, 5000, (3000, 3)).astype(np.float32)
    grid = Grid.build(points, 1.0)
    assert grid.nearest.size <= 24_000_000
    flat = points * np.array([1, 1, 0.001], np.float32)
    assert Grid.build(flat, 1.0).nearest.shape[0] == 500
