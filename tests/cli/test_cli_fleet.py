# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Many logs: bad ones are named, the others are scored, a killed batch goes on where it was."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tiny_bags import START, write_room_bag

from hybridreg_ros.cli.main import main
from hybridreg_ros.replay.bag_writer import BagWriter

if TYPE_CHECKING:
    from pathlib import Path

KISS = ['--registrar', 'kiss-icp', '--no-clouds']
BAD = {'corrupt', 'empty', 'no_topic'}


@pytest.fixture(scope='module')
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Nine good bags and three bad ones, not in this order."""
    folder = tmp_path_factory.mktemp('fleet')
    for k in range(9):
        write_room_bag(folder / f'log{k}.mcap', 4 + k % 3, truth=k != 4)
    (folder / 'corrupt.mcap').write_bytes(b'\x89MCAP0\r\n' + bytes(range(200)))
    (folder / 'empty.mcap').write_bytes(b'')
    with BagWriter(folder / 'no_topic.mcap') as bag:
        bag.write_odometry('/odom', START, ('odom', 'base'), np.eye(4))
    return [str(p) for p in sorted(folder.iterdir())]


def rows_of(table: str) -> dict[str, list[str]]:
    """Cells of each row of the printed table, by the name of the log."""
    lines = [re.split(r'\s{2,}', line) for line in table.splitlines() if '  ' in line]
    return {cells[0]: cells[1:] for cells in lines if cells[0] != 'log'}


def test_twelve_logs_of_which_three_are_bad(
    logs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ['replay', *logs, '--out', str(tmp_path), *KISS]
    result = tmp_path / 'all.json'
    assert main([*arguments, '--json', str(result)]) == 2
    said = capsys.readouterr()
    rows = rows_of(said.out)
    assert {name for name, cells in rows.items() if cells[0] == 'failed'} == BAD
    assert sum(cells[0] == 'done' for cells in rows.values()) == 9
    assert set(list(rows)[:3]) == BAD, 'the worst come first'
    assert 'has no PointCloud2 topic' in said.err
    for name in BAD:
        assert f'{name}: failed: ' in said.err
        assert not (tmp_path / name).exists()
    told = json.loads(result.read_text())
    assert {v['status'] for v in told.values()} == {'done', 'failed'}
    page = (tmp_path / 'index.html').read_text('utf-8')
    assert page.count('/report.html"') == 9
    for link in re.findall(r'href="([^"]+)"', page):
        assert (tmp_path / link).is_file()
    assert main(arguments) == 2
    assert re.search(r'log0 \(and 8 more\) holds results: .*--overwrite', capsys.readouterr().err)
    assert main([*arguments, '--resume']) == 2
    assert sum(cells[0] == 'kept' for cells in rows_of(capsys.readouterr().out).values()) == 9
    assert main([*arguments, '--resume', '--stride', '2']) == 2
    assert sum(cells[0] == 'done' for cells in rows_of(capsys.readouterr().out).values()) == 9


@pytest.mark.parametrize('workers', ['1', '2'])
def test_killed_batch_goes_on(logs: list[str], tmp_path: Path, workers: str) -> None:
    """Here, or on a Dask cluster of two local processes; nothing goes on behind one's back."""
    if workers != '1':
        pytest.importorskip('distributed')
    command = [sys.executable, '-m', 'hybridreg_ros.cli.main', 'replay', *logs, *KISS]
    command += ['--out', str(tmp_path), '--workers', workers]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    end = time.monotonic() + 200
    while len(list(tmp_path.glob('*/metrics.json'))) < 2 and time.monotonic() < end:
        assert process.poll() is None
        time.sleep(0.02)
    process.kill()
    process.wait()
    time.sleep(3.0)
    before = {p: p.stat().st_mtime_ns for p in tmp_path.glob('*/metrics.json')}
    assert 2 <= len(before) < 9
    done = subprocess.run(
        [*command, '--resume'], capture_output=True, text=True, check=False, timeout=250
    )
    assert done.returncode == 2, done.stderr
    rows = rows_of(done.stdout)
    count = Counter(cells[0] for cells in rows.values())
    assert count == {'failed': 3, 'kept': len(before), 'done': 9 - len(before)}
    assert {name for name, cells in rows.items() if cells[0] == 'failed'} == BAD
    assert all(p.stat().st_mtime_ns == was for p, was in before.items())
    assert 'distributed' not in done.stderr


def test_scheduler_is_used_or_refused(
    logs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip('distributed')
    arguments = ['replay', logs[3], '--out', str(tmp_path), *KISS, '--scheduler', 'tcp://[::1]:9']
    assert main(arguments) == 2
    assert 'no Dask scheduler at tcp://[::1]:9' in capsys.readouterr().err
    assert main([*arguments, '--live']) == 2
    assert 'cannot be combined with --live' in capsys.readouterr().err
