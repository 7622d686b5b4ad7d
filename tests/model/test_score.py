# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Traces of poses: what they measure, what the mask changes, and that right poses win."""

from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.core import se3
from hybridreg_ros.model.geometry.neighbours import CellList
from hybridreg_ros.model.geometry.normals import surface_normals
from hybridreg_ros.model.geometry.views import View, fits, intrusions
from hybridreg_ros.model.pose.hypotheses import Candidates
from hybridreg_ros.model.pose.score import TRACES, Opinion, scores, traces

SENSOR = np.array([40.0, 40.0, 30.0])
TRUE = se3.exp(np.array([6.0, -4.0, 1.0, 0.0, 0.1, 0.4]))


def view(points: np.ndarray, sensor: np.ndarray) -> View:
    near = CellList.build(points, 3.0).search(points, 3.0, 12)
    return View.build(points, surface_normals(points, near), sensor)


@pytest.fixture
def views(room: np.ndarray) -> tuple[View, View]:
    voxels = room / np.float32(0.05)
    moved = se3.apply(TRUE, voxels[1::2]).astype(np.float32)
    return view(voxels[::2].copy(), SENSOR), view(moved, se3.apply(TRUE, SENSOR[None])[0])


@pytest.fixture
def matches(views: tuple[View, View]) -> Candidates:
    s = views[0].points[::40].astype(np.float64)
    return Candidates(s, se3.apply(TRUE, s), np.linspace(1.0, 0.1, len(s)))


def column(found: np.ndarray, name: str) -> np.ndarray:
    return found[:, TRACES.index(name)]


def off(*shift: float) -> np.ndarray:
    return se3.exp(np.array([*shift, 0.0, 0.0, 0.0])) @ TRUE


def test_the_true_pose_wins(views: tuple[View, View], matches: Candidates) -> None:
    poses = np.array([TRUE, off(3, 0, 0), off(0, 0, 8), np.eye(4)])
    found = traces(poses, matches, views, (Opinion.none(views[0]), Opinion.none(views[1])))
    assert found.shape == (4, len(TRACES))
    assert np.argmax(scores(found)) == 0
    for name in ('fit', 'tight', 'trusted', 'agreement', 'contact'):
        assert np.argmax(column(found, name)) == 0
    assert column(found, 'agreement')[0] == pytest.approx(1.0)
    assert (column(found, 'tight') <= column(found, 'fit')).all()
    assert ((column(found, 'hold') >= -1e-12) & (column(found, 'hold') <= 1 / 3 + 1e-9)).all()


def test_without_a_mask_they_are_the_plain_fit_and_intrusion(
    views: tuple[View, View], matches: Candidates
) -> None:
    poses = np.array([TRUE, off(2, 1, 0), off(0, 12, 0)])
    found = traces(poses, matches, views, (Opinion.none(views[0]), Opinion.none(views[1])))
    np.testing.assert_allclose(column(found, 'fit'), fits(poses, *views, 1.5), rtol=1e-5)
    np.testing.assert_allclose(
        column(found, 'intrusion'), intrusions(poses, *views, 3.0, 0.03), rtol=1e-6
    )
    np.testing.assert_allclose(column(found, 'trusted'), column(found, 'tight'), rtol=1e-5)
    assert (column(found, 'visible') >= column(found, 'intrusion')).all()


def test_what_moves_does_not_count(views: tuple[View, View], matches: Candidates) -> None:
    """Points that the mask calls moving neither intrude nor speak for a pose."""
    poses = np.array([off(0, 12, 0)])
    everything = Opinion.none(views[0]), Opinion.none(views[1])
    before = traces(poses, matches, views, everything)
    assert column(before, 'intrusion')[0] > 0.02
    x = [(v.sample[:, 0] < np.median(v.sample[:, 0])).astype(np.float32) for v in views]
    half = tuple(Opinion(w, w) for w in x)
    after = traces(poses, matches, views, half)  # type: ignore[arg-type]
    for name in ('trusted', 'intrusion', 'visible'):
        assert column(after, name)[0] != pytest.approx(column(before, name)[0], rel=1e-3)
    for name in ('fit', 'tight', 'agreement', 'hold', 'contact'):
        assert column(after, name)[0] == pytest.approx(column(before, name)[0])
    nothing = tuple(Opinion(np.zeros_like(w), np.zeros_like(w)) for w in x)
    silent = traces(poses, matches, views, nothing)  # type: ignore[arg-type]
    assert column(silent, 'trusted')[0] == column(silent, 'intrusion')[0] == 0.0
    assert np.isfinite(silent).all()


def test_one_plane_does_not_hold(matches: Candidates) -> None:
    x, y = np.meshgrid(np.arange(40.0), np.arange(40.0))
    plane = np.stack([x, y, 0.0 * x], axis=-1).reshape(-1, 3).astype(np.float32)
    one = view(plane, np.array([20.0, 20.0, 30.0]))
    opinion = Opinion.none(one)
    found = traces(np.eye(4)[None], matches, (one, one), (opinion, opinion))
    assert column(found, 'hold')[0] == pytest.approx(0.0, abs=1e-6)
    assert column(found, 'contact')[0] == pytest.approx(np.log1p(len(one.sample)), rel=1e-3)
