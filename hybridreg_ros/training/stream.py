# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A stream of new pairs for training: small shards that are deleted once their pairs are used up.

In the folder: `NUMBER-KIND-SEED.hrs`, the pairs of one scene; `made.json`, which seeds the
generator has taken; `uses-READER.csv`, one line per use: sample number, shard, row in the shard.
Every file survives a kill: a seed is noted before its shard is made and a use before the pair is
handed out, so that no seed comes twice and no pair more often than it may.
"""

from __future__ import annotations

import re
import time
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hybridreg_ros.core.errors import FileFormatError, HybridRegError
from hybridreg_ros.data.hybridmatch.shards import decode_pair, read_offsets

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from hybridreg_ros.data.pair import PointPair
    from hybridreg_ros.training.config import StreamConfig

EXHAUSTED = 'exhausted'
"""File that appears when the generator has no seeds left."""
_POLL_S = 0.2
_DRAW = 7


class Shard(NamedTuple):
    """What the name of a shard says.

    Attributes:
        number: in the order of making.
        kind: split name, such as `room-train`.
        seed: of the scene.
    """

    number: int
    kind: str
    seed: int

    @property
    def stem(self) -> str:
        """File name without its ending."""
        return f'{self.number:08d}-{self.kind}-{self.seed:07d}'

    @classmethod
    def of(cls, stem: str) -> Shard:
        """Inverse of `stem`.

        Raises:
            FileFormatError: it is no name of a shard of a stream.
        """
        found = re.fullmatch(r'(\d+)-(.+)-(\d+)', stem)
        if found is None:
            raise FileFormatError(
                f'{stem}: expected NUMBER-KIND-SEED, the name of a shard of a stream'
            )
        return cls(int(found[1]), found[2], int(found[3]))


class Use(NamedTuple):
    """One use of a pair.

    Attributes:
        number: of the training sample.
        stem: of the shard.
        row: of the pair in it.
    """

    number: int
    stem: str
    row: int


def uses_in(folder: Path) -> Iterator[Use]:
    """All noted uses of a stream; a line that a kill cut off is left out."""
    for path in sorted(folder.glob('uses-*.csv')):
        for line in path.read_text(encoding='utf-8').splitlines(keepends=True):
            if line.endswith('\n'):
                number, stem, row = line.split(',')
                yield Use(int(number), stem, int(row))


@dataclass(frozen=True)
class _Place:
    path: Path
    row: int
    start: int
    end: int


class PairStream:
    """Reader of a stream; several share the shards out by their number."""

    def __init__(
        self, folder: Path, config: StreamConfig, seed: int, *, reader: int = 0, readers: int = 1
    ) -> None:
        """Take up what is there; uses noted before a kill count.

        Args:
            folder: of the stream; made when missing.
            config: how often a pair may be used, and from how many shards is drawn at a time.
            seed: of the order.
            reader: number of this reader.
            readers: how many there are.
        """
        self._folder, self._config, self._seed = folder, config, seed
        self._reader, self._readers = reader, readers
        folder.mkdir(parents=True, exist_ok=True)
        self._before = Counter((use.stem, use.row) for use in uses_in(folder))
        self._left: dict[_Place, int] = {}
        self._open: dict[Path, int] = {}
        self._pool: list[_Place] = []
        self._log = folder / f'uses-{reader}.csv'
        _cut_torn_line(self._log)
        self._notes = self._log.open('a', encoding='utf-8')

    def draw(self, number: int) -> PointPair:
        """A random one of the pairs at hand, for a sample of a number; waits for one.

        Raises:
            HybridRegError: the generator has no seeds left and every pair is used up.
        """
        while not self._pool or len(self._open) < self._config.window:
            if not self._refresh() and self._pool:
                break
            if not self._pool:
                self._check_exhausted()
                time.sleep(_POLL_S)
        rng = np.random.default_rng([self._seed, number, _DRAW])
        at = int(rng.integers(len(self._pool)))
        place = self._pool[at]
        self._notes.write(f'{number},{place.path.stem},{place.row}\n')
        self._notes.flush()
        with open(place.path, 'rb') as stream:
            stream.seek(place.start)
            pair = decode_pair(stream.read(place.end - place.start))
        self._used(at)
        return pair

    def _used(self, at: int) -> None:
        """Count a use; delete the shard with the last one of its pairs."""
        place = self._pool[at]
        self._left[place] -= 1
        if self._left[place]:
            return
        del self._left[place]
        self._pool[at] = self._pool[-1]
        self._pool.pop()
        self._open[place.path] -= 1
        if not self._open[place.path]:
            del self._open[place.path]
            place.path.unlink()

    def _refresh(self) -> bool:
        """Take up the oldest new shards, as many as the window lets in; whether there were any."""
        found = False
        for path in sorted(self._folder.glob('*.hrs')):
            if len(self._open) >= self._config.window:
                break
            mine = Shard.of(path.stem).number % self._readers == self._reader
            if mine and path not in self._open:
                found = True
                self._take_up(path)
        return found

    def _take_up(self, path: Path) -> None:
        offsets = read_offsets(path).tolist()
        for row, (start, end) in enumerate(pairwise(offsets)):
            left = self._config.uses - self._before.pop((path.stem, row), 0)
            if left > 0:
                place = _Place(path, row, start, end)
                self._left[place] = left
                self._pool.append(place)
                self._open[path] = self._open.get(path, 0) + 1
        if path not in self._open:
            path.unlink()

    def _check_exhausted(self) -> None:
        if (self._folder / EXHAUSTED).exists() and not any(self._folder.glob('*.hrs')):
            raise HybridRegError(
                f'{self._folder}: every training seed has been used; choose a smaller '
                'stream.first_seed and another out folder'
            )


def _cut_torn_line(path: Path) -> None:
    """Remove what a kill left of a line."""
    if path.exists() and (text := path.read_bytes()) and not text.endswith(b'\n'):
        path.write_bytes(text[: text.rfind(b'\n') + 1])
