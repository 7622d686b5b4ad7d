# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The process that fills the stream of a training run, and its keeper in the trainer."""

from __future__ import annotations

import fcntl
import json
import logging
import os
import threading
import time
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from multiprocessing import get_context
from typing import TYPE_CHECKING

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.data.hybridmatch.room_pairs import GENERATOR_VERSION, scene_of
from hybridreg_ros.data.hybridmatch.shards import write_shard
from hybridreg_ros.data.hybridmatch.splits import SEED_RANGES
from hybridreg_ros.data.hybridmatch.splits_files import clean, write_text
from hybridreg_ros.data.hybridmatch.splits_work import Block, follow_parent, results
from hybridreg_ros.training.stream import EXHAUSTED, Shard

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from hybridreg_ros.training.config import StreamConfig

_LOG = logging.getLogger(__name__)
_POLL_S = 0.5
_NICE = 19


@dataclass
class Made:
    """What a generator has made so far; kept in `made.json`.

    Attributes:
        number: of the next shard.
        seeds: next scene seed of each kind.
        pairs: pairs made of each kind.
        version: of the generator.
    """

    number: int = 0
    seeds: dict[str, int] = field(default_factory=dict)
    pairs: dict[str, int] = field(default_factory=dict)
    version: int = GENERATOR_VERSION


class Filler:
    """Fills the folder of a stream; one at a time, started again it goes on."""

    def __init__(self, folder: Path, config: StreamConfig) -> None:
        """Read what an earlier one has made.

        Raises:
            ConfigError: an unknown kind, or as many shares as kinds are expected and not given.
        """
        for kind in config.kinds:
            scene_of(kind)
        if config.shares and len(config.shares) != len(config.kinds):
            raise ConfigError(
                f'stream.shares: expected {len(config.kinds)} numbers, one per kind, found '
                f'{list(config.shares)}'
            )
        self._folder, self._config = folder, config
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / 'made.json'
        self._made = (
            Made(**json.loads(path.read_text(encoding='utf-8'))) if path.exists() else Made()
        )

    def fill(self) -> None:
        """Make pairs until there are no seeds left; waits while the folder is full."""
        with _alone(self._folder):
            clean(self._folder)
            stems: dict[tuple[str, int], str] = {}
            for block, made in results(self._blocks(stems), self._config.workers):
                stem = stems.pop((block.split, block.first_seed))
                if made.files:
                    blobs = [files['pair.hrs'] for files in made.files]
                    write_shard(self._folder / f'{stem}.hrs', blobs)
                pairs = self._made.pairs
                pairs[block.split] = pairs.get(block.split, 0) + len(made.files)
            (self._folder / EXHAUSTED).touch()

    def _blocks(self, stems: dict[tuple[str, int], str]) -> Iterator[Block]:
        """The next scene, always of the kind that lags most behind its share."""
        config, made = self._config, self._made
        last = SEED_RANGES['train'][1]
        shares = dict(zip(config.kinds, config.shares or (1.0,) * len(config.kinds), strict=True))
        while True:
            open_kinds = [
                kind
                for kind in config.kinds
                if shares[kind] > 0.0 and made.seeds.get(kind, config.first_seed) < last
            ]
            if not open_kinds:
                return
            self._wait_for_room()
            kind = min(open_kinds, key=lambda k: made.pairs.get(k, 0) / shares[k])
            seed = made.seeds.get(kind, config.first_seed)
            shard = Shard(made.number, kind, seed)
            made.number, made.seeds[kind] = made.number + 1, seed + 1
            write_text(self._folder / 'made.json', json.dumps(asdict(made)) + '\n')
            stems[kind, seed] = shard.stem
            yield Block(kind, seed, 1)

    def _wait_for_room(self) -> None:
        while _bytes_in(self._folder) > 1_000_000 * self._config.buffer_mb:
            time.sleep(_POLL_S)


def _bytes_in(folder: Path) -> int:
    total = 0
    for path in folder.glob('*.hrs'):
        try:
            total += path.stat().st_size
        except FileNotFoundError:  # used up meanwhile
            continue
    return total


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Wait until no other generator fills the folder, and keep others out."""
    with open(folder / '.lock', 'w', encoding='utf-8') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _run(folder: Path, config: StreamConfig) -> None:
    """What the generating process does: it ends with the trainer and leaves it the processor."""
    os.environ['OMP_NUM_THREADS'] = '1'
    os.nice(_NICE)
    threading.Thread(target=follow_parent, daemon=True).start()
    write_text(folder / 'generator.pid', f'{os.getpid()}\n')
    Filler(folder, config).fill()


class Generator:
    """A generating process beside this one; started again when it dies before its work ends."""

    def __init__(self, folder: Path, config: StreamConfig) -> None:
        """Check the settings and start.

        Raises:
            ConfigError: as `Filler`.
        """
        Filler(folder, config)
        self._folder, self._config = folder, config
        self._stopped = threading.Event()
        self._start()
        self._keeper = threading.Thread(target=self._keep, daemon=True)
        self._keeper.start()

    def stop(self) -> None:
        """End the process; what it was making is lost, which a later start leaves out."""
        self._stopped.set()
        self._keeper.join()
        self._process.kill()
        self._process.join()

    def _start(self) -> None:
        self._process = get_context('spawn').Process(
            target=_run, args=(self._folder, self._config), name='generator', daemon=False
        )
        self._process.start()

    def _keep(self) -> None:
        while not self._stopped.wait(1.0):
            if self._process.exitcode:
                _LOG.warning(
                    'the generator exited with code %d and was restarted', self._process.exitcode
                )
                self._start()
