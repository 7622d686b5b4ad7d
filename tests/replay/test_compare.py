# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Comparisons of runs: intervals that cover, verdicts that hold, pages that show both."""

from __future__ import annotations

import doctest
import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros.cli.main import main
from hybridreg_ros.metrics import bootstrap
from hybridreg_ros.metrics.bootstrap import paired

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


def test_doctests() -> None:
    assert doctest.testmod(bootstrap).failed == 0


def correlated(rng: np.random.Generator, n: int, mean: float) -> NDArray[np.float64]:
    """Values in which neighbours are alike (AR(1), 0.5)."""
    noise = rng.normal(0, 1, n)
    for k in range(1, n):
        noise[k] += 0.5 * noise[k - 1]
    return noise + mean


def test_intervals_cover_the_truth(rng: np.random.Generator) -> None:
    """Nominal 95 %; blocks of a cube root's length catch most of the likeness of neighbours."""
    hits = 0
    for _ in range(100):
        found = paired([correlated(rng, 200, 0.3)])
        assert found is not None
        hits += found.low <= 0.3 <= found.high
    assert hits >= 85


def test_small_and_empty_samples() -> None:
    assert paired([]) is None
    assert paired([np.array([np.nan])]) is None
    found = paired([np.array([np.nan, 2.0])])
    assert found is not None
    assert (found.mean, found.pairs) == (2.0, 1)
    two = paired([np.zeros(50), np.ones(50)])
    assert two is not None
    assert (two.low, two.high) == (0.0, 1.0), 'the next sequence may be like either'
    assert not two.is_sure


def write_run(folder: Path, seed: int, shift: float, labelled: bool = True) -> None:
    """A metrics.json of 80 frames; errors of `seed` plus a shift."""
    rng = np.random.default_rng(seed)
    frames = [
        {
            'stamp': 10**9 + k * 10**8,
            'accepted': True,
            'step_mm': None if k == 0 else float(rng.gamma(2.0, 2.0)) + shift,
            'position_mm': float(rng.gamma(2.0, 5.0)),
            'total_ms': 100.0 + float(np.random.default_rng(k + seed).normal()),
            'mask': {'tp': 8, 'fp': 1, 'fn': 1, 'tn': 90} if labelled else None,
        }
        for k in range(80)
    ]
    folder.mkdir(parents=True)
    (folder / 'metrics.json').write_text(json.dumps({'per_frame': frames}))


def test_single_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_run(tmp_path / 'a', 1, 0.0)
    write_run(tmp_path / 'b', 1, 0.5, labelled=False)
    page, result = tmp_path / 'c.html', tmp_path / 'c.json'
    names = [str(tmp_path / 'a'), str(tmp_path / 'b')]
    assert main(['compare', *names, '--out', str(page), '--json', str(result)]) == 0
    assert 'worse' in capsys.readouterr().out
    rows = {r['quantity']: r for r in json.loads(result.read_text())['rows']}
    assert set(rows) == {'step_mm', 'position_mm', 'total_ms'}
    assert rows['step_mm']['difference']['mean'] == pytest.approx(0.5)
    assert rows['step_mm']['difference']['pairs'] == 79
    assert rows['step_mm']['value'] == pytest.approx(rows['step_mm']['base'] + 0.5)
    assert rows['step_mm']['verdict'] == 'worse'
    assert rows['position_mm']['verdict'] == 'no sure difference'
    text = page.read_text('utf-8')
    assert text.count('<svg class="chart') == 4, 'IoU is drawn where it is known'
    assert 'b: step error (mm) is worse (+0.500).' in text


def test_folders_of_runs(tmp_path: Path) -> None:
    for name, seed in (('one', 1), ('two', 2), ('three', 3)):
        write_run(tmp_path / 'old' / name, seed, 0.0)
        write_run(tmp_path / 'new' / name, seed, -0.3)
    write_run(tmp_path / 'new' / 'extra', 4, 0.0)
    result = tmp_path / 'c.json'
    names = [str(tmp_path / 'old'), str(tmp_path / 'new')]
    out = ['--out', str(tmp_path / 'c.html'), '--json', str(result)]
    assert main(['compare', *names, *out]) == 0
    rows = [r for r in json.loads(result.read_text())['rows'] if r['quantity'] == 'step_mm']
    assert [r['log'] for r in rows] == ['one', 'three', 'two', 'overall']
    assert {r['verdict'] for r in rows} == {'better'}
    assert rows[-1]['difference']['mean'] == pytest.approx(-0.3)


def test_what_cannot_be_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_run(tmp_path / 'a', 1, 0.0)
    write_run(tmp_path / 'many' / 'x', 1, 0.0)
    (tmp_path / 'bad').mkdir()
    (tmp_path / 'bad' / 'metrics.json').write_text('{}')
    for runs, text in (
        (['a'], 'name two folders'),
        (['a', 'gone'], 'expected results of replay (metrics.json), found none'),
        (['a', 'bad'], 'expected a metrics.json of replay'),
        (['a', 'many'], 'have no log and stamp in common'),
    ):
        names = [str(tmp_path / r) for r in runs]
        assert main(['compare', *names, '--out', str(tmp_path / 'c.html')]) == 2
        assert text in capsys.readouterr().err
    assert not (tmp_path / 'c.html').exists()
