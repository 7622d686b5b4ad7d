# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""CPU time of encoding a scan and matching it with a kept keyframe, at full size and at a budget.

    OPENBLAS_NUM_THREADS=1 python scripts/network_speed.py SCAN KEYFRAME --rounds 30

Prints, for both sizes, the points of every level and the CPU milliseconds of all threads (median,
and in brackets the smallest, which other work on the machine disturbs least).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.loaders.clouds import read_cloud
from hybridreg_ros.model.budget import Budget, voxel_size_m
from hybridreg_ros.model.register import HybridReg

if TYPE_CHECKING:
    from collections.abc import Callable


def cpu_ms(once: Callable[[], object], rounds: int) -> tuple[float, float]:
    """Median and smallest CPU time of a call, milliseconds, after one that is not counted."""
    once()
    found = []
    for _ in range(rounds):
        start = time.process_time()
        once()
        found.append(1e3 * (time.process_time() - start))
    return float(np.median(found)), min(found)


def main() -> None:
    """Measure and print."""
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument('scan', type=Path, help='cloud file')
    p.add_argument('keyframe', type=Path, help='cloud file')
    p.add_argument('--rounds', type=int, default=30)
    args = p.parse_args()
    model = HybridReg.from_pretrained()
    scan, other = (np.asarray(read_cloud(f), np.float32) for f in (args.scan, args.keyframe))
    for name, budget in (('full size', None), ('budget', Budget())):
        voxel_m = voxel_size_m(scan, other, factor=model.config.voxel_factor, budget=budget)
        a, b = model.encode(scan, voxel_m), model.encode(other, voxel_m)
        parts = {
            'encode': cpu_ms(lambda v=voxel_m: model.encode(scan, v), args.rounds),  # type: ignore[misc]
            'match': cpu_ms(lambda a=a, b=b: model.match(a, b), args.rounds),  # type: ignore[misc]
        }
        sizes = ' / '.join(str(len(v.points)) for v in a.encoding.pyramid.levels)
        text = ', '.join(f'{k} {m:.1f} ({least:.1f})' for k, (m, least) in parts.items())
        print(f'{name}: voxel {voxel_m:.3f} m, {sizes} points, {text} ms')


if __name__ == '__main__':
    main()
