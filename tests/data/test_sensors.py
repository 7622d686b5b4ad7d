# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Depth camera: exact without noise, and with the noise that it says it has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybridreg_ros.data.meshes.geometry import look_at, moved
from hybridreg_ros.data.meshes.raycast import Caster
from hybridreg_ros.data.meshes.scene import Mesh, Scene, merge
from hybridreg_ros.data.sensors.depth_camera import (
    DepthCamera,
    DepthImage,
    DepthNoise,
    random_camera,
)

PERFECT = DepthCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
LARGE = DepthCamera(160, 120, 150.0, 150.0, 79.5, 59.5)


def wall(z: float, half: float = 50.0) -> Mesh:
    corners = [[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]]
    return Mesh(np.array(corners, np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def view(camera: DepthCamera, mesh: Mesh, seed: int = 0, loss: float | None = None) -> DepthImage:
    share = None if loss is None else np.full(len(mesh.faces), loss, np.float32)
    rng = np.random.default_rng(seed)
    return camera.render(Caster(Scene(mesh)), 0.0, np.eye(4), rng, loss=share)


def test_a_perfect_camera_measures_the_wall_exactly() -> None:
    image = view(PERFECT, wall(2.5))
    np.testing.assert_allclose(image.depth, 2.5, rtol=1e-5)
    np.testing.assert_allclose(image.clean, 2.5, rtol=1e-5)
    points = PERFECT.points(image.depth)
    np.testing.assert_allclose(points[..., 2], 2.5, rtol=1e-5)
    np.testing.assert_allclose(points[0, 0, :2], [-31.5 / 60 * 2.5, -23.5 / 60 * 2.5], rtol=1e-5)


def test_nothing_is_measured_outside_the_range() -> None:
    assert np.isnan(view(PERFECT, wall(0.2)).depth).all()
    far = view(PERFECT, wall(7.0))
    assert np.isnan(far.depth).all()
    np.testing.assert_allclose(far.clean, 7.0, rtol=1e-5)
    assert np.isnan(view(PERFECT, wall(-1.0)).depth).all()


def test_the_pose_of_the_camera_counts() -> None:
    T = look_at(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 3.0]))
    image = PERFECT.render(Caster(Scene(wall(3.0))), 0.0, T, np.random.default_rng(0))
    np.testing.assert_allclose(image.depth, 2.0, rtol=1e-5)


@pytest.mark.parametrize('depth', [1.0, 2.0, 4.0])
@pytest.mark.parametrize(
    'noise',
    [
        DepthNoise(base_m=0.004),
        DepthNoise(quadratic=0.003),
        DepthNoise(base_m=0.002, quadratic=0.002, disparity=400.0),
    ],
    ids=['base', 'quadratic', 'mixed'],
)
def test_noise_spreads_as_it_says(noise: DepthNoise, depth: float) -> None:
    camera = replace(LARGE, noise=noise)
    error = np.concatenate([view(camera, wall(depth), s).depth.ravel() - depth for s in range(4)])
    expected = float(noise.sigma_m(np.array(depth)))
    assert np.sqrt(np.nanmean(error**2)) == pytest.approx(expected, rel=0.12)
    assert abs(np.nanmean(error)) < 0.25 * expected


def test_the_slow_error_belongs_to_the_device() -> None:
    camera = replace(LARGE, noise=DepthNoise(warp=0.01, seed=5))
    one, two = (view(camera, wall(2.0), seed).depth for seed in (0, 1))
    np.testing.assert_array_equal(one, two)
    devices = [replace(LARGE, noise=DepthNoise(warp=0.01, seed=k)) for k in range(12)]
    spread = np.std([view(d, wall(2.0)).depth / 2.0 - 1.0 for d in devices])
    assert spread == pytest.approx(0.01, rel=0.3)


def test_depth_comes_in_steps_of_the_disparity() -> None:
    noise = DepthNoise(base_m=0.02, disparity=300.0)
    depth = view(replace(LARGE, noise=noise), wall(3.0)).depth
    steps = 300.0 / depth
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)
    assert len(np.unique(depth)) > 2


