# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the network makes of one cloud and of two: of arrays in use, of tensors in training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from hybridreg_ros.core.errors import RegistrationError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.geometry.pyramid import Pyramid

    F32 = NDArray[np.float32]

Values = TypeVar('Values')
"""Arrays, or tensors where gradients pass."""


@dataclass(frozen=True, eq=False)
class Encoding(Generic[Values]):
    """One cloud after everything that does not need the other cloud (keep it with a keyframe).

    Attributes:
        pyramid: geometry of the cloud.
        fine_features: (F, fine_dim) features of `pyramid.fine_points`, not normalised.
        superpoint_features: (S, dim) after the first self-attention layer.
    """

    pyramid: Pyramid
    fine_features: Values
    superpoint_features: Values


@dataclass(frozen=True, eq=False)
class SuperpointOutput(Generic[Values]):
    """What two clouds say of each other's superpoints; rows belong to `pyramid.superpoints`.

    Attributes:
        source_features: (S, dim) unit length, after the transformer.
        target_features: (T, dim) unit length.
        source_logits: (S, n) mask logits; n = 2: P(static), P(seen by the other cloud); n = 1:
            P(both). The confidence is the product of their sigmoids, sigma2 = 1 - confidence.
        target_logits: (T, n).
        source_sigma2: (S,) uncertainty in (0, 1), 1 = do not trust.
        target_sigma2: (T,).
    """

    source_features: Values
    target_features: Values
    source_logits: Values
    target_logits: Values
    source_sigma2: Values
    target_sigma2: Values


def check_voxels(source: Encoding[Any], target: Encoding[Any]) -> None:
    """Check that two encodings can be compared.

    Raises:
        RegistrationError: they were made with different voxel sizes.
    """
    a, b = source.pyramid.voxel_size_m, target.pyramid.voxel_size_m
    if abs(a - b) > 1e-6 * max(a, b):
        raise RegistrationError(
            f'expected encodings of one voxel size, found {a:g} m and {b:g} m: '
            'encode both with the same voxel_size_m'
        )


def sigmoid(logits: F32) -> F32:
    """1 / (1 + exp(-x)), for large x too."""
    found: F32 = np.exp(-np.logaddexp(np.float32(0.0), -logits))
    return found


def sigma2_of(logits: F32) -> F32:
    """Uncertainty (S,) in (0, 1) of logits (S, n): one minus the product of their sigmoids."""
    found: F32 = np.clip(1.0 - sigmoid(logits).prod(axis=1), 1e-6, 1.0 - 1e-6)
    return found
