# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Truth of another body: the pose between both is found, and not invented where there is none."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.metrics.extrinsic import extrinsic_of, fit_extrinsic, follow, other_body
from hybridreg_ros.metrics.trajectory import Trajectory

if TYPE_CHECKING:
    from numpy.typing import NDArray

OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
BODIES = {
    'lever arm': se3.transform(np.eye(3), np.array([0.3, -0.8, 1.2])),
    'optical frame': se3.transform(OPTICAL, np.array([0.1, 0.05, 0.4])),
}


def drive(flat: bool, n: int = 200) -> NDArray[np.float64]:
    """Poses of a vehicle in bends, on a plane or over rough ground."""
    poses = [np.eye(4)]
    for k in range(n - 1):
        roll, pitch = (0.0, 0.0) if flat else (0.02 * np.sin(k / 9), 0.02 * np.cos(k / 13))
        step = np.array([0.2, 0.0, 0.0, roll, pitch, 0.05 * np.sin(k / 15)])
        poses.append(poses[-1] @ se3.exp(step))
    return np.array(poses)


def measured(poses: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """The same with a drift of a few millimetres a step, in another world frame."""
    rng = np.random.default_rng(seed)
    found = [se3.exp(rng.normal(size=6)) @ poses[0]]
    for a, b in itertools.pairwise(poses):
        noise = rng.normal(0, 1, 6) * [0.002, 0.002, 0.002, 5e-4, 5e-4, 5e-4]
        found.append(found[-1] @ se3.inverse(a) @ b @ se3.exp(noise))
    return np.array(found)


@pytest.mark.parametrize('flat', [True, False])
@pytest.mark.parametrize('body', BODIES)
@pytest.mark.parametrize('seed', range(3))
def test_the_other_body_is_found(body: str, flat: bool, seed: int) -> None:
    reference, X = drive(flat), BODIES[body]
    found = fit_extrinsic(measured(reference @ X, seed), reference)
    assert found is not None
    seen = [0, 1] if flat else [0, 1, 2]  # on a plane the height of the sensor shows nowhere
    np.testing.assert_allclose(found[seen, 3], X[seen, 3], atol=0.1)
    assert se3.rotation_angle_deg(found[:3, :3].T @ X[:3, :3]) < 1.0


@pytest.mark.parametrize('flat', [True, False])
def test_no_body_is_invented(flat: bool) -> None:
    reference = drive(flat)
    estimate = measured(reference, 1)
    assert fit_extrinsic(estimate, reference) is None
    lost = estimate.copy()
    lost[60:, :3, 3] += [3.0, -2.0, 0.5]
    assert fit_extrinsic(lost, reference) is None, 'a jump is no other body'
    still = np.tile(np.eye(4), (200, 1, 1))
    assert fit_extrinsic(estimate, still) is None
    assert fit_extrinsic(estimate[:5], reference[:5]) is None


def test_the_warning_names_what_cures_it() -> None:
    stamps, X = np.arange(200) * 10**8, BODIES['optical frame']
    reference = Trajectory(stamps, drive(False))
    estimate = Trajectory(stamps, measured(reference.poses @ X, 0))
    text = other_body(estimate, reference, 0.01)
    numbers = [float(v) for v in text.split('--extrinsic ')[1].split(':')[0].split()]
    assert other_body(estimate, follow(reference, extrinsic_of(numbers)), 0.01) == ''
    assert 'instead of 13' in text


def test_what_is_no_extrinsic() -> None:
    np.testing.assert_allclose(extrinsic_of([1, 2, 3, 0, 0, 0, 1])[:3, 3], [1, 2, 3])
    with pytest.raises(ConfigError, match=r'extrinsic: quaternion .* has norm 2'):
        extrinsic_of([0, 0, 0, 0, 0, 0, 2])
    with pytest.raises(ConfigError, match='expected finite numbers'):
        extrinsic_of([float('nan'), 0, 0, 0, 0, 0, 1])
