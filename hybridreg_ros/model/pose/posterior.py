# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Uncertainty once the pose is known: what lies on the other cloud is static and seen by it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.model.pose.plane_icp import contacts

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.geometry.views import View

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

_RADIUS_VOXELS = 2.0
_LEAST, _MOST = 0.02, 0.98


def posterior_sigma2(
    prior: F32, moving: View, fixed: View, V_fixed_moving: F64, confidence: float
) -> F32:
    """Uncertainty of every finest point after the registration.

    If the pose is right, a point is static and seen by the other cloud just when it lies on that
    cloud: P = 1 - (d / 2 voxels)^2. If it is wrong, nothing but the network is known. The result
    mixes both by the probability that the pose is right.

    Args:
        prior: (N,) sigma2 of the network.
        moving: the cloud that the points belong to, voxels.
        fixed: the other cloud.
        V_fixed_moving: (4, 4) float64, voxels.
        confidence: P(pose right), [0, 1].

    Returns:
        (N,) float32 sigma2 in (0, 1), 1 = do not trust.
    """
    _, squared = contacts(V_fixed_moving, moving.points, fixed, _RADIUS_VOXELS)
    met = 1.0 - squared / _RADIUS_VOXELS**2
    geometry = 1.0 - np.clip(met, _LEAST, _MOST)
    mixed: F32 = (confidence * geometry + (1.0 - confidence) * prior).astype(np.float32)
    return mixed
