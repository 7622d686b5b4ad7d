# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The training loop: sample, step, log, validate, checkpoint; it can be killed at any moment."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import json
import logging
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import nn

from hybridreg_ros.core.config import dump_yaml, to_dict
from hybridreg_ros.core.errors import WeightsError
from hybridreg_ros.model.checkpoint import load_checkpoint, save_network
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.training import optim
from hybridreg_ros.training.generator import Generator
from hybridreg_ros.training.samples import SampleStream, loader, to_device
from hybridreg_ros.training.sources import ShardSource
from hybridreg_ros.training.step import LossTerms, pair_losses
from hybridreg_ros.training.validation import Validation, ValidationSet

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hybridreg_ros.training.config import TrainConfig
    from hybridreg_ros.training.samples import Sample

_LOG = logging.getLogger(__name__)
VERSION = 1


@dataclass
class Progress:
    """Where a run stands.

    Attributes:
        step: optimiser steps done.
        hours: wall-clock hours used so far, over all restarts.
        best: best validation RR so far; -1 before the first validation.
        best_step: step of that validation.
    """

    step: int = 0
    hours: float = 0.0
    best: float = -1.0
    best_step: int = 0


def train(config: TrainConfig) -> Progress:
    """Run, or continue, the training that a config describes; returns where it stands at the end.

    In `config.out`: `config.yaml`, `log.csv`, `validation.csv`, `state.pt` (to resume),
    `last.safetensors` and `best.safetensors` (averaged weights; each can start a new run alone),
    and `stream/`, the pairs that wait to be used, if the config asks for a stream.

    Raises:
        HybridRegError: bad data folders, weights or configuration.
    """
    rank, world = optim.start_processes(config.device)
    with _one_flushing_thread(config.device):
        run = Run(config, rank, world)
        run.resume()
        with run.generating():
            run.loop()
        return run.progress


@contextlib.contextmanager
def _one_flushing_thread(device: str) -> Iterator[None]:
    """On the CPU: one thread, and numbers below 1e-38 count as zero as long as this lasts.

    A trained attention is sharp: otherwise a third of the backward pass is spent on products with
    probabilities below 1e-38, which are slow.
    """
    if device == 'cpu':
        torch.set_num_threads(1)
        torch.set_flush_denormal(True)
    try:
        yield
    finally:
        if device == 'cpu':
            torch.set_flush_denormal(False)


