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
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import nn

from hybridreg_ros.core import provenance, se3
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.data.hybridmatch.recorded_streets import recorded_frames
from hybridreg_ros.data.sequences.frame import LIDAR_FRAME
from hybridreg_ros.data.sequences.simulate import simulate
from hybridreg_ros.odometry import tracker, world
from hybridreg_ros.odometry.dynamics import models
from hybridreg_ros.odometry.dynamics.cells import LARGER, Cells, Grid
from hybridreg_ros.odometry.dynamics.classifier import FIRST, Dynamics, remembered
from hybridreg_ros.odometry.dynamics.context import context_of
from hybridreg_ros.odometry.dynamics.evidence import Look, Past, evidence_of
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.network_branch import LearnedBranch
from hybridreg_ros.odometry.visibility.range_image import RangeImage, view_of
from hybridreg_ros.replay.recording import EPOCH_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from hybridreg_ros.data.sequences.frame import SimulatedFrame
    from hybridreg_ros.odometry.config import DynamicsConfig
    from hybridreg_ros.odometry.preprocess import SensorModel
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan

    F32 = NDArray[np.float32]

SEED, SEQUENCES = 6_290_000, 41
RATES_HZ = (10.0, 10.0, 10.0, 20.0, 5.0, 2.0, 2.0, 3.0)
ROOM_RATES_HZ, MOTORWAY_RATES_HZ = (10.0, 10.0, 5.0), (10.0, 10.0, 20.0, 5.0)
POSE_ERROR, MOST_BENT = {'depth': (0.012, 0.004), 'lidar': (0.04, 0.003)}, 0.008
"""Largest standard deviations of poses, metres and radians, beside those of the front end, and
largest share by which a depth camera is wrong."""
HIDDEN = {'alone': (24, 12), 'in_context': (32, 16)}
CELLS_A_SCAN, LITTLE, UNASKED = 1500, 0.01, 0.4
EPOCHS, BATCH, RATE, DECAY, HEAVIEST = 6, 2048, 4e-3, 1e-4, 50.0


class Shake:
    """How far a sensor and its poses are from what is simulated, drawn once a sequence.

    Args:
        seed: of everything.

    Attributes:
        error: (4, 4) that of the pose of the present scan.
    """

    def __init__(self, seed: int) -> None:
        rng = self._rng = np.random.default_rng([seed, 79])
        self._size = rng.uniform(0.0, 1.0) ** 2
        self._bend = rng.uniform(0.0, MOST_BENT) * rng.uniform(-1.0, 1.0, 3)
        self._wave, self._phase = rng.uniform(1.0, 6.0, (3, 3)), rng.uniform(0.0, 6.3, 3)
        self.error = np.eye(4)

    def again(self, kind: str) -> None:
        """Draw the error of the next pose."""
        metres, radians = POSE_ERROR[kind]
        spread = self._size * np.repeat([metres, radians], 3)
        self.error = se3.exp(spread * self._rng.normal(size=6))

    def bent(self, points: F32) -> F32:
        """Points (N, 3) as a depth camera that is not calibrated well has them."""
        ray = points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-6)
        waves = np.sin(ray @ self._wave.T + self._phase)
        bent: F32 = (points * (1.0 + waves @ self._bend)[:, None]).astype(np.float32)
        return bent


@dataclass
class Told:
    """What the mask is told of a scan, and whether the scan is remembered.

    Attributes:
        cloud: the scan.
        pose: (4, 4) where it is, as wrong as `Shake` has it.
        stamp: ns.
        static: (M,) P(static) of its thinned points by the network; None = not asked.
        sensor: what the sensor is.
        kept: whether later scans are compared with it.
        moving: (N,) its truth.
    """

    cloud: PreprocessedScan
    pose: NDArray[np.float64]
    stamp: int
    static: F32 | None
    sensor: SensorModel
    kept: bool = False
    moving: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))


