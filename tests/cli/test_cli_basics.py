# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command line itself: help is immediate, mistakes are one line, every result has --json."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import pytest
import yaml

from hybridreg_ros.cli.arguments import build_parser
from hybridreg_ros.cli.main import main

if TYPE_CHECKING:
    from pathlib import Path

COMMANDS = (
    'register',
    'convert',
    'simulate',
    'replay',
    'score',
    'compare',
    'generate',
    'train',
    'evaluate',
    'ship',
    'bench',
    'dump-config',
    'warm-up',
    'echo',
    'demo',
)


def test_help_is_immediate() -> None:
    """The parser costs less than 0.2 s of processor time over a bare interpreter."""
    code = (
        'import time; t = time.process_time(); from hybridreg_ros.cli.main import main;'
        'main(["--help"]); import sys; print(time.process_time() - t, file=sys.stderr)'
    )
    times = []
    for _ in range(3):
        done = subprocess.run(
            [sys.executable, '-c', code], capture_output=True, text=True, check=True
        )
        times.append(float(done.stderr))
        assert all(f'    {name}' in done.stdout for name in COMMANDS)
    assert min(times) < 0.2, times
    started = time.perf_counter()
    subprocess.run(
        [sys.executable, '-m', 'hybridreg_ros.cli.main', '-h'],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    assert time.perf_counter() - started < 3.0


@pytest.mark.parametrize('name', COMMANDS)
def test_every_command_has_help_and_json(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, '--help']) == 0
    text = capsys.readouterr().out
    assert '--json FILE' in text
    assert f'hybridreg {name}' in text


@pytest.mark.parametrize(
    'arguments',
    [
        [],
        ['fly'],
        ['replay'],
        ['replay', 'a.mcap', '--registrar', 'magic'],
        ['replay', 'a.mcap', '--stride', 'x'],
        ['replay', 'a.mcap', '--domain-id', '400'],
        ['convert', 'nuscenes', '.', '--out', 'x'],
        ['simulate', '--scene', 'room'],
        ['generate', 'room-match-rigid', '--pairs', '0', '--out', 'x'],
    ],
)
def test_wrong_command_lines(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert len(captured.err.splitlines()) == 1
    assert re.match(r'hybridreg.*: error: .*--help\)', captured.err)


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['--version']) == 0
    assert re.fullmatch(r'hybridreg \d+\.\d+\.\d+\n', capsys.readouterr().out)


def test_dump_config_is_read_back(capsys: pytest.CaptureFixture[str], tmp_path: object) -> None:
    from pathlib import Path

    assert isinstance(tmp_path, Path)
    assert main(['dump-config', '--json', str(tmp_path / 'c.json')]) == 0
    text = capsys.readouterr().out
    assert yaml.safe_load(text)['/**']['ros__parameters']['registrar'] == 'hybridreg'
    assert '# ' in text
    (tmp_path / 'a.yaml').write_text(text.replace('registrar: hybridreg', 'registrar: kiss-icp'))
    arguments = ['dump-config', '--config', str(tmp_path / 'a.yaml')]
    assert main([*arguments, '--out', str(tmp_path / 'deep' / 'b.yaml')]) == 0
    written = (tmp_path / 'deep' / 'b.yaml').read_text()
    assert written == text.replace('registrar: hybridreg', 'registrar: kiss-icp')


def test_unwritable_output_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['dump-config', '--out', '/proc/nowhere/c.yaml']) == 2
    error = capsys.readouterr().err
    assert error.startswith('hybridreg: error: ')
    assert len(error.splitlines()) == 1


def test_parser_knows_every_body() -> None:
    parser = build_parser()
    choices = next(a.choices for a in parser._actions if isinstance(a.choices, dict))
    assert set(choices) == set(COMMANDS)
    for command in choices.values():
        body = command.get_default('body')
        assert importlib.util.find_spec(f'hybridreg_ros.cli.{body}'), body


def test_json_to_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    """With --json -, nothing but JSON is on standard output."""
    assert main(['dump-config', '--json', '-']) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)
    assert 'voxel_size_m' in said.err


def test_missing_packages_are_found_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    there = importlib.util.find_spec
    bag, out = str(tmp_path / 'gone.mcap'), str(tmp_path / 'o')
    for package, command in {
        'plotly': ['replay', bag],
        'rerun': ['replay', bag, '--rerun', 'live'],
        'imageio_ffmpeg': ['replay', bag, '--video', 'a.mp4'],
        'distributed': ['replay', bag, '--workers', '2'],
        'rclpy': ['demo'],
        'embreex': ['demo'],
        'evo': ['demo'],
        'matplotlib': ['generate', 'room-match-rigid', '--pairs', '1', '--preview'],
    }.items():
        monkeypatch.setattr(
            'hybridreg_ros.core.errors.find_spec',
            lambda n, p=package: None if n == p else there(n),
        )
        assert main([*command, '--out', out]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert re.search(rf"needs .*{package}.*: pip install 'hybridreg_ros\[\w+\]'", line), line
        assert not (tmp_path / 'o').exists()


def test_unknown_option_is_told_by_its_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['replay', 'a.mcap', '--registar', 'kiss-icp']) == 2
    error = capsys.readouterr().err
    assert error.startswith('hybridreg replay: error: unrecognized arguments: --registar')
    assert 'did you mean --registrar? (see hybridreg replay --help)' in error


def test_shell_completion() -> None:
    pytest.importorskip('argcomplete')
    line = 'hybridreg replay --over'
    environment = {
        **os.environ,
        '_ARGCOMPLETE': '1',
        '_ARGCOMPLETE_SUPPRESS_SPACE': '1',
        'COMP_LINE': line,
        'COMP_POINT': str(len(line)),
    }
    command = f'{sys.executable} -m hybridreg_ros.cli.main 8>&1'
    done = subprocess.run(
        ['bash', '-c', command], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == '--overwrite'
