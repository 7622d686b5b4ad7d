# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pyramids: levels, patches, frames, invariances, and clouds that cannot be used."""

from __future__ import annotations

import time

import numpy as np
import pytest

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.geometry.pyramid import (
    Pyramid,
    build_pyramid,
    metric_transform,
    voxel_transform,
)
from hybridreg_ros.model.geometry.upsampling import upsample_to_level0, values_of_inputs

CONFIG = ModelConfig()


def _equal(a: Pyramid, b: Pyramid) -> None:
    for x, y in zip(a.levels, b.levels, strict=True):
        np.testing.assert_allclose(x.points, y.points, atol=1e-4, rtol=0)
    np.testing.assert_array_equal(a.patch_index, b.patch_index)


def test_levels_are_voxel_grids_of_the_cloud(room: np.ndarray) -> None:
    pyramid = build_pyramid(room, 0.05, CONFIG)
    counts = [len(level.points) for level in pyramid.levels]
    assert counts == sorted(counts, reverse=True)
    for i, level in enumerate(pyramid.levels):
        voxels = np.floor(level.points / 2**i + 1e-4)
        assert len(np.unique(voxels, axis=0)) > 0.99 * len(voxels)
    metric = pyramid.metric(pyramid.levels[0].points)
    own = metric[pyramid.input_to_level0]
    assert np.abs(own - room).max() < 0.05
    assert np.linalg.norm(own - room, axis=1).mean() < 0.03


def test_order_of_the_points_does_not_matter(room: np.ndarray, rng: np.random.Generator) -> None:
    order = rng.permutation(len(room))
    a, b = build_pyramid(room, 0.05, CONFIG), build_pyramid(room[order], 0.05, CONFIG)
    _equal(a, b)
    np.testing.assert_array_equal(a.input_to_level0[order], b.input_to_level0)


def test_rows_with_nan_are_left_out(room: np.ndarray) -> None:
    holed = np.insert(room, [10, 500], np.nan, axis=0)
    holed[0, 1] = np.inf
    pyramid = build_pyramid(holed, 0.05, CONFIG)
    _equal(pyramid, build_pyramid(room[1:], 0.05, CONFIG))
    missing = np.flatnonzero(pyramid.input_to_level0 == -1)
    np.testing.assert_array_equal(missing, [0, 10, 501])


