# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Registrar: what the front end asks of anything that aligns a scan with a keyframe."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Match:
    """A scan aligned with a keyframe.

    Attributes:
        T_keyframe_scan: (4, 4) float64, metres.
        confidence: calibrated P(transform right), [0, 1].
        uncertainty: (N,) float32, sigma^2 in [0, 1] per point of the scan; 1 = do not trust
            (moving, deforming or not seen by the keyframe).
        inliers: number of correspondences that agree with the transform.
    """

    T_keyframe_scan: NDArray[np.float64]
    confidence: float
    uncertainty: NDArray[np.float32]
    inliers: int


class Registrar(Protocol):
    """Global registration of a scan against a keyframe; a scan is encoded once."""

    def encode(self, points: NDArray[np.float32]) -> Any:
        """Encoding of one cloud (N, 3), sensor frame, metres, kept with a keyframe.

        Raises:
            RegistrationError: too few points, or no extent.
        """

    def match(self, scan: Any, keyframe: Any) -> Match:
        """Align the encoding of a scan with that of a keyframe.

        Raises:
            RegistrationError: the encodings cannot be matched.
        """
