# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""HybridRegNet: encode a cloud once, then correlate encodings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import nn
from torch.nn import functional

from hybridreg_ros.model.network.forward import Network
from hybridreg_ros.model.network.output import Encoding, SuperpointOutput, check_voxels
from hybridreg_ros.model.network.packed import packed
from hybridreg_ros.model.reference.attention import CrossLayer, GeometryTable, SelfLayer
from hybridreg_ros.model.reference.backbone import Backbone
from hybridreg_ros.model.reference.fused import tensor_of
from hybridreg_ros.model.reference.static_head import StaticHead
from hybridreg_ros.model.reference.transport import Transport

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.model.geometry.pyramid import Pyramid

    F32 = NDArray[np.float32]
    Tensor = torch.Tensor


class MaskHead(nn.Module):
    """One cross-attention on the last self-attention features, then a two-layer MLP."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.cross = CrossLayer(config)
        self.hidden = nn.Linear(2 * config.dim, config.dim)
        self.output = nn.Linear(config.dim, config.mask_outputs)

    def forward(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Logits of both clouds.

        Args:
            x: (S, dim) source features after the last self-attention.
            y: (T, dim) target features.

        Returns:
            (S, n) and (T, n) logits, n = config.mask_outputs.
        """
        crossed = torch.cat(self.cross(x, y))
        hidden = functional.relu(self.hidden(torch.cat([torch.cat([x, y]), crossed], dim=1)))
        logits = self.output(hidden)
        return logits[: len(x)], logits[len(x) :]


def sigma2_of(logits: Tensor) -> Tensor:
    """Uncertainty (S,) in (0, 1) of logits (S, n): one minus the product of their sigmoids."""
    confidence = functional.logsigmoid(logits).sum(dim=1).exp()
    return (1.0 - confidence).clamp(1e-6, 1.0 - 1e-6)


class HybridRegNet(nn.Module):
    """The network of HybridReg (KPConv-FPN, geometric transformer, mask, optimal transport).

    Every normalisation is per cloud, so that an encoding is the same whatever it is matched with.
    Pyramids hold arrays, or tensors in their place.
    """

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        dim = config.dim
        self.backbone = Backbone(config)
        self.project = nn.Linear(config.widths[-1], dim)
        self.table = GeometryTable(config)
        self.self_layers = nn.ModuleList(SelfLayer(config) for _ in range(config.blocks))
        self.cross_layers = nn.ModuleList(CrossLayer(config) for _ in range(config.blocks))
        self.output = nn.Linear(dim, dim)
        self.mask = MaskHead(config)
        self.transport = Transport(config.sinkhorn_iterations)
        self.static = StaticHead(config) if config.static_width else None

    @classmethod
    def of(cls, config: ModelConfig, parameters: Mapping[str, NDArray[Any]]) -> HybridRegNet:
        """A network of given parameters by name, in evaluation mode."""
        network = cls(config)
        network.load_state_dict({k: torch.from_numpy(v).float() for k, v in parameters.items()})
        return network.eval()

    def parameters_by_name(self) -> dict[str, F32]:
        """Its parameters as arrays, as `packed` and a weights file take them."""
        return {k: v.detach().cpu().numpy() for k, v in self.state_dict().items()}

    def for_use(self) -> Network:
        """Its weights of now, for the compiled functions."""
        return Network(self.config, packed(self.config, self.parameters_by_name()))

    def encode(self, pyramid: Pyramid) -> Encoding[Tensor]:
        """Backbone, projection and first self-attention of one cloud."""
        fine, coarse = self.backbone(pyramid)
        features = self.project(coarse)
        features = self.self_layers[0](features, self.table(), pyramid.geometry)
        return Encoding(pyramid, fine, features)

    def correlate(
        self, source: Encoding[Tensor], target: Encoding[Tensor]
    ) -> SuperpointOutput[Tensor]:
        """Transformer and mask head over the superpoints of two clouds (differentiable).

        Raises:
            RegistrationError: the encodings were made with different voxel sizes.
        """
        check_voxels(source, target)
        x, y = source.superpoint_features, target.superpoint_features
        gx, gy = source.pyramid.geometry, target.pyramid.geometry
        table = self.table()
        for i in range(self.config.blocks):
            if i:
                x, y = self.self_layers[i](x, table, gx), self.self_layers[i](y, table, gy)
            before = x, y
            x, y = self.cross_layers[i](x, y)
        x_logits, y_logits = self.mask(*before)
        return SuperpointOutput(
            functional.normalize(self.output(x), dim=1),
            functional.normalize(self.output(y), dim=1),
            x_logits,
            y_logits,
            sigma2_of(x_logits),
            sigma2_of(y_logits),
        )

    def patch_scores(
        self, source: Encoding[Tensor], target: Encoding[Tensor], pairs: Tensor
    ) -> Tensor:
        """Optimal transport between the fine points of superpoint pairs (differentiable).

        Args:
            source: encoding of the source.
            target: encoding of the target.
            pairs: (P, 2) int64 rows (source superpoint, target superpoint).

        Returns:
            (P, K + 1, K + 1) log-probabilities, rows source, columns target; the last row and
            column are the dustbins; padded entries are `MASKED`.
        """
        patches, masks = [], []
        for side, rows in ((source, pairs[:, 0]), (target, pairs[:, 1])):
            features = functional.pad(side.fine_features, (0, 0, 0, 1))  # of no point: zeros
            patches.append(features[tensor_of(side.pyramid.patch_index, pairs)[rows]])
            masks.append(tensor_of(side.pyramid.patch_mask, pairs)[rows])
        scores = torch.bmm(patches[0], patches[1].transpose(1, 2)) / self.config.fine_dim**0.5
        found: Tensor = self.transport(scores, *masks)
        return found
