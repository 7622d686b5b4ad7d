# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What a replay costs beside the front end (CPU time), and its memory over a long log.

The clouds of the bag are repeated; for the memory a front end of constant pose takes them, so
that only what the replay itself keeps is counted.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.pages import peak_mb, resident_mb
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.result import OdometryResult, Reason, Source
from hybridreg_ros.replay import outputs, runner
from hybridreg_ros.replay.bag_reader import CloudFrame, open_bag
from hybridreg_ros.replay.page.pictures import Album
from hybridreg_ros.replay.page.report import ReportRun, write_report
from hybridreg_ros.replay.page.scene import SceneSink
from hybridreg_ros.replay.session import open_front_end

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hybridreg_ros.core.scan import Scan

GAP_NS = 100_000_000


class Timed:
    """A sink or front end of which the CPU time of each call is kept."""

    def __init__(self, inner: Any, spent: list[float]) -> None:
        self._inner, self._spent = inner, spent

    def __getattr__(self, name: str) -> Any:
        call = getattr(self._inner, name)

        def timed(*arguments: Any) -> Any:
            start = time.process_time()
            made = call(*arguments)
            self._spent.append(time.process_time() - start)
            return made

        return timed


class Standing:
    """A front end that never moves and calls a twentieth of the points moving."""

    def step(self, scan: Scan) -> OdometryResult:
        """A result at the origin."""
        called = np.zeros(len(scan), np.float32)
        called[::20] = 1.0
        six = np.zeros((6, 6))
        return OdometryResult(
            scan, np.eye(4), six, np.zeros(6), six, Source.KISS_ICP, Reason.OK, 1.0, called
        )


def repeated(bag: Path, count: int) -> Iterator[CloudFrame]:
    """Clouds of a bag, read over and over, with rising stamps."""
    k = 0
    while k < count:
        with open_bag(bag) as opened:
            for frame in itertools.islice(opened.frames(), count - k):
                if frame.scan is not None:
                    k += 1
                    scan = dataclasses.replace(frame.scan, stamp=GAP_NS * k)
                    yield frame._replace(stamp=scan.stamp, scan=scan)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('bag', type=Path)
    parser.add_argument('--frames', type=int, default=10_000, help='length of the long log')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, open_bag(args.bag) as opened:
        made, scene, album = outputs.OutputFiles(Path(name)), SceneSink(), Album(100)
        sinks = {'scene': scene, 'pictures': album, 'dynamic.mcap': made}
        spent: dict[str, list[float]] = {n: [] for n in ('front end', *sinks)}
        front = Timed(open_front_end(OdometryConfig(), None), spent['front end'])
        log = runner.run(opened.frames(), front, [Timed(s, spent[n]) for n, s in sinks.items()])
        made.close()
        start = time.process_time()
        run = ReportRun('', log, outputs.Scores(), None, album.views(), {}, scene.scene())
        write_report(Path(name) / 'report.html', '', '', [run])
        once = time.process_time() - start
    usual = {n: 1000.0 * float(np.median(s)) for n, s in spent.items()}
    share = 100.0 / usual['front end']
    for n, ms in usual.items():
        print(f'{n}: {ms:.2f} ms CPU per frame (median), {share * ms:.1f} % of the front end')
    print(f'all sinks: {share * sum(usual[n] for n in sinks):.1f} %; the page, once: {once:.2f} s')
    everything: tuple[runner.Sink, ...] = (SceneSink(), Album(100))
    for count in (args.frames // 10, args.frames):
        log = runner.run(repeated(args.bag, count), Standing(), everything)
        print(f'{len(log.frames)} frames: {resident_mb():.0f} MB, at most {peak_mb():.0f} MB')


if __name__ == '__main__':
    main()
