# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import csv
import dataclasses
import os
import socket
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import torch

from hybridreg_ros.core.config import load_yaml
from hybridreg_ros.core.errors import WeightsError
from hybridreg_ros.model.checkpoint import load_checkpoint
from hybridreg_ros.training.config import TrainConfig
from hybridreg_ros.training.loop import Run, train


def state_of(config):
    return torch.load(f'{config.out}/state.pt', weights_only=True)


def assert_same(a, b, tolerance=0.0):
    assert a.keys() == b.keys()
    for key in a:
        torch.testing.assert_close(a[key], b[key], atol=tolerance, rtol=0.0)


def test_five_steps_leave_all_files(tiny_run):
    config = tiny_run()
    progress = train(config)
    assert progress.step == 5
    assert progress.best_step == 5
    out = config.out
    assert load_yaml(TrainConfig, f'{out}/config.yaml') == config
    with open(f'{out}/log.csv', encoding='utf-8') as stream:
        rows = list(csv.DictReader(stream))
    assert [int(r['step']) for r in rows] == [2, 4]
    assert all(float(r['total']) > 0 for r in rows)
    with open(f'{out}/validation.csv', encoding='utf-8') as stream:
        (row,) = csv.DictReader(stream)
    assert int(row['pairs']) == 2
    assert 0.0 <= float(row['RR']) <= 1.0
    for name in ('best', 'last'):
        checkpoint = load_checkpoint(f'{out}/{name}.safetensors')
        assert_same(checkpoint.network.state_dict(), state_of(config)['average'])
        assert 'train_config' in checkpoint.provenance
    assert not [f for f in os.listdir(out) if f.startswith('.')]


def test_small_numbers_are_flushed_during_training_alone(tiny_run, monkeypatch):
    seen = []
    step = Run.step

    def watched(*arguments):
        seen.append(_tiny_product())
        step(*arguments)

    monkeypatch.setattr(Run, 'step', watched)
    train(tiny_run())
    assert seen == [0.0] * 5
    assert _tiny_product() > 0.0


def _tiny_product() -> float:
    """1e-30 times 1e-10, which float32 can only hold as a denormal."""
    return float(torch.tensor(1e-30) * torch.tensor(1e-10))


def test_weights_move_and_the_average_lags_behind(tiny_run, tiny_weights):
    config = tiny_run(ema=0.9)
    train(config)
    state, start = state_of(config), load_checkpoint(tiny_weights).network.state_dict()
    name = 'output.weight'
    moved = (state['network'][name] - start[name]).norm()
    lag = (state['average'][name] - start[name]).norm()
    assert 0 < lag < moved


def test_killed_and_resumed_equals_undisturbed(tiny_run, monkeypatch):
    whole = tiny_run('whole', steps=6, validate_every=100)
    train(whole)
    broken = tiny_run('broken', steps=6, validate_every=100)
    run = Run(broken)
    run.config = dataclasses.replace(broken, checkpoint_minutes=0.0)

    class KilledError(RuntimeError):
        pass

    step = run.step

    def step_until_killed(*arguments):
        if run.progress.step == 4:
            raise KilledError
        step(*arguments)

    monkeypatch.setattr(run, 'step', step_until_killed)
    with pytest.raises(KilledError):
        run.loop()
    assert state_of(broken)['progress']['step'] == 4
    train(broken)
    assert_same(state_of(broken)['network'], state_of(whole)['network'])
    assert_same(state_of(broken)['average'], state_of(whole)['average'])


def test_restart_from_weights_alone(tiny_run):
    first = tiny_run('first')
    train(first)
    again = tiny_run('again', start_weights=f'{first.out}/last.safetensors', steps=1)
    run = Run(again)
    assert_same(run.network.state_dict(), state_of(first)['average'])
    assert run.progress.step == 0
    assert not run.resume()