def test_oblique_surfaces_return_less() -> None:
    tilted = wall(0.0)
    angle = np.deg2rad(80.0)
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    camera = replace(LARGE, noise=DepthNoise(grazing=0.35))
    oblique = view(camera, moved(tilted, [0.0, 0.0, 2.5], R))
    straight = view(camera, wall(2.5))
    inside = (oblique.clean > 0.4) & (oblique.clean < 5.9)
    assert not np.isnan(straight.depth).any()
    assert np.isnan(oblique.depth[inside]).mean() > 0.2


def test_edges_lose_and_mix_pixels() -> None:
    scene = merge([wall(4.0), moved(wall(2.0, 0.5), [0.0, 0.0, 0.0])])
    lossy = view(replace(LARGE, noise=DepthNoise(edge_loss=0.8)), scene)
    lost = np.isnan(lossy.depth)
    assert 0.01 < lost.mean() < 0.2
    assert not lost[55:65, 75:85].any(), 'only edges lose pixels'
    mixed = view(replace(LARGE, noise=DepthNoise(flying=0.5)), scene).depth
    between = (mixed > 2.1) & (mixed < 3.9)
    assert 0.002 < between.mean() < 0.1


def test_dark_triangles_lose_their_share() -> None:
    lost = np.isnan(view(LARGE, wall(2.0), loss=0.4).depth).mean()
    assert lost == pytest.approx(0.4, abs=0.02)


def test_patches_take_their_share() -> None:
    camera = replace(LARGE, noise=DepthNoise(patchy=0.1))
    lost = [np.isnan(view(camera, wall(2.0), k).depth).mean() for k in range(5)]
    assert np.mean(lost) == pytest.approx(0.1, abs=0.03)


def test_a_ragged_pixel_carries_the_label_of_what_it_shows() -> None:
    scene = merge([wall(4.0), moved(wall(2.0, 0.5), [0.0, 0.0, 0.0])])
    image = view(replace(LARGE, noise=DepthNoise(ragged=0.6)), scene)
    near = image.depth < 3.0
    assert (image.face[near] >= 2).all()
    assert (image.face[~near] < 2).all()
    assert ((image.clean < 3.0) != near).any(), 'some pixels did look at a neighbour'


def test_noise_is_the_same_for_the_same_seed() -> None:
    camera = random_camera(np.random.default_rng(2)).strided(8.0)
    one, two, other = (view(camera, wall(2.0), s).depth for s in (1, 1, 2))
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(np.nan_to_num(one), np.nan_to_num(other))


def test_a_strided_camera_sees_the_same_field() -> None:
    full = DepthCamera()
    small = full.strided(4.0)
    assert (small.width, small.height) == (160, 120)
    assert 160 / small.fx == pytest.approx(640 / full.fx)
    assert (small.cx + 0.5) / 160 == pytest.approx((full.cx + 0.5) / 640)


def test_look_at_points_the_axis_and_keeps_the_horizon() -> None:
    eye, target = np.array([1.0, 2.0, 1.5]), np.array([4.0, -1.0, 0.5])
    T = look_at(eye, target)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(T[:3, 2], (target - eye) / np.linalg.norm(target - eye))
    assert T[2, 0] == pytest.approx(0.0, abs=1e-12)
    assert T[2, 1] < 0.0, 'y points down'
    down = look_at(eye, eye - [0.0, 0.0, 1.0])
    np.testing.assert_allclose(down[:3, 2], [0.0, 0.0, -1.0], atol=1e-12)
    many = look_at(np.stack([eye, eye]), np.stack([target, eye - [0.0, 0.0, 1.0]]), [0.0, 0.0])
    np.testing.assert_array_equal(many, np.stack([T, down]))
    assert look_at(eye, target, 0.3)[2, 0] != pytest.approx(0.0, abs=1e-3)
