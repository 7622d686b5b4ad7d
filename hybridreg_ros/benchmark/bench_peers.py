# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg bench --peers`: register() and methods without a network, turn by turn."""

from __future__ import annotations

import statistics
import time
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.pages import peak_mb
from hybridreg_ros.core.progress import progress
from hybridreg_ros.replay.page.tables import text_table

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hybridreg_ros.model.register import HybridReg

    Cloud = NDArray[np.float32]


def run(args: argparse.Namespace, source: Cloud, target: Cloud) -> tuple[str, dict[str, Any]]:
    """Measure in turns, so that a busy machine is busy for all; text to print, and figures."""
    before_mb = peak_mb()
    from hybridreg_ros.model.geometry.voxel_size import choose_voxel_size_m
    from hybridreg_ros.model.register import HybridReg

    model = HybridReg.from_pretrained(args.weights)
    result = model.register(source, target)
    memory_mb = peak_mb() - before_mb
    peers_m = choose_voxel_size_m(source, target)
    methods = _methods(model, source, target, peers_m)
    wall: dict[str, list[float]] = {name: [] for name in methods}
    cpu: dict[str, list[float]] = {name: [] for name in methods}
    for once in methods.values():
        once()
    for _ in progress(range(args.repeat), args.repeat, 'bench', 'round'):
        for name, once in methods.items():
            began, used = time.perf_counter(), time.process_time()
            once()
            wall[name].append(time.perf_counter() - began)
            cpu[name].append(time.process_time() - used)
    ours = wall['register']
    ratio = {
        name: statistics.median(a / b for a, b in zip(ours, wall[name], strict=True))
        for name in methods
    }
    rows = [['method', 'median ms', 'fastest ms', 'CPU ms', 'register() takes']]
    rows += [
        [
            name,
            *(f'{1000 * x:.0f}' for x in (statistics.median(wall[name]), min(wall[name]))),
            f'{1000 * statistics.median(cpu[name]):.0f}',
            f'{ratio[name]:.2f} x',
        ]
        for name in methods
    ]
    text = (
        f'{len(source)} + {len(target)} points, voxel {result.voxel_size_m:g} m, '
        f'of the others {peers_m:g} m\n{text_table(rows)}\n'
        f'memory of one registration: {memory_mb:.0f} MB over what the command holds before'
    )
    return text, (
        {
            'points': [len(source), len(target)],
            'voxel_m': {'register': result.voxel_size_m, 'others': peers_m},
            'wall_s': wall,
            'cpu_s': cpu,
            'ratio': ratio,
            'memory_mb': memory_mb,
            'threads': args.threads,
        }
    )


def _methods(
    model: HybridReg, source: Cloud, target: Cloud, voxel_size_m: float
) -> dict[str, Callable[[], object]]:
    """What is measured; every one starts from the bare clouds."""
    from hybridreg_ros.training.baselines import METHODS
    from hybridreg_ros.training.evaluate import static_pair

    pair = static_pair(source, target, np.eye(4), 1.0, 'bench', voxel_size_m)
    return {
        'register': lambda: model.register(source, target),
        **{name: partial(method, pair) for name, method in METHODS.items()},
    }