class Run:
    """Network, optimiser and files of one run; `loop` is the training."""

    def __init__(self, config: TrainConfig, rank: int = 0, world: int = 1) -> None:
        self.config, self.rank, self.world = config, rank, world
        self.out = Path(config.out)
        if not config.stream.kinds:
            ShardSource(
                config.data, config.shares
            )  # what it lacks is said before anything is made
        torch.manual_seed(config.seed)
        self.network = _network(config).to(config.device)
        self.optimizer = optim.Optimizer(self.network, config)
        self.average = optim.Average(self.network, config.ema)
        self.progress = Progress()
        self.validation = ValidationSet(config, self.network.config, rank, world)
        self.out.mkdir(parents=True, exist_ok=True)
        if rank == 0:
            (self.out / 'config.yaml').write_text(dump_yaml(config), encoding='utf-8')

    @contextlib.contextmanager
    def generating(self) -> Iterator[None]:
        """A generating process beside this one, if the config asks for a stream of pairs."""
        if self.rank or not self.config.stream.kinds:
            yield
            return
        generator = Generator(self.out / 'stream', self.config.stream)
        try:
            yield
        finally:
            generator.stop()

    def loop(self) -> None:
        """Train until the schedule ends."""
        c, p = self.config, self.progress
        stream = SampleStream(
            c, self.network.config, start=p.step * c.accumulate, rank=self.rank, world=self.world
        )
        samples = loader(stream, c.workers)
        log = Log(self.out / 'log.csv', self.rank == 0)
        began, base = time.monotonic(), p.hours
        saved = began
        while True:
            p.hours = base + (time.monotonic() - began) / 3600.0
            done = optim.agreed(optim.progress(p.step, p.hours, c), self.world)
            if done >= 1.0:
                break
            self.step(samples, optim.lr_factor(done, c), log)
            if p.step % c.log_every == 0:
                log.write(p, optim.lr_factor(done, c))
            if p.step % c.validate_every == 0:
                self.validate()
            if time.monotonic() - saved > 60.0 * c.checkpoint_minutes:
                self.save()
                saved = time.monotonic()
        if p.step % c.validate_every:
            self.validate()
        self.save()

    def step(self, samples: Iterator[Sample], factor: float, log: Log) -> None:
        """One optimiser step."""
        self.network.train()
        c = self.config
        for _ in range(c.accumulate):
            began = time.monotonic()
            sample = to_device(next(samples), c.device)
            waited = time.monotonic() - began
            terms = pair_losses(self.network, sample, c.loss, c.precision)
            torch.autograd.backward(terms.total / c.accumulate)
            log.add(terms, waited)
        parameters = list(self.network.parameters())
        optim.average_gradients(parameters, self.world)
        norm = nn.utils.clip_grad_norm_(parameters, c.clip or math.inf)
        if bool(torch.isfinite(norm)):
            self.optimizer.step(factor)
        else:
            _LOG.warning('step %d: gradient is not finite, step skipped', self.progress.step)
            self.network.zero_grad(set_to_none=True)
        self.progress.step += 1
        self.average.update(self.progress.step)

    def validate(self) -> Validation:
        """Score the averaged weights on the validation pairs; keep them if they are the best."""
        live = {k: v.clone() for k, v in self.network.state_dict().items()}
        self.network.load_state_dict(self.average.weights)
        result = self.validation.score(self.network)
        p = self.progress
        if self.rank == 0:
            _append(self.out / 'validation.csv', {'step': p.step, 'hours': p.hours} | result.row())
        if result.selection > p.best:
            p.best, p.best_step = result.selection, p.step
            if self.rank == 0:
                self._write_weights('best.safetensors', result.row())
        self.network.load_state_dict(live)
        _LOG.info('step %d: %s', p.step, result.row())
        return result

    def save(self) -> None:
        """Write the resume state and the averaged weights, each atomically."""
        if self.rank:
            return
        state = {
            'version': VERSION,
            'progress': dataclasses.asdict(self.progress),
            'network': self.network.state_dict(),
            'average': self.average.weights,
            'optimizer': self.optimizer.state_dict(),
        }
        _replace(self.out / 'state.pt', lambda path: torch.save(state, path))
        live = {k: v.clone() for k, v in self.network.state_dict().items()}
        self.network.load_state_dict(self.average.weights)
        self._write_weights('last.safetensors', {})
        self.network.load_state_dict(live)

    def resume(self) -> bool:
        """Continue from `state.pt` when it is there; True if so.

        Raises:
            WeightsError: the state does not fit this configuration.
        """
        path = self.out / 'state.pt'
        if not path.exists():
            return False
        try:
            state = torch.load(path, map_location=self.config.device, weights_only=True)
            self.network.load_state_dict(state['network'])
            self.average.load(state['average'])
            self.optimizer.load_state_dict(state['optimizer'])
        except (RuntimeError, KeyError, ValueError) as error:
            first = str(error).split('\n')[0]
            raise WeightsError(
                f'{path} does not fit this configuration ({first}): use another out folder'
            ) from None
        self.progress = Progress(**state['progress'])
        _LOG.info('continuing %s at step %d', self.out, self.progress.step)
        return True

    def _write_weights(self, name: str, scores: dict[str, Any]) -> None:
        about = {
            'train_config': json.dumps(to_dict(self.config)),
            'progress': json.dumps(dataclasses.asdict(self.progress)),
            'validation': json.dumps(scores),
        }
        _replace(self.out / name, lambda path: save_network(path, self.network, about))


def _network(config: TrainConfig) -> HybridRegNet:
    """A fresh network of the profile, or one with given weights."""
    if config.start_weights:
        return load_checkpoint(config.start_weights).network
    return HybridRegNet(ModelConfig.profile(config.profile))


def _replace(path: Path, write: Any) -> None:
    """Write beside and rename, so that a kill leaves the old file or the new one."""
    beside = path.with_name('.' + path.name)
    write(beside)
    beside.replace(path)


class Log:
    """Means of the loss terms since the last line, appended to log.csv."""

    def __init__(self, path: Path, active: bool) -> None:
        self._path, self._active = path, active
        self._sums: dict[str, float] = {}
        self._count = 0
        self._began = time.monotonic()

    def add(self, terms: LossTerms, waited_s: float) -> None:
        """Take in one pair."""
        values = {k: float(v.detach()) for k, v in terms._asdict().items()}
        for key, value in (values | {'wait_s': waited_s}).items():
            self._sums[key] = self._sums.get(key, 0.0) + value
        self._count += 1

    def write(self, progress: Progress, factor: float) -> None:
        """Append one line and start over."""
        now = time.monotonic()
        means = {k: v / max(self._count, 1) for k, v in self._sums.items()}
        means['pair_s'] = (now - self._began) / max(self._count, 1)
        self._sums, self._count, self._began = {}, 0, now
        if self._active:
            row = {'step': progress.step, 'hours': progress.hours, 'lr_factor': factor}
            _append(self._path, row | means)


def _append(path: Path, row: dict[str, Any]) -> None:
    """One CSV line; the header when the file is new."""
    new = not path.exists()
    with path.open('a', newline='', encoding='utf-8') as stream:
        writer = csv.writer(stream)
        if new:
            writer.writerow(row)
        writer.writerow(f'{v:.6g}' if isinstance(v, float) else v for v in row.values())