def test_two_pairs_accumulated_equal_the_mean_gradient(tiny_run, monkeypatch):
    config = tiny_run(accumulate=2, steps=1)
    run = Run(config)
    gradients: dict[str, Any] = {}

    def keep(factor):
        for name, parameter in run.network.named_parameters():
            assert parameter.grad is not None
            gradients[name] = parameter.grad.clone()

    monkeypatch.setattr(run.optimizer, 'step', keep)
    run.loop()
    from hybridreg_ros.training.samples import SampleStream
    from hybridreg_ros.training.step import pair_losses

    network = load_checkpoint(config.start_weights).network.train()
    stream = iter(SampleStream(config, network.config))
    for _ in range(2):
        (0.5 * pair_losses(network, next(stream), config.loss).total).backward()
    torch.nn.utils.clip_grad_norm_(network.parameters(), config.clip)
    assert_same(gradients, {n: p.grad for n, p in network.named_parameters()}, 1e-6)


def test_a_gradient_that_is_not_finite_is_skipped(tiny_run, monkeypatch):
    config = tiny_run(steps=2, validate_every=100)
    run = Run(config)
    before = {k: v.clone() for k, v in run.network.state_dict().items()}
    from hybridreg_ros.training import loop, step

    def broken(*args):
        terms = real(*args)
        return terms._replace(total=terms.total * float('nan'))

    real = step.pair_losses
    monkeypatch.setattr(loop, 'pair_losses', broken)
    run.loop()
    assert run.progress.step == 2
    assert_same(run.network.state_dict(), before)


def test_a_foreign_state_is_refused(tiny_run):
    config = tiny_run()
    os.makedirs(config.out)
    torch.save({'network': {}}, f'{config.out}/state.pt')
    with pytest.raises(WeightsError, match='does not fit this configuration'):
        train(config)


def test_time_limit_ends_the_run(tiny_run):
    config = tiny_run(steps=100_000, max_hours=3.0 / 3600.0, validate_every=1_000_000)
    progress = train(config)
    assert 0 < progress.step < 1000
    assert progress.hours == pytest.approx(3.0 / 3600.0, rel=0.7)


@pytest.mark.parametrize('mask', ['none', 'bce', 'l1', 'nll', 'log_sum_exp'])
@pytest.mark.parametrize('coarse', ['cross_entropy', 'circle', 'both'])
def test_every_loss_trains_with_finite_gradients(tiny_run, monkeypatch, mask, coarse):
    base = tiny_run()
    loss = dataclasses.replace(base.loss, mask=mask, coarse=coarse)
    run = Run(dataclasses.replace(base, loss=loss, steps=1, validate_every=100))
    norms: list[float] = []
    real = run.optimizer.step

    def keep(factor):
        norms.extend(float(p.grad.norm()) for p in run.network.parameters() if p.grad is not None)
        real(factor)

    monkeypatch.setattr(run.optimizer, 'step', keep)
    run.loop()
    assert np.isfinite(norms).all()
    assert sum(n > 0 for n in norms) > 20


@pytest.mark.slow
def test_two_processes_equal_one_with_two_pairs(tiny_run, tmp_path):
    one = tiny_run('one', accumulate=2, steps=3, validate_every=3)
    train(one)
    two = tiny_run('two', accumulate=1, steps=3, validate_every=3)
    os.makedirs(two.out)
    from hybridreg_ros.core.config import dump_yaml

    (tmp_path / 'two.yaml').write_text(dump_yaml(two))
    script = tmp_path / 'go.py'
    script.write_text(
        'import sys\n'
        'from hybridreg_ros.core.config import load_yaml\n'
        'from hybridreg_ros.training.config import TrainConfig\n'
        'from hybridreg_ros.training.loop import train\n'
        'train(load_yaml(TrainConfig, sys.argv[1]))\n'
    )
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        port = free.getsockname()[1]
    environment = os.environ | {
        'OMP_NUM_THREADS': '1',
        'MASTER_ADDR': '127.0.0.1',
        'MASTER_PORT': str(port),
        'WORLD_SIZE': '2',
    }
    ranks = [
        subprocess.Popen(
            [sys.executable, str(script), str(tmp_path / 'two.yaml')],
            env=environment | {'RANK': str(rank), 'LOCAL_RANK': str(rank)},
        )
        for rank in range(2)
    ]
    assert [r.wait(timeout=240) for r in ranks] == [0, 0]
    assert_same(state_of(two)['network'], state_of(one)['network'], 1e-5)
    with open(f'{two.out}/validation.csv', encoding='utf-8') as stream:
        assert int(next(csv.DictReader(stream))['pairs']) == 2
