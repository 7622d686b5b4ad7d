# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The network without gradients on a CPU, in a few compiled calls.

The torch modules in `model/reference` are what trains; both agree up to the rounding of float32
(tests compare them).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybridreg_ros.model.network.forward_attention import correlate, self_attention
from hybridreg_ros.model.network.forward_backbone import backbone
from hybridreg_ros.model.network.forward_static import static_logits
from hybridreg_ros.model.network.output import Encoding, SuperpointOutput, check_voxels, sigma2_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.model.geometry.kernel import KernelOperator
    from hybridreg_ros.model.geometry.pyramid import Pyramid
    from hybridreg_ros.model.network.packed import Weights

    F32 = NDArray[np.float32]
    I32 = NDArray[np.int32]
    I64 = NDArray[np.int64]


class Network:
    """The network in use, on arrays.

    Attributes:
        dustbin: score of a fine point without a partner.
    """

    def __init__(self, config: ModelConfig, weights: Weights) -> None:
        self._config, self._weights = config, weights
        self.dustbin = weights.dustbin

    def encode(self, pyramid: Pyramid) -> Encoding[F32]:
        """Backbone, projection and first self-attention; what it keeps needs no operators."""
        config, weights, levels = self._config, self._weights, pyramid.levels
        fine, coarse = backbone(
            weights.backbone,
            tuple(_operator(v.conv) for v in levels),
            tuple(_operator(v.pool) for v in levels[:-1]),
            tuple(v.pool_index for v in levels[:-1]),
            tuple(v.up_index for v in levels[:-1]),
            1 + config.extra_blocks,
            config.fine_level,
            config.groups,
        )
        features = self_attention(coarse, pyramid.geometry, weights.transformer, 0, config.heads)
        return Encoding(pyramid.encoded, fine, features)

    def correlate(self, source: Encoding[F32], target: Encoding[F32]) -> SuperpointOutput[F32]:
        """Transformer and mask head over the superpoints of two clouds.

        Raises:
            RegistrationError: the encodings were made with different voxel sizes.
        """
        check_voxels(source, target)
        x, y, x_logits, y_logits = correlate(
            source.superpoint_features,
            target.superpoint_features,
            source.pyramid.geometry,
            target.pyramid.geometry,
            self._weights.transformer,
            self._config.blocks,
            self._config.heads,
        )
        sigma2 = sigma2_of(x_logits), sigma2_of(y_logits)
        return SuperpointOutput(x, y, x_logits, y_logits, *sigma2)

    def static_logits(self, looks: F32, fine: F32, owners: Sequence[I64]) -> F32:
        """Logits (N, 2) of P(static) and P(seen) of N points (`StaticHead.forward`)."""
        pack = self._weights.static
        assert pack is not None, 'these weights have no static head'
        found: F32 = static_logits(pack, looks, fine, tuple(owners), self._config.fine_level)
        return found


def _operator(operator: KernelOperator | None) -> tuple[I32, I32, F32]:
    assert operator is not None, 'this pyramid was stripped once it was encoded'
    return operator.rows, operator.columns, operator.weights
