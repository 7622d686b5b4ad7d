# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""HybridRegNet: encode a cloud once, then correlate encodings; and the same on arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import nn
from torch.nn import functional

from hybridreg_ros.model.network.forward import CompiledNetwork, has_compiled_form
from hybridreg_ros.model.network.output import Encoding, SuperpointOutput, check_voxels
from hybridreg_ros.model.network.packed import packed
from hybridreg_ros.model.reference.attention import CrossLayer, GeometryTable, SelfLayer
from hybridreg_ros.model.reference.backbone import Backbone
from hybridreg_ros.model.reference.fused import tensor_of
from hybridreg_ros.model.reference.static_head import StaticHead
from hybridreg_ros.model.reference.transport import Transport
from hybridreg_ros.model.reference.uncertainty import MaskHead, sigma2_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.model.geometry.pyramid import Pyramid
    from hybridreg_ros.model.network.output import Network

    F32 = NDArray[np.float32]
    Tensor = torch.Tensor


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
        """Its weights of now compiled; the network itself where that cannot be."""
        if has_compiled_form(self.config) and self.project.weight.device.type == 'cpu':
            return CompiledNetwork(self.config, packed(self.config, self.parameters_by_name()))
        return ReferenceNetwork(self)

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
            own, cross = self.self_layers[i], self.cross_layers[i]
            assert isinstance(own, SelfLayer)
            assert isinstance(cross, CrossLayer)
            if i:
                x, y = own.both(x, y, table, gx, gy)
            before = x, y
            x, y = cross.both(x, y)
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
        x, y = (
            _rows(side.fine_features, tensor_of(side.pyramid.patch_index, pairs)[column])
            for side, column in ((source, pairs[:, 0]), (target, pairs[:, 1]))
        )
        masks = (
            tensor_of(side.pyramid.patch_mask, pairs)[column]
            for side, column in ((source, pairs[:, 0]), (target, pairs[:, 1]))
        )
        scores = torch.bmm(x, y.transpose(1, 2)) / self.config.fine_dim**0.5
        found: Tensor = self.transport(scores, *masks)
        return found


def _rows(features: Tensor, index: Tensor) -> Tensor:
    """Rows of features (N, C) at index (P, K); index N gives zeros."""
    padded = torch.cat([features, features.new_zeros(1, features.shape[1])])
    return padded[index]


class ReferenceNetwork:
    """A `Network` of arrays that torch computes, on the device of its weights."""

    def __init__(self, network: HybridRegNet) -> None:
        self._network = network.eval()
        self.dustbin = float(network.transport.dustbin.detach())

    def encode(self, pyramid: Pyramid) -> Encoding[F32]:
        """One cloud; what it keeps needs no operators."""
        with torch.inference_mode():
            found = self._network.encode(pyramid)
        features = found.fine_features, found.superpoint_features
        return Encoding(pyramid.encoded, *(_array(x) for x in features))

    def correlate(self, source: Encoding[F32], target: Encoding[F32]) -> SuperpointOutput[F32]:
        """Two clouds.

        Raises:
            RegistrationError: the encodings were made with different voxel sizes.
        """
        with torch.inference_mode():
            sides = (
                Encoding(
                    e.pyramid, *(self._tensor(x) for x in (e.fine_features, e.superpoint_features))
                )
                for e in (source, target)
            )
            found = self._network.correlate(*sides)
        return SuperpointOutput(*(_array(x) for x in vars(found).values()))

    def static_logits(self, looks: F32, fine: F32, owners: Sequence[NDArray[np.int64]]) -> F32:
        """What the static head says of every point."""
        head = self._network.static
        assert head is not None, 'these weights have no static head'
        with torch.inference_mode():
            inputs = self._tensor(looks), self._tensor(fine), [self._tensor(o) for o in owners]
            return _array(head(*inputs))

    def _tensor(self, values: NDArray[Any]) -> Tensor:
        return tensor_of(values, self._network.project.weight)


def _array(values: Tensor) -> F32:
    found: F32 = values.cpu().numpy()
    return found
