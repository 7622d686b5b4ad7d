# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The packaged network on 20 registered validation pairs: rotated together, and swapped."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros import HybridReg
from hybridreg_ros.core import se3
from hybridreg_ros.data.hybridmatch.room_pairs import make_pairs
from hybridreg_ros.metrics import registration
from hybridreg_ros.training.validation import overlap_points, threshold_m

if TYPE_CHECKING:
    from hybridreg_ros.data.pair import PointPair

PAIRS = 20
FIRST_SEED = 5_500_000


@pytest.fixture(scope='module')
def registered() -> list[tuple[PointPair, np.ndarray]]:
    """The first 20 pairs of a validation split that the network registers, and its poses."""
    model, found = HybridReg.from_pretrained(), []
    for seed in range(FIRST_SEED, FIRST_SEED + 200):
        for pair in make_pairs('room-match-10-30', seed):
            T = model.register(pair.source, pair.target).T_target_source
            error = registration.rmse_m(pair.T_target_source, T, overlap_points(pair))
            if error < threshold_m(pair.voxel_size_m):
                found.append((pair, T))
            if len(found) == PAIRS:
                return found
    pytest.fail(f'only {len(found)} pairs registered')


@pytest.mark.slow
def test_rotating_both_clouds_changes_nothing(registered) -> None:
    model = HybridReg.from_pretrained()
    rng = np.random.default_rng(0)
    worst = 0.0
    for pair, T in registered:
        R = se3.transform(se3.so3_exp(rng.normal(0, 1.0, 3)), np.zeros(3))
        turned = model.register(se3.apply(R, pair.source), se3.apply(R, pair.target))
        expected = R @ T @ se3.inverse(R)
        worst = max(worst, registration.rotation_error_deg(expected, turned.T_target_source))
    assert worst < 1.0


@pytest.mark.slow
def test_swapping_the_clouds_gives_the_inverse(registered) -> None:
    model = HybridReg.from_pretrained()
    for pair, T in registered:
        back = model.register(pair.target, pair.source).T_target_source
        error = back @ T
        assert se3.rotation_angle_deg(error[:3, :3]) < 1.0
        assert np.linalg.norm(error[:3, 3]) < 0.02
