# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
import torch

from hybridreg_ros.data.hybridmatch.room_pairs import make_pairs
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.model.register import HybridReg
from hybridreg_ros.training import optim
from hybridreg_ros.training.config import LossConfig, TrainConfig
from hybridreg_ros.training.samples import prepare
from hybridreg_ros.training.step import pair_losses
from hybridreg_ros.training.validation import HeldOut, pair_score


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_one_moving_pair_is_overfitted_within_150_steps():
    pair = None
    for seed in range(20):
        pair = pair or next(iter(make_pairs('room-match-10-30', seed, 1)), None)
    assert pair is not None
    config, steps = TrainConfig(warmup=0.05), 150
    model = ModelConfig.profile('compact')
    torch.manual_seed(0)
    network = HybridRegNet(model)
    optimizer = optim.Optimizer(network, config)
    totals = []
    for step in range(steps):
        sample = prepare(pair, model, LossConfig(), np.random.default_rng(step))
        terms = pair_losses(network.train(), sample, LossConfig())
        terms.total.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), config.clip)
        optimizer.step(optim.lr_factor(step / steps, config))
        totals.append(float(terms.total.detach()))
    score = pair_score(HybridReg(model, network), HeldOut.of(sample))
    assert totals[-1] < 0.6 * totals[0]
    assert score.coarse_right
    assert score.right
    assert score.coarse_rmse_m < 0.05
    assert score.inlier_ratio > 0.5
    assert score.mask_auc > 0.95