class Notes(Dynamics):
    """Notes what the mask is told, with poses that are shaken."""

    told: list[Told] = []  # noqa: RUF012
    shake: Shake | None = None
    kind = ''

    def __init__(self, config: DynamicsConfig, sensor: SensorModel) -> None:
        super().__init__(config, sensor)
        self._sensor, Notes.kind = sensor, sensor.kind

    def update(
        self, cloud: Any, T_odom_sensor: Any, image: Any, stamp: int, static: F32 | None = None
    ) -> F32:
        """As the mask does it."""
        shaken = T_odom_sensor if self.shake is None else T_odom_sensor @ self.shake.error
        self.told.append(Told(cloud, shaken, stamp, static, self._sensor))
        return super().update(cloud, T_odom_sensor, image, stamp, static)

    def remember(self, image: Any, points: F32, stamp: int) -> None:
        """As the mask does it."""
        self.told[-1].kept = True
        super().remember(image, points, stamp)


class Shaken(LearnedBranch):
    """Asks the static head at poses that are shaken."""

    def point_mask(self, scan: Any, keyframe: Any, T_odom_sensor: Any) -> Any:
        """As the branch does it."""
        assert Notes.shake is not None
        Notes.shake.again(Notes.kind)
        return super().point_mask(scan, keyframe, T_odom_sensor @ Notes.shake.error)


def frames_of(number: int) -> Iterator[SimulatedFrame]:
    """A simulated sequence; the rest of its settings follow from its number."""
    seed, kind = SEED + number, number % 10
    rng = np.random.default_rng([seed, 77])
    if kind in (2, 6):
        times = np.arange(10) / float(rng.choice(MOTORWAY_RATES_HZ))
        return recorded_frames(seed, times, motorway=True)
    if kind in (4, 8) or number % 20 == 9:
        large, share = rng.random() < 0.2, str(rng.choice(['none', '10-30', '30-50']))
        size, rate_hz = (640, 480) if large else (320, 240), float(rng.choice(ROOM_RATES_HZ))
        return simulate('room', 10 if large else 18, rate_hz, seed, dynamic=share, size=size)
    if number % 20 == 19:
        share = str(rng.choice(['10-30', '30-50', 'none']))
        return simulate('street', 10, 10.0, seed, dynamic=share)
    return recorded_frames(seed, np.arange(12) / float(rng.choice(RATES_HZ)))


def noted(scans: Iterable[tuple[Scan, NDArray[np.bool_]]]) -> list[Told]:
    """What the mask is told of scans, each with what moves in it (N,), by the front end."""
    vars(world)['Dynamics'] = Notes
    front_end = HybridOdometry()
    found: list[Told] = []
    for scan, moving in scans:
        Notes.told.clear()
        front_end.step(scan)
        *before, last = Notes.told or (None,)
        if before and found and before[-1].stamp == found[-1].stamp:  # deskewed once more
            found[-1] = replace(before[-1], moving=found[-1].moving)
        if last is not None:
            found.append(replace(last, moving=moving))
    return found


def record(number: int) -> list[Told]:
    """A simulated sequence, shaken, as the front end sees it."""
    vars(tracker)['LearnedBranch'] = Shaken
    shake = Notes.shake = Shake(SEED + number)

    def scans() -> Iterator[tuple[Scan, NDArray[np.bool_]]]:
        for frame in frames_of(number):
            seen = np.isfinite(frame.points[:, 0])
            times = None if frame.times is None else frame.times[seen]
            points = frame.points[seen]
            if frame.frame_id != LIDAR_FRAME:
                points = shake.bent(points)
            stamp = round((EPOCH_S + frame.stamp_s) * NS_PER_S)
            yield Scan(points, times, stamp, 'sensor'), frame.label[seen] > 0

    return noted(scans())


