# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Small clouds and networks for the tests of the model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch

from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.network.forward import Network
from hybridreg_ros.model.network.output import Encoding, SuperpointOutput
from hybridreg_ros.model.network.packed import packed
from hybridreg_ros.model.reference.network import HybridRegNet

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.model.geometry.pyramid import Pyramid

    F32 = NDArray[np.float32]


def _as_tensors(e: Encoding[F32]) -> Encoding[torch.Tensor]:
    features = e.fine_features, e.superpoint_features
    return Encoding(e.pyramid, *(torch.from_numpy(x) for x in features))


class ByTorch(Network):
    """The network in use, computed by the torch modules that it stands for."""

    def __init__(self, net: HybridRegNet) -> None:
        super().__init__(net.config, packed(net.config, net.parameters_by_name()))
        self.net = net

    def encode(self, pyramid: Pyramid) -> Encoding[F32]:
        with torch.no_grad():
            found = self.net.encode(pyramid)
        return Encoding(pyramid, found.fine_features.numpy(), found.superpoint_features.numpy())

    def correlate(self, source: Encoding[F32], target: Encoding[F32]) -> SuperpointOutput[F32]:
        with torch.no_grad():
            found = self.net.correlate(*(_as_tensors(e) for e in (source, target)))
        return SuperpointOutput(*(x.numpy() for x in vars(found).values()))

    def static_logits(self, looks: F32, fine: F32, owners: Sequence[NDArray[np.int64]]) -> F32:
        head = self.net.static
        assert head is not None
        x, y, *z = (torch.from_numpy(a) for a in (looks, fine, *owners))
        with torch.no_grad():
            found: F32 = head(x, y, z).numpy()
        return found


@pytest.fixture
def by_torch() -> type[ByTorch]:
    return ByTorch


def make_room(rng: np.random.Generator, count: int = 6000) -> NDArray[np.float32]:
    """Points (N, 3) on a floor, two walls and a few boxes, metres."""
    third = count // 6
    floor = np.c_[rng.uniform(0, 4, (third, 2)), np.zeros(third)]
    wall_a = np.c_[rng.uniform(0, 4, third), np.zeros(third), rng.uniform(0, 2, third)]
    wall_b = np.c_[np.zeros(third), rng.uniform(0, 4, third), rng.uniform(0, 2, third)]
    parts = [floor, wall_a, wall_b]
    for centre in ([1.0, 2.0, 0.3], [2.5, 1.0, 0.5], [3.0, 3.0, 0.2]):
        box = rng.uniform(-0.5, 0.5, (third, 3))
        axis = rng.integers(0, 3, third)
        box[np.arange(third), axis] = np.where(rng.random(third) < 0.5, -0.5, 0.5)
        parts.append(box * np.array([0.8, 0.6, 2.0 * centre[2]]) + centre)
    return np.concatenate(parts).astype(np.float32)


@pytest.fixture
def room(rng: np.random.Generator) -> NDArray[np.float32]:
    """A furnished corner of 4 m, about 6,000 points."""
    return make_room(rng)


@pytest.fixture(scope='session')
def compact_net() -> HybridRegNet:
    """The compact network with fixed random weights."""
    torch.manual_seed(3)
    return HybridRegNet(ModelConfig()).eval()
