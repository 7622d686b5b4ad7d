# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The upright frame of a narrow view: turns with the clouds; views all round have none."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybridreg_ros.core import se3
from hybridreg_ros.model.geometry.upright import upright


def camera_view(seed: int, rows: int = 48, columns: int = 64) -> np.ndarray:
    """(N, 3) optical frame (x right, y down, z ahead): a floor 1.2 m below, a wall 4 m ahead."""
    u, v = np.meshgrid(np.linspace(-0.6, 0.6, columns), np.linspace(-0.45, 0.45, rows))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
    down = np.where(rays[:, 1] > 0.0, 1.2 / np.maximum(rays[:, 1], 1e-9), np.inf)
    points = rays * np.minimum(down, 4.0)[:, None]
    return (points + np.random.default_rng(seed).normal(0, 0.01, points.shape)).astype(np.float32)


def rotation(seed: int) -> np.ndarray:
    return se3.so3_exp(np.random.default_rng(seed).normal(0.0, 1.0, 3))


def test_upright_camera_stays_as_it_is() -> None:
    R = upright(camera_view(0), camera_view(1))
    assert R is not None
    assert np.degrees(np.arccos(np.clip(np.diag(R), -1, 1))).max() < 12.0


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_frame_turns_with_the_clouds(seed: int) -> None:
    source, target, Q = camera_view(0), camera_view(1), rotation(seed)
    R = upright(source, target)
    turned = upright(*((cloud @ Q.T).astype(np.float32) for cloud in (source, target)))
    assert R is not None
    assert turned is not None
    np.testing.assert_allclose(turned @ Q, R, atol=1e-3)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_frame_does_not_depend_on_which_cloud_is_the_source() -> None:
    source, target = camera_view(0), camera_view(1)[:1500]
    one, other = upright(source, target), upright(target, source)
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(one, other, atol=1e-9)


def test_view_all_round_or_next_to_nothing_has_no_frame() -> None:
    angle = np.linspace(0, 2 * np.pi, 500, endpoint=False)
    ring = np.stack([8 * np.cos(angle), 8 * np.sin(angle), 0.1 * angle], axis=1)
    camera = camera_view(0)
    assert upright(ring.astype(np.float32), ring.astype(np.float32)) is None
    assert upright(camera, ring.astype(np.float32)) is None
    assert upright(camera, camera[:5]) is None
    assert upright(np.zeros((50, 3), np.float32), camera) is None


def test_missing_points_change_nothing() -> None:
    source, target = camera_view(0), camera_view(1)
    holes = np.concatenate([np.full((1, 3), np.nan, np.float32), source])
    one, other = upright(holes, target), upright(source, target)
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(one, other, atol=1e-9)