def test_patches_are_the_nearest_fine_points(room: np.ndarray) -> None:
    pyramid = build_pyramid(room, 0.05, CONFIG)
    fine, super_ = pyramid.fine_points, pyramid.superpoints
    for s in (0, len(super_) // 2, len(super_) - 1):
        distance = np.linalg.norm(fine - super_[s], axis=1)
        expected = np.sort(distance[distance <= CONFIG.patch_radius])[: CONFIG.patch_size]
        got = distance[pyramid.patch_index[s][pyramid.patch_mask[s]]]
        np.testing.assert_allclose(got, expected, atol=1e-5)


def test_up_index_is_the_voxel_above(room: np.ndarray) -> None:
    levels = build_pyramid(room, 0.05, CONFIG).levels
    for i in range(len(levels) - 1):
        up = levels[i].up_index
        assert up is not None
        gap = np.linalg.norm(levels[i].points - levels[i + 1].points[up], axis=1)
        assert gap.max() <= 3**0.5 * 2 ** (i + 1)


def test_transforms_between_voxels_and_metres(room: np.ndarray) -> None:
    T = se3.exp(np.array([0.7, -0.4, 0.2, 0.3, 0.2, -0.5]))
    moved = se3.apply(T, room.astype(np.float64)).astype(np.float32)
    a, b = build_pyramid(room, 0.05, CONFIG), build_pyramid(moved, 0.05, CONFIG)
    V = voxel_transform(T, a, b)
    np.testing.assert_allclose(metric_transform(V, a, b), T, atol=1e-9)
    voxels = (room - a.origin_m) / 0.05
    np.testing.assert_allclose(
        b.metric(se3.apply(V, voxels)), se3.apply(T, room.astype(np.float64)), atol=1e-6
    )


def test_far_from_the_origin_precision_stays(room: np.ndarray) -> None:
    far = room.astype(np.float64) + np.array([512.0, -512.0, 64.0])
    a, b = build_pyramid(room, 0.05, CONFIG), build_pyramid(far.astype(np.float32), 0.05, CONFIG)
    gap = b.metric(b.levels[0].points)[b.input_to_level0] - far
    assert np.abs(gap).max() < 0.052
    assert abs(len(a.levels[0].points) - len(b.levels[0].points)) < 200


def test_caps_bound_the_levels(rng: np.random.Generator) -> None:
    config = ModelConfig(max_points=2000, max_superpoints=50)
    cloud = rng.uniform(0, 20, (20_000, 3)).astype(np.float32)
    pyramid = build_pyramid(cloud, 0.05, config)
    assert len(pyramid.levels[0].points) == 2000
    assert len(pyramid.superpoints) == 50
    assert pyramid.input_to_level0.max() == 1999
    up = pyramid.levels[2].up_index
    assert up is not None
    assert up.max() == 49


@pytest.mark.slow
def test_ten_million_points_stay_bounded(rng: np.random.Generator) -> None:
    cloud = rng.uniform(-40, 40, (10_000_000, 3)).astype(np.float32)
    start = time.process_time()
    pyramid = build_pyramid(cloud, 0.3, CONFIG)
    assert time.process_time() - start < 30.0
    assert len(pyramid.levels[0].points) == CONFIG.max_points


@pytest.mark.parametrize(
    ('points', 'message'),
    [
        (np.zeros((0, 3)), 'at least 3 finite points, found 0'),
        (np.zeros((1, 3)), 'at least 3 finite points, found 1'),
        (np.full((9, 3), np.nan), 'at least 3 finite points, found 0'),
        (np.ones((500, 3)), 'no extent'),
        (np.full((5, 3), 1e9), 'too large for voxels'),
        (np.array([[0, 0, 0], [1, 0, 0], [1e6, 0, 0]]), 'too large for voxels'),
        (np.zeros((5, 2)), 'expected .N, 3., found .5, 2.'),
    ],
)
def test_unusable_clouds(points: np.ndarray, message: str) -> None:
    with pytest.raises(RegistrationError, match=message):
        build_pyramid(points.astype(np.float32), 0.05, CONFIG)


@pytest.mark.parametrize('voxel', [0.0, -1.0, float('nan')])
def test_bad_voxel_size(room: np.ndarray, voxel: float) -> None:
    with pytest.raises(RegistrationError, match='voxel_size_m: expected > 0'):
        build_pyramid(room, voxel, CONFIG)


def test_spread_interpolates_between_superpoints(room: np.ndarray) -> None:
    pyramid = build_pyramid(room, 0.05, CONFIG)
    height = pyramid.superpoints[:, 2]
    level0 = upsample_to_level0(pyramid, height)
    true = pyramid.levels[0].points[:, 2]
    assert np.corrcoef(level0, true)[0, 1] > 0.95
    assert height.min() <= level0.min() <= level0.max() <= height.max()
    inputs = values_of_inputs(pyramid, level0)
    assert inputs.shape == (len(room),)
    assert inputs.dtype == np.float32


def test_spread_reaches_lonely_points() -> None:
    cloud = np.concatenate([np.random.default_rng(0).random((300, 3)), [[40.0, 0, 0]]])
    config = ModelConfig(max_superpoints=8)
    pyramid = build_pyramid(cloud.astype(np.float32), 0.05, config)
    level0 = upsample_to_level0(pyramid, np.ones(len(pyramid.superpoints), np.float32))
    np.testing.assert_allclose(level0, 1.0, atol=1e-6)
