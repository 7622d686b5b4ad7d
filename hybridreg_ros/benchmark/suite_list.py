# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The benchmark suites: which sequences, strides and methods, by name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hybridreg_ros.core.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable

STRIDES = (1, 2, 5, 10)
METHODS = ('ours', 'ours-no-mask', 'ours-no-network', 'kiss-icp', 'genz-icp', 'small-gicp')
BASELINES = ('kiss-icp', 'genz-icp')


@dataclass(frozen=True)
class Sequence:
    """One benchmark sequence.

    Attributes:
        name: unique.
        suite: rooms, streets, real, or dev (for fitting; never scored).
        kind: depth or lidar; decides which steps are right.
        frames: clouds at stride 1.
        source: simulated, kitti, depth or ouster.
        share: simulated: percent of moving points, none, 10-30 or 30-50.
        seed: simulated: of everything random.
        folder: real: folder of the recording in the data directory.
        poses: real: its file of true poses.
        period_s: real: seconds between scans (depth: between frame numbers).
        moving: whether anything moves; None when nobody knows.
        window: half the width and height of the view that is kept, as a share of its depth (the
            tangent of the angle); a narrow one often shows a bare wall only. 0 = all.
        deskewed: whether the motion during each scan is undone by the true poses and its times are
            left out, as in recordings that were prepared for a benchmark.
    """

    name: str
    suite: str
    kind: str
    frames: int
    source: str = 'simulated'
    share: str = ''
    seed: int = 0
    folder: str = ''
    poses: str = 'poses.txt'
    period_s: float = 0.1
    moving: bool | None = None
    window: float = 0.0
    deskewed: bool = False

    @property
    def limits(self) -> tuple[float, float]:
        """Largest error of a right step, metres and degrees."""
        return (0.05, 1.0) if self.kind == 'depth' else (0.2, 1.0)


def _simulated(name: str, suite: str, frames: int, share: str, seed: int) -> Sequence:
    """A simulated sequence: of a room, or of a street where the name says so."""
    kind = 'lidar' if 'street' in name else 'depth'
    return Sequence(name, suite, kind, frames, share=share, seed=seed, moving=share != 'none')


def _rooms() -> tuple[Sequence, ...]:
    shares = ('none', '10-30', '30-50', 'none', '10-30', '30-50', 'none', '10-30', '30-50', 'none')
    return tuple(
        _simulated(f'room-{k:02d}', 'rooms', 200, share, 5_551_000 + k)
        for k, share in enumerate(shares)
    )


def _streets() -> tuple[Sequence, ...]:
    shares = ('none', '10-30', '30-50', '10-30', 'none', '10-30')
    return tuple(
        _simulated(f'street-{k}', 'streets', 100, share, 5_552_000 + k)
        for k, share in enumerate(shares)
    )


def _development() -> tuple[Sequence, ...]:
    rooms = ((501, 'none'), (502, '30-50'), (505, '10-30'), (507, '30-50'))
    streets = ((504, '10-30'), (506, 'none'))
    rough = ((6035, 'none'), (6047, 'none'), (6078, 'none'), (6202, '10-30'), (6205, '30-50'))
    narrow = ((502, '30-50', 80), (911, '30-50', 200))
    long_rooms = {
        'none': (946, 947, 951, 952, 953, 954),
        '10-30': (930, 932, 935, 955, 956),
        '30-50': (902, 911, 923, 931, 933, 936, 942, 944),
    }
    few_rings = ((823, '30-50', 24), (827, '30-50', 24), (840, 'none', 24))
    slow = ((8223, 'none', 30), (8029, '10-30', 30), (8112, '30-50', 30), (8132, '30-50', 30))
    fast = (
        (8301, 'none', 100),
        (8306, 'none', 100),
        (8309, 'none', 100),
        (8310, 'none', 100),
        (8330, '10-30', 100),
        (8337, '10-30', 100),
    )
    plain = ((8301, 'none'), (8306, 'none'), (8309, 'none'), (8330, '10-30'))
    return (
        *(_simulated(f'dev-room-{seed}', 'dev', 80, share, seed) for seed, share in rooms),
        *(
            _simulated(f'dev-room-{seed}', 'dev', 200, share, seed)
            for share, seeds in long_rooms.items()
            for seed in seeds
        ),
        *(
            replace(_simulated(f'dev-narrow-{seed}', 'dev', frames, share, seed), window=0.15)
            for seed, share, frames in narrow
        ),
        *(
            _simulated(f'dev-street-{seed}', 'dev', 40, share, seed)
            for seed, share in streets + rough
        ),
        *(
            _simulated(f'dev-street-{seed}', 'dev', frames, share, seed)
            for seed, share, frames in few_rings + slow + fast
        ),
        *(
            replace(_simulated(f'dev-street-plain-{seed}', 'dev', 100, share, seed), deskewed=True)
            for seed, share in plain
        ),
    )


_REAL = (
    Sequence(
        'lidar_balm_walk_a',
        'real',
        'lidar',
        30,
        'kitti',
        folder='lidar_balm_walk_a',
        period_s=0.5,
        moving=False,
    ),
    Sequence(
        'lidar_kitti_raw_22scans',
        'real',
        'lidar',
        22,
        'kitti',
        folder='lidar_kitti_raw_22scans',
        poses='poses_reference_icp.txt',
    ),
    Sequence(
        'lidar_kitti07_keyframes5',
        'real',
        'lidar',
        5,
        'kitti',
        folder='lidar_kitti07_keyframes5',
        period_s=1.0,
    ),
    Sequence(
        'lidar_ouster_os1_3scans', 'real', 'lidar', 3, 'ouster', folder='lidar_ouster_os1_3scans'
    ),
    Sequence(
        'depth_7scenes',
        'real',
        'depth',
        100,
        'depth',
        folder='depth_7scenes',
        period_s=1.0 / 30.0,
        moving=False,
    ),
)

SEQUENCES = {s.name: s for s in (*_rooms(), *_streets(), *_REAL, *_development())}
SUITES = ('rooms', 'streets', 'real', 'dev')


def chosen(suite: str, names: Iterable[str] = (), frames: int | None = None) -> list[Sequence]:
    """Sequences of a suite (or 'all', which leaves 'dev' out), or the named ones of it.

    Args:
        suite: one of SUITES, or 'all'.
        names: only these; empty for all.
        frames: at most so many frames of each; None for all.

    Raises:
        ConfigError: no such suite, or a sequence that is not in it.
    """
    if suite not in (*SUITES, 'all'):
        raise ConfigError(f'--suite: expected all, {", ".join(SUITES)}, found {suite!r}')
    found = {
        s.name: s
        for s in SEQUENCES.values()
        if s.suite == suite or (suite == 'all' and s.suite != 'dev')
    }
    wanted = list(names) or list(found)
    missing = [n for n in wanted if n not in found]
    if missing:
        raise ConfigError(
            f'--sequences: {missing[0]!r} is not in suite {suite}, which has {", ".join(found)}'
        )
    some = [found[n] for n in wanted]
    return some if frames is None else [replace(s, frames=min(s.frames, frames)) for s in some]
