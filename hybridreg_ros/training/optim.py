# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Optimiser, schedule, averaged weights and gradient averaging over processes."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any

import torch
import torch.distributed as dist
from torch import Tensor, nn

if TYPE_CHECKING:
    from collections.abc import Iterable

    from hybridreg_ros.training.config import TrainConfig


class Optimizer:
    """AdamW, without decay for vectors; one learning-rate factor."""

    def __init__(self, model: nn.Module, config: TrainConfig) -> None:
        own = [p for p in model.parameters() if p.requires_grad]
        groups = [
            {'params': [p for p in own if p.ndim >= 2], 'weight_decay': config.weight_decay},
            {'params': [p for p in own if p.ndim < 2], 'weight_decay': 0.0},
        ]
        groups = [g for g in groups if g['params']]
        self._lr = config.lr
        self._adamw = torch.optim.AdamW(groups, lr=config.lr, fused=True)

    def step(self, factor: float) -> None:
        """One update with the learning rate scaled by `factor`; gradients are cleared."""
        for group in self._adamw.param_groups:
            group['lr'] = self._lr * factor
        self._adamw.step()
        self._adamw.zero_grad(set_to_none=True)

    def state_dict(self) -> list[dict[str, Any]]:
        """Its state, the only one of the list."""
        return [self._adamw.state_dict()]

    def load_state_dict(self, states: list[dict[str, Any]]) -> None:
        """Inverse of `state_dict`."""
        (state,) = states
        self._adamw.load_state_dict(state)


class Average:
    """Exponential moving average of the weights of a model; `decay` 0 follows them exactly."""

    def __init__(self, model: nn.Module, decay: float) -> None:
        self._decay = decay
        self._live = model.state_dict()
        self.weights = {k: v.detach().clone() for k, v in self._live.items()}

    def update(self, step: int) -> None:
        """Take in the weights after optimiser step `step` (early steps are forgotten faster)."""
        decay = min(self._decay, (1.0 + step) / (10.0 + step)) if self._decay > 0.0 else 0.0
        floating = [k for k, v in self._live.items() if v.is_floating_point()]
        with torch.no_grad():
            torch._foreach_lerp_(
                [self.weights[k] for k in floating], [self._live[k] for k in floating], 1.0 - decay
            )
            for name in self._live.keys() - set(floating):
                self.weights[name].copy_(self._live[name])

    def load(self, weights: dict[str, Tensor]) -> None:
        """Continue from saved averages."""
        for name, mean in self.weights.items():
            mean.copy_(weights[name])


def progress(step: int, hours: float, config: TrainConfig) -> float:
    """Share of the run done, [0, 1]: the larger of the step share and the time share."""
    by_time = hours / config.max_hours if config.max_hours > 0.0 else 0.0
    return min(1.0, max(step / config.steps, by_time))


def lr_factor(done: float, config: TrainConfig) -> float:
    """Learning-rate factor: linear warm-up, then cosine down to `final_lr`."""
    if done < config.warmup:
        return max(done / config.warmup, 1e-2)
    angle = math.pi * (done - config.warmup) / (1.0 - config.warmup)
    return config.final_lr + (1.0 - config.final_lr) * 0.5 * (1.0 + math.cos(angle))


def start_processes(device: str) -> tuple[int, int]:
    """Join the process group when torchrun started several processes.

    Returns:
        (rank, world size); (0, 1) for a single process.
    """
    world = int(os.environ.get('WORLD_SIZE', '1'))
    if world > 1 and not dist.is_initialized():
        dist.init_process_group('nccl' if device.startswith('cuda') else 'gloo')
    return (dist.get_rank(), world) if world > 1 else (0, 1)


def average_gradients(parameters: Iterable[nn.Parameter], world: int) -> None:
    """Replace every gradient by its mean over the processes (one flat all-reduce)."""
    if world == 1:
        return
    owned = [p for p in parameters if p.requires_grad]
    for p in owned:
        if p.grad is None:
            p.grad = torch.zeros_like(p)
    flat = torch.cat([p.grad.flatten() for p in owned if p.grad is not None])
    dist.all_reduce(flat)
    flat /= world
    offset = 0
    for p in owned:
        assert p.grad is not None
        p.grad.copy_(flat[offset : offset + p.numel()].view_as(p))
        offset += p.numel()


def agreed(value: float, world: int) -> float:
    """A number as rank 0 knows it."""
    if world == 1:
        return value
    tensor = torch.tensor([value], dtype=torch.float64)
    if dist.get_backend() == 'nccl':
        tensor = tensor.cuda()
    dist.broadcast(tensor, src=0)
    return float(tensor.item())
