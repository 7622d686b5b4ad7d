# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Looks: free space, surfaces, shadows, what vanished, and what moves along with the sensor."""

from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.core import se3
from hybridreg_ros.model.geometry.sight import COUNT, Sight, looks, magnitude

STAY = np.eye(4)


def wall(x: float, half: float = 3.0, step: float = 0.05) -> np.ndarray:
    """Points (N, 3) of a wall across the x axis, metres."""
    y, z = np.meshgrid(np.arange(-half, half, step), np.arange(-half, half, step))
    return np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1).astype(np.float32)


def seen_by(points: np.ndarray, other: np.ndarray, T: np.ndarray = STAY) -> np.ndarray:
    """Looks (N, COUNT + 2) at points (N, 3) by another cloud."""
    found, _ = looks(Sight.of(points.astype(np.float32)), Sight.of(other), T)
    return found


def test_a_point_stands_before_on_or_behind_what_was_seen() -> None:
    found = seen_by(np.array([[3.0, 0.0, 0.0], [5.0, 0.0, 0.0], [7.0, 0.0, 0.0]]), wall(5.0))
    assert found.shape == (3, COUNT + 2)
    assert not found[:, COUNT:].any()
    for near in (1, 4, 8):  # how far what was seen lies behind, by direction, finely and widely
        assert found[0, near] == pytest.approx(magnitude(2.0), abs=0.03)
        assert found[2, near] == pytest.approx(magnitude(-2.0), abs=0.03)
        assert abs(found[1, near]) < magnitude(0.05)
        assert found[0, near + 1] < 0.0 < found[2, near + 1]
    assert found[0, 6] == pytest.approx(magnitude(2.0), abs=0.03)
    assert found[1, 6] < magnitude(0.05)


def test_nothing_is_said_where_nothing_was_seen() -> None:
    found = seen_by(np.array([[-5.0, 0.0, 0.0], [np.nan, 0.0, 0.0]]), wall(5.0))
    assert not found[0, [0, 1, 2, 3, 4, 5, 7, 8, 9, 11]].any()
    assert found[0, 6] == pytest.approx(magnitude(20.0))
    assert not found[1].any()


def test_the_nearest_point_seen_is_named() -> None:
    other = wall(5.0)
    points = other[::37] + np.float32(0.01)
    _, nearest = looks(Sight.of(points), Sight.of(other), STAY)
    assert (np.linalg.norm(other[nearest] - points, axis=1) < 0.08).all()


def test_what_vanished_shows_on_what_it_hid() -> None:
    thing = wall(3.0, half=0.4)
    before = np.concatenate([thing, wall(5.0)])  # it hides part of the wall, whose points stay
    now = wall(5.0)
    behind = seen_by(now, before)[:, 11]
    hidden = (np.abs(now[:, 1:]) < 0.5).all(axis=1)
    away = (np.abs(now[:, 1:]) > 1.0).any(axis=1)
    assert (behind[hidden] > magnitude(1.5)).all()
    assert (behind[away] < magnitude(0.1)).all()


def test_a_pose_is_undone_and_what_moves_along_is_known() -> None:
    T = se3.exp(np.array([0.4, 0.1, 0.0, 0.0, 0.0, 0.1]))
    body = wall(1.0, half=0.3)
    source = np.concatenate([wall(5.0), body])
    target = np.concatenate([se3.apply(T, wall(5.0)), body]).astype(np.float32)
    found = seen_by(source, target, T)
    still, along = found[: len(source) - len(body)], found[-len(body) :]
    inner = (np.abs(source[: len(still), 1:]) < 1.5).all(axis=1)
    assert np.median(still[inner, 6]) < magnitude(0.1)
    assert np.median(still[inner, 17]) > magnitude(0.2)
    assert (along[:, 17] < magnitude(0.02)).all()
    assert np.median(along[:, 6]) > magnitude(0.2)
