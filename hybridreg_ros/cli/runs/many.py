# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The same work on many inputs: here, on local processes, or on a Dask cluster."""

from __future__ import annotations

import contextlib
import logging
import os
from typing import TYPE_CHECKING, Any, TypeVar

from hybridreg_ros.core.errors import HybridRegError, require

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

Item = TypeVar('Item')
Result = TypeVar('Result')

CONNECT_S = '10s'


def each(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int = 1,
    scheduler: str | None = None,
) -> Iterator[Result]:
    """Results in the order of the items; errors are those of the work itself.

    Args:
        work: importable function of one item; item and result can be pickled.
        items: inputs.
        workers: local processes (a local Dask cluster); 1 works in this process.
        scheduler: address of a running Dask scheduler, used instead of local processes.

    Raises:
        DependencyError: Dask is needed and not installed.
        HybridRegError: the scheduler cannot be reached.
    """
    if scheduler is None and (workers <= 1 or len(items) <= 1):
        yield from map(work, items)
        return
    with _client(min(workers, len(items)), scheduler) as client:
        futures = client.map(work, items, pure=False, retries=1)
        for future in futures:
            yield future.result()


def require_dask() -> None:
    """Find Dask before the work begins.

    Raises:
        DependencyError: it is not installed.
    """
    require('--workers or --scheduler', 'scale', 'dask', 'distributed')


@contextlib.contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Any]:
    require_dask()
    import dask
    from distributed import Client, LocalCluster

    # What Dask says of its workers' comings and goings is no news to anybody here.
    logging.getLogger('distributed').setLevel(logging.CRITICAL)
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=CONNECT_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise HybridRegError(
                f'no Dask scheduler at {scheduler}: {" ".join(str(error).split())}'
            ) from None
        with client:
            yield client
        return
    # One thread per process: numba, torch and BLAS must not fight for the cores.
    os.environ.setdefault('OMP_NUM_THREADS', '1')
    with (
        dask.config.set({'distributed.worker.daemon': False}),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            memory_limit=0,
            silence_logs='CRITICAL',
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client
