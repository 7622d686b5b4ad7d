# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import copy
import itertools
import math

import pytest
import torch
from torch import nn

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.training import optim
from hybridreg_ros.training.config import TrainConfig


def test_schedule_warms_up_then_falls():
    config = TrainConfig(steps=1000, warmup=0.1, final_lr=0.05)
    factors = [optim.lr_factor(optim.progress(s, 0.0, config), config) for s in range(1001)]
    assert factors[0] == pytest.approx(0.01)
    assert factors[50] == pytest.approx(0.5)
    assert factors[100] == pytest.approx(1.0)
    assert factors[550] == pytest.approx(0.05 + 0.95 * 0.5)
    assert factors[1000] == pytest.approx(0.05)
    assert all(b <= a for a, b in itertools.pairwise(factors[100:]))


def test_time_ends_a_run_before_its_steps_do():
    config = TrainConfig(steps=1000, max_hours=2.0)
    assert optim.progress(10, 1.0, config) == pytest.approx(0.5)
    assert optim.progress(900, 1.0, config) == pytest.approx(0.9)
    assert optim.progress(10, 3.0, config) == 1.0
    assert optim.progress(10, 1e9, TrainConfig(steps=1000)) == pytest.approx(0.01)


def test_average_follows_the_weights():
    model = nn.Linear(2, 1)
    average = optim.Average(model, 0.9)
    nn.init.constant_(model.weight, 1.0)
    for step in range(1, 200):
        average.update(step)
    assert average.weights['weight'].tolist() == [[pytest.approx(1.0, abs=1e-4)] * 2]
    exact = optim.Average(model, 0.0)
    nn.init.constant_(model.weight, 3.0)
    exact.update(1)
    assert exact.weights['weight'].tolist() == [[3.0, 3.0]]


def test_optimizer_descends_and_resumes_exactly():
    def run(model, optimizer, steps):
        for i in range(steps):
            x = torch.randn(8, 6, generator=torch.Generator().manual_seed(i))
            loss = (model(x) - x.sum(1, keepdim=True)).square().mean()
            loss.backward()
            optimizer.step(1.0)
        return loss.item()

    config = TrainConfig(lr=1e-2)
    torch.manual_seed(0)
    model = nn.Sequential(nn.Linear(6, 16), nn.Tanh(), nn.Linear(16, 1))
    optimizer = optim.Optimizer(model, config)
    first = run(model, optimizer, 1)
    weights = {k: v.clone() for k, v in model.state_dict().items()}
    state = optimizer.state_dict()
    state = copy.deepcopy(state)
    last = run(model, optimizer, 60)
    assert last < 0.5 * first
    other = nn.Sequential(nn.Linear(6, 16), nn.Tanh(), nn.Linear(16, 1))
    other.load_state_dict(weights)
    again = optim.Optimizer(other, config)
    again.load_state_dict(state)
    assert run(other, again, 60) == last


def test_no_decay_on_biases_and_norms():
    model = nn.Sequential(nn.Linear(3, 3), nn.LayerNorm(3))
    optimizer = optim.Optimizer(model, TrainConfig(weight_decay=0.5, lr=0.1))
    for p in model.parameters():
        p.grad = torch.zeros_like(p)
    before = {k: v.clone() for k, v in model.state_dict().items()}
    optimizer.step(1.0)
    after = model.state_dict()
    assert torch.equal(after['1.weight'], before['1.weight'])
    assert torch.equal(after['0.bias'], before['0.bias'])
    assert not torch.equal(after['0.weight'], before['0.weight'])


def test_single_process_needs_no_group(monkeypatch):
    monkeypatch.delenv('WORLD_SIZE', raising=False)
    assert optim.start_processes('cpu') == (0, 1)
    assert optim.agreed(0.25, 1) == 0.25
    p = nn.Parameter(torch.ones(2))
    optim.average_gradients([p], 1)
    assert p.grad is None


def test_config_refuses_reserved_seeds_and_nonsense():
    with pytest.raises(ConfigError, match='seed: expected <= 8'):
        TrainConfig(seed=9_000_000)
    with pytest.raises(ConfigError, match='precision: expected one of float32, bf16'):
        TrainConfig(precision='int8')
    assert math.isfinite(TrainConfig().lr)
