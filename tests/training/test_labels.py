# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.core import se3
from hybridreg_ros.training import labels as lab


def hand_made():
    """Nine source points in a row, one unit apart, three patches; target = the last six moved."""
    points = np.zeros((9, 3), np.float32)
    points[:, 0] = np.arange(9)
    T = se3.exp(np.array([0.5, -1.0, 2.0, 0.1, 0.2, -0.3]))
    target = se3.apply(T, points[3:]).astype(np.float32)
    index = np.arange(9).reshape(3, 3)
    source = lab.Patches(points, np.ones(9, bool), index)
    return source, lab.Patches(target, np.ones(6, bool), index[:2]), T


def labels_of(source, target, T, **kw):
    return lab.pair_labels(source, target, T, radius=0.5, rng=np.random.default_rng(0), **kw)


def test_overlap_by_hand():
    source, target, T = hand_made()
    labels = labels_of(source, target, T)
    np.testing.assert_array_equal(labels.overlap, [[0, 0], [1, 0], [0, 1]])
    np.testing.assert_array_equal(labels.source_trusted, [0, 1, 1])
    np.testing.assert_array_equal(labels.target_trusted, [1, 1])
    assert set(zip(labels.pair_source, labels.pair_target, strict=True)) == {(1, 0), (2, 1)}


def test_covered_superpoints_are_never_positive_even_where_geometry_coincides():
    source, target, T = hand_made()
    moving = np.array([False] * 3 + [False, False, True] + [True] * 3)
    source = lab.Patches(source.points, moving, source.index)
    labels = labels_of(source, target, T)
    assert (labels.overlap[1] == 0).all()  # one of three static: covered
    assert labels.overlap[2, 1] == 1
    assert labels.source_trusted[1] == 0
    assert labels.source_static[1] == pytest.approx(1 / 3)
    assert labels.target_trusted[0] == pytest.approx(1 / 3)


def test_partly_moving_patch_loses_just_those_points():
    source, target, T = hand_made()
    static = np.ones(9, bool)
    static[3] = False
    labels = labels_of(lab.Patches(source.points, static, source.index), target, T)
    assert labels.overlap[1, 0] == pytest.approx(2 / 3)
    fine = labels.fine[list(labels.pair_source).index(1)]
    assert fine[0, 3]  # the moving point takes the slack
    assert fine[3, 0]
    assert fine[1, 1]
    assert fine[2, 2]
    assert fine.sum() == 4


def test_padded_patches_and_duplicates():
    source, target, T = hand_made()
    index = np.array([[3, 4, 9], [5, 5, 9]])
    labels = labels_of(lab.Patches(source.points, source.static, index), target, T)
    np.testing.assert_allclose(labels.overlap, [[(1 + 2 / 3) / 2, 0], [(1 + 1 / 3) / 2, 0]])
    fine = labels.fine[0]
    assert not fine[2].any() or labels.pair_source[0] != 0
    assert not fine[3, 3]


def naive_overlap(source, target, T, radius):
    moved = se3.apply(T, source.points.astype(float))
    distance = np.linalg.norm(moved[:, None] - target.points[None], axis=2)
    near = (distance < radius) & source.static[:, None] & target.static[None]
    result = np.zeros((len(source.index), len(target.index)))
    for i, a in enumerate(source.index):
        for j, b in enumerate(target.index):
            block = near[np.ix_(a, b)]
            result[i, j] = (block.any(1).mean() + block.any(0).mean()) / 2
            if source.static[a].mean() < 0.5 or target.static[b].mean() < 0.5:
                result[i, j] = 0
    return result, near


def test_random_pair_against_loops():
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 4, (120, 3)).astype(np.float32)
    T = se3.exp(rng.normal(size=6))
    other = np.concatenate([se3.apply(T, points[40:]), rng.uniform(-4, 4, (30, 3))])
    other = (other + rng.normal(0, 0.05, other.shape)).astype(np.float32)
    clouds = []
    for cloud in (points, other):
        index = np.stack([rng.permutation(len(cloud))[:8] for _ in range(20)])
        clouds.append(lab.Patches(cloud, rng.random(len(cloud)) < 0.7, index))
    a, b = clouds
    labels = lab.pair_labels(a, b, T, radius=0.4, rng=rng, max_pairs=10, max_anchors=15)
    expected, near = naive_overlap(a, b, T, 0.4)
    np.testing.assert_allclose(labels.overlap, expected, atol=1e-6)
    assert len(labels.pair_source) == 10
    for p, (i, j) in enumerate(zip(labels.pair_source, labels.pair_target, strict=True)):
        assert labels.overlap[i, j] > 0.1
        inner = near[np.ix_(clouds[0].index[i], clouds[1].index[j])]
        np.testing.assert_array_equal(labels.fine[p, :8, :8], inner)
        np.testing.assert_array_equal(labels.fine[p, :8, 8], ~inner.any(1))
        np.testing.assert_array_equal(labels.fine[p, 8, :8], ~inner.any(0))
    assert labels.anchors.shape == (15, 2)
    assert near[labels.anchors[:, 0], labels.anchors[:, 1]].all()


def test_pair_without_any_overlap():
    source, target, _ = hand_made()
    labels = labels_of(source, target, se3.exp(np.array([50.0, 0, 0, 0, 0, 0])))
    assert (labels.overlap == 0).all()
    assert labels.fine.shape == (0, 4, 4)
    assert labels.anchors.shape == (0, 2)
    assert (labels.source_trusted == 0).all()


def test_everything_moving():
    source, target, T = hand_made()
    gone = lab.Patches(source.points, np.zeros(9, bool), source.index)
    labels = labels_of(gone, target, T)
    assert (labels.overlap == 0).all()
    assert (labels.target_trusted == 0).all()