def sequence(number: int, keep: Path) -> list[Told]:
    """A sequence from the folder, recorded there if it is not yet."""
    path = keep / f'{number:03d}.pkl'
    if not path.exists():
        keep.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix('.part')
        part.write_bytes(pickle.dumps(record(number)))
        part.replace(path)
    found: list[Told] = pickle.loads(path.read_bytes())
    return found


@dataclass(frozen=True, eq=False)
class Labelled:
    """A scan: its cells, the evidence (M, E) about them, their points (M,) and moving ones."""

    kind: str
    cells: Cells
    evidence: F32 | None
    points: NDArray[np.int64]
    moving: NDArray[np.int64]


def labelled(number: int, keep: Path) -> Iterator[Labelled]:
    """The scans of a sequence; of some the network is not asked."""
    rng, past, view = np.random.default_rng([SEED + number, 80]), Past(), None
    for scan in sequence(number, keep):
        cloud, kind = scan.cloud, scan.sensor.kind
        view = view or view_of(cloud.points[cloud.usable], kind)
        image = RangeImage(cloud.points, view, scan.pose, cloud.usable)
        grid = Grid.of(scan.sensor.voxel_size_m, view.step_rad, LARGER[kind])
        cells = Cells.of(cloud.means, cloud.counts, scan.pose, grid)
        static = None if rng.random() < UNASKED else scan.static
        looks = past.looks(scan.stamp)
        evidence = evidence_of(cells, looks, image, kind, static) if looks else None
        if scan.kept:
            past.keep(Look(scan.stamp, image, np.zeros((0, 3), np.float32)))
        of_point = np.where(cloud.cube >= 0, cells.of_point[cloud.cube], -1)
        inside, count = of_point >= 0, len(cells)
        yield Labelled(
            kind,
            cells,
            evidence,
            np.bincount(of_point[inside], minlength=count),
            np.bincount(of_point[inside & scan.moving], minlength=count),
        )


@dataclass(frozen=True, eq=False)
class Rows:
    """Cells to fit to: number of the sequence, scan and row of each, its label and its weight."""

    fold: NDArray[np.int64]
    place: list[tuple[int, int, NDArray[np.int64]]]
    label: F32
    weight: F32


def drawn(sequences: Iterable[tuple[int, Iterable[Labelled]]]) -> tuple[Rows, F32]:
    """Cells drawn from all sequences, moving ones more often; and their evidence.

    A scan weighs by the root of its points, and more if little moves; draws make up for chance.
    """
    rng = np.random.default_rng(0)
    place, fold, label, weight, evidence = [], [], [], [], []
    for number, scans in sequences:
        for k, scan in enumerate(scans):
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
            fold.append(np.full(len(rows), number // 10 % 2))
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


def contexts(scans: Iterable[Labelled], alone: models.Perceptron) -> list[F32]:
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
    parser.add_argument('--keep', type=Path, default=Path('runs/mask'))
    parser.add_argument('--out', type=Path, default=models.PACKAGED)
    args = parser.parse_args()
    torch.set_num_threads(1)
    numbers = [n for n in range(SEQUENCES) if len(sequence(n, args.keep)) > 2]
    rows, evidence = drawn((n, labelled(n, args.keep)) for n in numbers)
    y, w = rows.label, rows.weight
    other = halves(rows, evidence, HIDDEN['alone'])
    context: list[F32] = []
    for number in numbers:
        every = contexts(labelled(number, args.keep), other[number // 10 % 2])
        context += [every[k][r] for n, k, r in rows.place if n == number]
    final = {
        'alone': fitted(evidence, y, w, HIDDEN['alone']),
        'in_context': fitted(np.concatenate(context), y, w, HIDDEN['in_context']),
    }
    about = {
        'seeds': [SEED + numbers[0], SEED + numbers[-1]],
        'sequences': len(numbers),
        'cells': len(y),
        'provenance': provenance.collect(seed=SEED).to_dict(),
    }
    save(args.out, final, about)
    print(json.dumps(about, indent=1))


if __name__ == '__main__':
    main()
