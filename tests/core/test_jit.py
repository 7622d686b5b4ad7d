# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels: their cache follows every source that can end up inside them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from typing import Any

import numba
import pytest

from hybridreg_ros.core import jit

PLANES = """
import numpy as np
from hybridreg_ros.model.geometry.normals import surface_normals
points = np.random.default_rng(0).random((40, 3)).astype(np.float32)
near = np.tile(np.arange(40, dtype=np.int32), (40, 1))
print(int((np.abs(surface_normals(points, near)).max(axis=1) > 0.0).sum()))
"""


def run(tmp_path, code):
    environment = dict(
        os.environ, PYTHONPATH=str(tmp_path), NUMBA_CACHE_DIR=str(tmp_path.parent / 'c')
    )
    command = [sys.executable, '-c', code]
    done = subprocess.run(
        command, env=environment, check=True, capture_output=True, text=True, cwd=tmp_path
    )
    return done.stdout.strip()


def test_a_changed_constant_of_an_inlined_kernel_is_seen_at_once(tmp_path):
    shutil.copytree(
        jit.PACKAGE, tmp_path / 'hybridreg_ros', ignore=shutil.ignore_patterns('__pycache__')
    )
    assert run(tmp_path, PLANES) == '40'
    inlined = tmp_path / 'hybridreg_ros' / 'core' / 'eigen.py'
    text = inlined.read_text('utf-8')
    assert text.count('p < 1e-15') == 1
    inlined.write_text(text.replace('p < 1e-15', 'p < 1e15'), 'utf-8')
    assert run(tmp_path, PLANES) == '0'


def test_sources_hold_kernels_and_what_they_import_but_not_the_rest():
    names = {p.relative_to(jit.PACKAGE).as_posix() for p in jit.kernel_sources()}
    assert {'core/eigen.py', 'odometry/map/planes.py', 'odometry/map/voxel_map.py'} <= names
    assert not any(n.startswith(('ros/', 'replay/', 'cli/', 'data/')) for n in names)
    with_kernels = {
        p.relative_to(jit.PACKAGE).as_posix()
        for p in jit.PACKAGE.rglob('*.py')
        if '\n@compiled\n' in p.read_text('utf-8')
    }
    assert with_kernels <= names


def test_other_users_of_numba_keep_their_cache():
    before = numba.config.CACHE_DIR

    @jit.compiled
    def twice(x):
        return 2 * x

    assert twice(4) == 8
    assert before == numba.config.CACHE_DIR
    cache: Any = twice
    assert cache._cache.cache_path.startswith(str(jit.cache_folder()))


@pytest.mark.skipif(os.geteuid() == 0, reason='root may write everywhere')
def test_a_folder_that_cannot_be_written_is_replaced_with_a_warning(tmp_path, monkeypatch, caplog):
    (tmp_path / 'closed').mkdir(mode=0o500)
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'closed'))
    jit.cache_folder.cache_clear()
    try:
        assert not str(jit.cache_folder()).startswith(str(tmp_path))
        assert 'NUMBA_CACHE_DIR' in caplog.text
    finally:
        jit.cache_folder.cache_clear()


def test_a_file_in_the_way_of_the_folder_is_named_in_a_warning(tmp_path, monkeypatch, caplog):
    (tmp_path / 'taken').write_text('')
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'taken'))
    jit.cache_folder.cache_clear()
    try:
        assert jit.cache_folder().is_dir()
        assert 'NUMBA_CACHE_DIR' in caplog.text
    finally:
        jit.cache_folder.cache_clear()


def test_a_file_written_again_or_elsewhere_is_not_taken_for_compiled(tmp_path):
    copies = [tmp_path / name / 'hybridreg_ros' for name in ('one', 'two')]
    for copy in copies:
        shutil.copytree(jit.PACKAGE, copy, ignore=shutil.ignore_patterns('__pycache__'))
    ask = 'from hybridreg_ros.core import jit; print(jit.is_filled())'
    fill = 'from hybridreg_ros.core import jit; jit.mark_filled()'
    for name, code, expected in (
        ('one', ask, 'False'),
        ('one', fill, ''),
        ('one', ask, 'True'),
        ('two', ask, 'False'),
    ):
        assert run(tmp_path / name, code) == expected
    os.utime(copies[0] / 'core' / 'eigen.py', (1.0, 1.0))
    assert run(tmp_path / 'one', ask) == 'False'


def test_a_part_that_was_compiled_is_not_the_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(jit, 'cache_folder', lambda: tmp_path)
    jit.mark_filled('a part')
    assert [jit.is_filled(part) for part in ('a part', 'another', jit.ALL)] == [True, False, False]
    jit.mark_filled()
    assert jit.is_filled('another')
