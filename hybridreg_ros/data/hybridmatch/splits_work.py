# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Making blocks of pairs: here, in local processes or on a Dask cluster, results in order."""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from typing import TYPE_CHECKING, Any

from hybridreg_ros.core.errors import HybridRegError, require
from hybridreg_ros.data.hybridmatch.room_pairs import make_samples
from hybridreg_ros.data.hybridmatch.splits_files import Made, Row, pack

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from hybridreg_ros.data.hybridmatch.take import Sample

_CONNECT_S = '10s'


@dataclass(frozen=True)
class Block:
    """Some scene seeds in a row.

    Attributes:
        split: split name.
        first_seed: first scene seed.
        count: number of scenes.
        layout: of the files made.
        still: also take targets without motion.
    """

    split: str
    first_seed: int
    count: int
    layout: str = 'shards'
    still: bool = False


def make_block(block: Block) -> Made:
    """Make all pairs of a block."""
    rows, files = [], []
    for seed in range(block.first_seed, block.first_seed + block.count):
        for sample in make_samples(block.split, seed, still=block.still):
            rows.append(_row(sample))
            files.append(pack(sample, block.layout))
    return Made(tuple(rows), tuple(files))


def _row(sample: Sample) -> Row:
    pair = sample.pair
    return Row(
        pair.name,
        float(pair.overlap),
        float(pair.dynamic_share),
        len(pair.source),
        len(pair.target),
        float(sample.displacement_m),
    )


def results(
    blocks: Iterable[Block], workers: int, scheduler: str | None = None
) -> Iterator[tuple[Block, Made]]:
    """Blocks in their order, each with its pairs; only a few are held at a time.

    Args:
        blocks: any number, taken as needed.
        workers: local processes; 1 works in this process.
        scheduler: address of a Dask scheduler, used instead of local processes.

    Raises:
        DependencyError: Dask is asked for and not installed.
        HybridRegError: no scheduler answers.
    """
    if scheduler is not None:
        yield from _on_dask(iter(blocks), scheduler)
    elif workers == 1:
        for block in blocks:
            yield block, make_block(block)
    else:
        with ProcessPoolExecutor(workers, get_context('spawn'), _start_worker) as pool:
            try:
                yield from _ahead(iter(blocks), lambda b: pool.submit(make_block, b), workers + 2)
            finally:
                pool.shutdown(wait=True, cancel_futures=True)


def _ahead(
    blocks: Iterator[Block], submit: Callable[[Block], Any], ahead: int
) -> Iterator[tuple[Block, Made]]:
    """Submit a few blocks ahead and yield the results in order."""
    running: deque[tuple[Block, Any]] = deque()
    for block in blocks:
        running.append((block, submit(block)))
        if len(running) >= ahead:
            first, future = running.popleft()
            yield first, future.result()
    while running:
        first, future = running.popleft()
        yield first, future.result()


def _on_dask(blocks: Iterator[Block], scheduler: str) -> Iterator[tuple[Block, Made]]:
    require('--scheduler', 'scale', 'distributed')
    from distributed import Client

    try:
        client = Client(scheduler, timeout=_CONNECT_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise HybridRegError(
            f'no Dask scheduler at {scheduler}: {" ".join(str(error).split())}'
        ) from None
    with client:
        ahead = 2 + 2 * sum(client.nthreads().values())
        yield from _ahead(blocks, lambda b: client.submit(make_block, b, pure=False), ahead)


def _start_worker() -> None:
    """Run politely (low priority, one thread), and never outlive the process that asked."""
    os.environ['OMP_NUM_THREADS'] = '1'
    os.nice(5)
    threading.Thread(target=follow_parent, daemon=True).start()


def follow_parent() -> None:
    """Kill this process as soon as the one that started it is gone; blocks until then."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGKILL)
