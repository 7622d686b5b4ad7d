# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
import torch
from conftest_training import TINY, make_pair

from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.training.config import LossConfig
from hybridreg_ros.training.samples import prepare
from hybridreg_ros.training.step import pair_losses


def test_bf16_gives_about_the_same_losses_and_gradients():
    torch.manual_seed(0)
    network = HybridRegNet(TINY).train()
    config = LossConfig(descriptor_weight=1.0, false_match_weight=1.0)
    sample = prepare(make_pair(0), TINY, config, np.random.default_rng(0))
    found = {}
    for precision in ('float32', 'bf16'):
        network.zero_grad()
        terms = pair_losses(network, sample, config, precision)
        torch.autograd.backward(terms.total)
        gradient = torch.cat(
            [p.grad.flatten() for p in network.parameters() if p.grad is not None]
        )
        assert gradient.dtype == torch.float32
        found[precision] = torch.stack(terms).detach().numpy(), gradient
    assert found['bf16'][0] == pytest.approx(found['float32'][0], rel=0.02)
    alike = torch.cosine_similarity(found['bf16'][1], found['float32'][1], dim=0)
    assert float(alike) > 0.98
    assert not torch.equal(found['bf16'][1], found['float32'][1])
