# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Looks at a place: free, on a surface, hidden, and by something that has gone since."""

from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.odometry.dynamics.cells import Cells, Grid
from hybridreg_ros.odometry.dynamics.evidence import COLUMNS, LOOKS, Look, Past, evidence_of
from hybridreg_ros.odometry.visibility.range_image import RangeImage, view_of

NOISE = (0.01, 0.0, 0.0)
STEP = 0.004


def wall(at_m: float, half_m: float = 4.0) -> np.ndarray:
    """A wall across x, seen from the origin."""
    step_m = STEP * at_m
    y, z = np.meshgrid(np.arange(-half_m, half_m, step_m), np.arange(-1.5, 1.5, step_m))
    return np.c_[np.full(y.size, at_m), y.ravel(), z.ravel()].astype(np.float32)


def seen(*surfaces: np.ndarray) -> np.ndarray:
    """What is seen of surfaces: the nearest point in each direction."""
    points = np.concatenate(surfaces)
    direction = np.round(points[:, 1:] / points[:, :1] / STEP).astype(int)
    order = np.argsort(points[:, 0], kind='stable')
    _, first = np.unique(direction[order], axis=0, return_index=True)
    return points[order[first]]


def test_margins_are_in_standard_deviations_and_what_has_gone_has_a_speed() -> None:
    before, after = seen(wall(4.0), wall(3.0, 0.5)), seen(wall(4.0), wall(3.5, 0.5))
    view = view_of(before, 'depth')
    old, new = RangeImage(before, view, np.eye(4)), RangeImage(after, view, np.eye(4))
    places = np.array([[3.5, 0.0, 0.0], [3.9, 2.0, 0.0], [4.0, 2.0, 0.0], [3.0, 0.0, 50.0]])
    margin, speed = old.look(places, np.eye(4), new, NOISE, 0.5)
    assert margin[0] == pytest.approx(-50.0, rel=0.1)
    assert speed[0] == pytest.approx(1.0, rel=0.1)
    assert margin[1] == pytest.approx(0.1 * 4.38 / 4.0 / 0.01, rel=0.3)
    assert margin[2] == 0.0
    assert np.isnan(margin[3])
    assert (speed[1:] == -1.0).all()
    # As long as it stands there, what it hides is not behind something that has gone.
    assert old.look(places, np.eye(4), old, NOISE, 0.5)[1][0] == -1.0


def test_what_came_has_been_seen_free_and_what_stays_has_not() -> None:
    empty, with_thing = seen(wall(4.0)), seen(wall(4.0), wall(2.0, 0.3))
    view = view_of(empty, 'depth')
    past = Past()
    for k in range(3):
        past.keep(Look(k * 100_000_000, RangeImage(empty, view, np.eye(4)), empty[:1]))
    cells = Cells.of(with_thing, np.ones(len(with_thing), np.int32), np.eye(4), Grid(0.1, 0.002))
    looks = past.looks(300_000_000)
    assert [round(age, 3) for age, _ in looks] == [0.1, 0.2, 0.3]
    now, static = (
        RangeImage(with_thing, view, np.eye(4)),
        np.full(len(with_thing), 0.1, np.float32),
    )
    evidence = evidence_of(cells, looks, now, 'depth', static)
    assert evidence.shape == (len(cells), COLUMNS)
    assert np.isfinite(evidence).all()
    thing = np.linalg.norm(cells.centre[:, 1:] / [0.3, 0.6], axis=1) < 1.0
    thing &= cells.centre[:, 0] < 3.0
    inside = (np.abs(cells.centre[:, 1]) > 1.0) & (np.abs(cells.centre[:, 1]) < 3.0)
    assert (evidence[thing, 3] == 3 / LOOKS).all()
    assert (evidence[inside, 3] == 0.0).all()
    assert evidence[:, 26] == pytest.approx(np.log(9.0))
    assert (evidence[:, 27] == 1.0).all()
    unasked = evidence_of(cells, looks, now, 'depth', None)
    assert (unasked[:, :26] == evidence[:, :26]).all()
    assert not unasked[:, 26:].any()


def test_where_nothing_came_back_is_neither_free_nor_unseen() -> None:
    """A window in the wall: a thing before it stands where a look had no return."""
    whole = wall(4.0)
    holed = whole[(np.abs(whole[:, 1:]) > 0.8).any(axis=1)]
    view = view_of(whole, 'depth')
    past = Past()
    past.keep(Look(0, RangeImage(holed, view, np.eye(4)), whole))
    now = RangeImage(seen(holed, wall(2.0, 0.2)), view, np.eye(4))
    places = np.array([[2.0, 0.0, 0.0], [2.0, 1.0, 0.0], [2.0, 0.0, 50.0]])
    margin = past.looks(1)[0][1].look(places, np.eye(4), now, NOISE, 0.1)[0]
    assert np.isposinf(margin[0])
    assert margin[1] > 2.0
    assert np.isnan(margin[2])
    cells = Cells.of(
        places[:2].astype(np.float32), np.ones(2, np.int32), np.eye(4), Grid(0.1, 0.002)
    )
    evidence = evidence_of(cells, past.looks(100_000_000), now, 'depth', None)
    assert evidence[:, 25].tolist() == [1.0, 0.0]
    assert evidence[:, 0].tolist() == [0.0, 1 / LOOKS]
    assert len(past.vanished(RangeImage(holed, view, np.eye(4)), 'depth')) == 0


def test_the_past_is_kept_closely_when_it_is_recent_and_sparsely_when_it_is_old() -> None:
    points = wall(3.0)
    image = RangeImage(points, view_of(points, 'depth'), np.eye(4))
    past = Past()
    for k in range(100):
        past.keep(Look(k * 100_000_000, image, points[:1]))
    ages = np.array([age for age, _ in past.looks(10_000_000_000)])
    assert len(ages) == LOOKS
    assert ages[0] == pytest.approx(0.1)
    assert (np.diff(ages) > 0.0).all()
    assert ages[-1] > 2.0
    assert ages[3] < 1.0
    past.clear()
    assert past.looks(0) == []


def test_points_in_space_seen_free_since_have_vanished() -> None:
    before, after = seen(wall(4.0), wall(2.0, 0.3)), seen(wall(4.0))
    view = view_of(before, 'depth')
    past = Past()
    past.keep(Look(0, RangeImage(before, view, np.eye(4)), before))
    gone = past.vanished(RangeImage(after, view, np.eye(4)), 'depth')
    in_view = (before[:, 0] < 3.0) & (np.abs(before[:, 2]) < 0.6)
    assert len(gone) > 0.9 * in_view.sum()
    assert (gone[:, 0] < 3.0).all()
