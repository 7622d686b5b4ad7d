# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fit the two models of the mask (odometry/dynamics/models.npz) to simulated sequences.

    python scripts/fit_mask.py --keep out/mask       # records what is not there yet, then fits

Streets as recorded, with every kind of lidar and from 2 to 20 scans a second; crowded streets; and
rooms. The front end goes through them with kiss-icp, so poses are as wrong as they are. The model
in context is fitted to what a model alone says that has not seen the sequence.
"""

from __future__ import annotations

import argparse
import json
import pickle
from copy import copy
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import nn

from hybridreg_ros.core import provenance, se3
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.data.hybridmatch.recorded_streets import recorded_frames
from hybridreg_ros.data.sequences.simulate import simulate
from hybridreg_ros.odometry import world
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.dynamics import models
from hybridreg_ros.odometry.dynamics.classifier import FIRST, Dynamics, remembered
from hybridreg_ros.odometry.dynamics.context import context_of
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.replay.recording import EPOCH_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from hybridreg_ros.data.sequences.frame import SimulatedFrame
    from hybridreg_ros.odometry.dynamics.cells import Cells

    F32 = NDArray[np.float32]

SEED = 6_290_000
FIRST_ROUND, SECOND_ROUND = range(70), range(100, 124)
"""Rooms and streets at many rates; then streets as recorded, most of them at low rates."""
RATES_HZ = (10.0, 10.0, 10.0, 20.0, 5.0, 2.0)
ROOM_RATES_HZ, MOST_HZ = (10.0, 10.0, 5.0, 30.0), 20.0
"""Faster sequences are left out: they end before anything has moved."""
LOW_RATES_HZ = (2.0, 2.0, 2.0, 3.0, 5.0, 10.0)
POSE_ERROR, MOST_BENT = {'depth': (0.012, 0.004), 'lidar': (0.04, 0.003)}, 0.008
"""Largest standard deviations of poses, metres and radians, beside those of the front end, and
largest share by which a depth camera is wrong."""
HIDDEN = {'alone': (24, 12), 'in_context': (32, 16)}
CELLS_A_SCAN, LITTLE = 1500, 0.01
EPOCHS, BATCH, RATE, DECAY, HEAVIEST = 6, 2048, 4e-3, 1e-4, 50.0


@dataclass(frozen=True, eq=False)
class Labelled:
    """A scan of the front end: its cells, the evidence, and (M,) points and moving ones."""

    kind: str
    cells: Cells
    evidence: F32 | None
    points: NDArray[np.int64]
    moving: NDArray[np.int64]


class Shake:
    """How far a sensor and its poses are from what is simulated, drawn once a sequence.

    Args:
        seed: of everything.
    """

    def __init__(self, seed: int) -> None:
        rng = self._rng = np.random.default_rng([seed, 79])
        self._size = rng.uniform(0.0, 1.0) ** 2
        self._bend = rng.uniform(0.0, MOST_BENT) * rng.uniform(-1.0, 1.0, 3)
        self._wave, self._phase = rng.uniform(1.0, 6.0, (3, 3)), rng.uniform(0.0, 6.3, 3)

    def pose(self, kind: str) -> NDArray[np.float64]:
        """An error (4, 4) of the next pose."""
        metres, radians = POSE_ERROR[kind]
        spread = self._size * np.repeat([metres, radians], 3)
        return se3.exp(spread * self._rng.normal(size=6))

    def bent(self, points: F32, kind: str) -> F32:
        """Points (N, 3) as a depth camera that is not calibrated well has them."""
        if kind != 'depth':
            return points
        ray = points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-6)
        waves = np.sin(ray @ self._wave.T + self._phase)
        bent: F32 = (points * (1.0 + waves @ self._bend)[:, None]).astype(np.float32)
        return bent


class Recording(Dynamics):
    """Notes the cells and the evidence of every scan, at poses that are shaken."""

    noted: list[tuple[Cells, F32 | None, NDArray[np.int32]]] = []  # noqa: RUF012
    shake: Shake

    def update(
        self, cloud: Any, T_odom_sensor: Any, image: Any, stamp: int, static: F32 | None = None
    ) -> F32:
        """As the mask does it."""
        T_odom_sensor = T_odom_sensor @ self.shake.pose(self._kind)
        self._image = copy(image)
        self._image.T_odom_sensor = T_odom_sensor
        return super().update(cloud, T_odom_sensor, self._image, stamp, static)

    def remember(self, image: Any, points: F32, stamp: int) -> None:
        """As the mask does it."""
        del image
        super().remember(self._image, points, stamp)

    def _observed(self, cloud: Any, *rest: Any) -> tuple[Cells, F32 | None]:
        cells, evidence = super()._observed(cloud, *rest)
        of_point = np.where(cloud.cube >= 0, cells.of_point[cloud.cube], -1)
        self.noted.append((cells, evidence, of_point))
        return cells, evidence


def frames_of(number: int) -> Iterator[SimulatedFrame]:
    """A simulated sequence; the rest of its settings follow from its number."""
    seed = SEED + number
    if number in SECOND_ROUND:
        rate_hz = float(np.random.default_rng([seed, 78]).choice(LOW_RATES_HZ))
        return recorded_frames(seed, np.arange(11) / rate_hz)
    rng = np.random.default_rng([seed, 77])
    rng.random()
    if number % 3 == 2:
        large = rng.random() < 0.25
        share = str(rng.choice(['none', '10-30', '30-50'], p=[0.2, 0.5, 0.3]))
        rate_hz = float(rng.choice(ROOM_RATES_HZ))
        if rate_hz > MOST_HZ:
            return iter(())
        size = (640, 480) if large else (320, 240)
        return simulate('room', 14 if large else 22, rate_hz, seed, dynamic=share, size=size)
    if number % 9 == 0:
        share = str(rng.choice(['10-30', '30-50', 'none']))
        return simulate('street', 12, 10.0, seed, dynamic=share)
    return recorded_frames(seed, np.arange(14) / float(rng.choice(RATES_HZ)))


def record(number: int) -> list[Labelled]:
    """A sequence as the front end sees it."""
    vars(world)['Dynamics'] = Recording
    shake = Recording.shake = Shake(SEED + number)
    kind = 'depth' if number in FIRST_ROUND and number % 3 == 2 else 'lidar'
    front_end = HybridOdometry(OdometryConfig(registrar='kiss-icp'))
    found = []
    for frame in frames_of(number):
        seen = np.isfinite(frame.points[:, 0])
        times = None if frame.times is None else frame.times[seen]
        stamp = round((EPOCH_S + frame.stamp_s) * NS_PER_S)
        Recording.noted.clear()
        points = shake.bent(frame.points[seen], kind)
        front_end.step(Scan(points, times, stamp, 'sensor'))
        if not Recording.noted or front_end._tracker is None:
            continue
        cells, evidence, of_point = Recording.noted[-1]
        inside, count = of_point >= 0, len(cells)
        moves = inside & (frame.label[seen] > 0)
        found.append(
            Labelled(
                front_end._tracker.sensor.kind,
                cells,
                evidence,
                np.bincount(of_point[inside], minlength=count),
                np.bincount(of_point[moves], minlength=count),
            )
        )
    return found


def sequence(seed: int, keep: Path) -> list[Labelled]:
    """A sequence from the folder, recorded there if it is not yet."""
    path = keep / f'{seed}.pkl'
    if not path.exists():
        keep.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(record(seed - SEED)))
    found: list[Labelled] = pickle.loads(path.read_bytes())
    return found


@dataclass(frozen=True, eq=False)
class Rows:
    """Cells to fit to: number of the sequence, scan and row of each, its label and its weight."""

    fold: NDArray[np.int64]
    place: list[tuple[int, int, NDArray[np.int64]]]
    label: F32
    weight: F32


def drawn(keep: Path, seeds: list[int]) -> tuple[Rows, F32]:
    """Cells drawn from all sequences, moving ones more often; and their evidence.

    A scan weighs by the root of its points, and more if little moves; draws make up for chance.
    """
    rng = np.random.default_rng(0)
    place, fold, label, weight, evidence = [], [], [], [], []
    for number, seed in enumerate(seeds):
        for k, scan in enumerate(sequence(seed, keep)):
            if scan.evidence is None:
                continue
            some = np.flatnonzero(scan.points)
            share = scan.moving.sum() / scan.points.sum()
            w = scan.points[some] / np.sqrt(scan.points.sum() * (LITTLE + share))
            moves = scan.moving[some] > 0
            chance = w / w.sum()
            if moves.any():
                chance = 0.6 * chance + 0.4 * np.where(moves, w, 0.0) / w[moves].sum()
            chance = np.minimum(1.0, CELLS_A_SCAN * chance)
            taken = rng.random(len(some)) < chance
            rows = some[taken]
            place.append((number, k, rows))
            fold.append(np.full(len(rows), number % 2))
            label.append(scan.moving[rows] / scan.points[rows])
            weight.append(w[taken] / chance[taken])
            evidence.append(scan.evidence[rows])
    heavy = np.concatenate(weight)
    heavy = np.minimum(heavy / heavy.mean(), HEAVIEST)
    rows_ = Rows(
        np.concatenate(fold), place, np.concatenate(label).astype(np.float32),
        heavy.astype(np.float32),
    )  # fmt: skip
    return rows_, np.concatenate(evidence)


def fitted(inputs: F32, label: F32, weight: F32, hidden: tuple[int, ...]) -> models.Perceptron:
    """Fit log odds to labels in [0, 1]."""
    torch.manual_seed(0)
    mean, scale = inputs.mean(axis=0), inputs.std(axis=0) + np.float32(1e-3)
    sizes = (inputs.shape[1], *hidden, 1)
    linear = [nn.Linear(a, b) for a, b in pairwise(sizes)]
    net = nn.Sequential(*(m for layer in linear for m in (layer, nn.ReLU())))[:-1]
    x = torch.tensor(np.clip((inputs - mean) / scale, -4.0, 4.0))
    y, w = torch.tensor(label), torch.tensor(weight)
    steps = EPOCHS * (len(x) // BATCH)
    optimiser = torch.optim.AdamW(net.parameters(), RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps + 1)
    for _ in range(EPOCHS):
        order = torch.randperm(len(x))
        for k in range(len(x) // BATCH):
            rows = order[k * BATCH : (k + 1) * BATCH]
            loss = nn.functional.binary_cross_entropy_with_logits(
                net(x[rows])[:, 0], y[rows], weight=w[rows]
            )
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
    layers = tuple((m.weight.detach().numpy().T, m.bias.detach().numpy()) for m in linear)
    return models.Perceptron(mean, scale, layers)


def halves(rows: Rows, inputs: F32, hidden: tuple[int, ...]) -> list[models.Perceptron]:
    """A model for each half of the sequences, fitted to the other half."""
    return [
        fitted(inputs[other], rows.label[other], rows.weight[other], hidden)
        for other in (rows.fold != 0, rows.fold != 1)
    ]


def contexts(scans: list[Labelled], alone: models.Perceptron) -> list[F32]:
    """What the model in context gets for each scan of a sequence."""
    found, last = [], None
    for scan in scans:
        cells = scan.cells
        before = np.zeros((len(cells), 3), np.float32)
        if last is not None:
            before = last[0].at(cells.centre, cells.T_odom_sensor, last[1])
        odds = np.full(len(cells), FIRST, np.float32)
        if scan.evidence is not None:
            odds = alone(scan.evidence)
            found.append(context_of(cells, scan.evidence, odds, before, scan.kind))
        else:
            found.append(np.zeros((0, 0), np.float32))
        last = cells, remembered(before, odds)
    return found


def save(path: Path, kept: dict[str, models.Perceptron], about: dict[str, Any]) -> None:
    """Write both models, and where they come from."""
    arrays: dict[str, Any] = {'about': np.array(json.dumps(about))}
    for name, model in kept.items():
        arrays |= {f'{name}_mean': model.mean, f'{name}_scale': model.scale}
        for k, (weights, offset) in enumerate(model.layers):
            arrays |= {f'{name}_weights_{k}': weights, f'{name}_offset_{k}': offset}
    np.savez_compressed(path, **arrays)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n')[0])
    parser.add_argument('--keep', type=Path, default=Path('out/mask'))
    parser.add_argument('--out', type=Path, default=models.PACKAGED)
    args = parser.parse_args()
    torch.set_num_threads(1)
    numbers = (*FIRST_ROUND, *SECOND_ROUND)
    seeds = [SEED + n for n in numbers if len(sequence(SEED + n, args.keep)) > 2]
    rows, evidence = drawn(args.keep, seeds)
    y, w = rows.label, rows.weight
    other = halves(rows, evidence, HIDDEN['alone'])
    context: list[F32] = []
    for number, seed in enumerate(seeds):
        every = contexts(sequence(seed, args.keep), other[number % 2])
        context += [every[k][r] for n, k, r in rows.place if n == number]
    x = np.concatenate(context)
    final = {
        'alone': fitted(evidence, y, w, HIDDEN['alone']),
        'in_context': fitted(x, y, w, HIDDEN['in_context']),
    }
    about = {
        'seeds': [seeds[0], seeds[-1]],
        'sequences': len(seeds),
        'cells': len(y),
        'provenance': provenance.collect(seed=SEED).to_dict(),
    }
    save(args.out, final, about)
    print(json.dumps(about, indent=1))


if __name__ == '__main__':
    main()
