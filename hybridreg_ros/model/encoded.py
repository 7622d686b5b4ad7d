# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""EncodedCloud: what registration keeps of one cloud."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from hybridreg_ros.model.geometry.sight import Sight

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.model.geometry.views import View
    from hybridreg_ros.model.network.output import Encoding


@dataclass(frozen=True, eq=False)
class EncodedCloud:
    """A cloud that is ready to be matched with others; keep it with a keyframe.

    Attributes:
        encoding: what the network keeps of it.
        view: what verification and refinement keep of it.
        points: (N, 3) float32 input points, metres, NaN rows included.
    """

    encoding: Encoding[NDArray[np.float32]]
    view: View
    points: NDArray[np.float32]

    @cached_property
    def sight(self) -> Sight:
        """What its sensor saw in every direction, found when it is first asked for."""
        return Sight.of(self.points)

    @property
    def voxel_size_m(self) -> float:
        """Metres per finest voxel."""
        return self.encoding.pyramid.voxel_size_m
