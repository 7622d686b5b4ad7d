# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`register`, `generate`, `evaluate`, `train`, `bench`: tiny runs and one-line errors."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tiny_bags import room_points

from hybridreg_ros.cli.main import main
from hybridreg_ros.data.loaders.clouds import read_cloud

if TYPE_CHECKING:
    from pathlib import Path


def failure(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    """The one error line of a command that must fail with exit code 2."""
    capsys.readouterr()
    assert main(arguments) == 2
    lines = [x for x in capsys.readouterr().err.splitlines() if x.startswith('hybridreg')]
    assert len(lines) == 1
    return lines[0]


@pytest.fixture(scope='module')
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A weights file of an untrained network."""
    from hybridreg_ros.model.checkpoint import save_network
    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.model.reference.network import HybridRegNet

    path = tmp_path_factory.mktemp('weights') / 'random.safetensors'
    save_network(path, HybridRegNet(ModelConfig()), {'made by': 'test'})
    return path


def test_register(weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points = room_points(np.random.default_rng(1), 6000)
    np.save(tmp_path / 'a.npy', points)
    np.save(tmp_path / 'b.npy', points + np.float32(0.1))
    arguments = ['register', str(tmp_path / 'a.npy'), str(tmp_path / 'b.npy')]
    result = tmp_path / 'r.json'
    moved = tmp_path / 'out' / 'aligned.ply'
    arguments += ['--weights', str(weights), '--json', str(result), '--out', str(moved)]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert 'T_target_source' in text
    assert 'confidence' in text
    r = json.loads(result.read_text())
    T = np.array(r['T_target_source'])
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6)
    assert 0.0 <= r['confidence'] <= 1.0
    assert {'encode', 'network', 'refine', 'total'} <= set(r['timings_s'])
    np.testing.assert_allclose(read_cloud(moved), points @ T[:3, :3].T + T[:3, 3], atol=1e-5)
    for option, text in (('--out', '.txt: expected a file ending in .ply'),):
        assert text in failure(capsys, [*arguments[:3], option, str(tmp_path / 'a.txt')])


def test_register_refuses(
    weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / 'none.npy', np.zeros((0, 3), np.float32))
    np.save(tmp_path / 'one.npy', np.zeros((1, 3), np.float32))
    np.save(tmp_path / 'nan.npy', np.full((100, 3), np.nan, np.float32))
    for name in ('none', 'one', 'nan'):
        path = str(tmp_path / f'{name}.npy')
        assert 'points' in failure(capsys, ['register', path, path, '--weights', str(weights)])
    path = str(tmp_path / 'one.npy')
    gone = str(tmp_path / 'gone.ply')
    assert 'cannot read cloud' in failure(capsys, ['register', gone, path])
    assert 'expected one of .npy' in failure(capsys, ['register', str(tmp_path / 'a.obj'), path])
    foreign = tmp_path / 'foreign.safetensors'
    foreign.write_bytes(weights.read_bytes()[: weights.stat().st_size // 2])
    for file, data in (
        (tmp_path / 'p.pt', b'\x80\x02}q\x00.'),
        (tmp_path / 'z.pt', b'PK\x03\x04' + bytes(50)),
        (foreign, None),
        (tmp_path / 'gone.safetensors', None),
    ):
        if data is not None:
            file.write_bytes(data)
        line = failure(capsys, ['register', path, path, '--weights', str(file)])
        assert file.name in line


def test_bench(weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for seed in (1, 2):
        np.save(tmp_path / f'{seed}.npy', room_points(np.random.default_rng(seed), 4000))
    result = tmp_path / 'b.json'
    clouds = [str(tmp_path / '1.npy'), str(tmp_path / '2.npy')]
    arguments = ['bench', *clouds, '--repeat', '1', '--weights', str(weights)]
    assert main([*arguments, '--json', str(result)]) == 0
    assert 'peak memory' in capsys.readouterr().out
    stages = json.loads(result.read_text())['stages_s']
    assert set(stages) == {'register', 'step (hybridreg)', 'step (kiss-icp)'}
    assert all(s['total'] for s in stages.values())
    assert 'two clouds or none' in failure(capsys, ['bench', clouds[0]])


def test_evaluate_refuses(
    weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ['evaluate', str(tmp_path / 'gone'), '--weights', str(weights)]
    assert 'no folder of pairs' in failure(capsys, arguments)
    (tmp_path / 'empty').mkdir()
    arguments = ['evaluate', str(tmp_path / 'empty'), '--weights', str(weights)]
    assert 'hybridreg generate' in failure(capsys, arguments)


def test_train_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / 'c.yaml'
    assert 'cannot read config' in failure(capsys, ['train', str(config)])
    config.write_text('stepps: 3')
    assert 'unknown key stepps' in failure(capsys, ['train', str(config)])
    config.write_text(f'data: [{tmp_path / "gone"}]\nvalidation: [{tmp_path / "gone"}]')
    line = failure(capsys, ['train', str(config), '--out', str(tmp_path / 'run')])
    assert 'gone: make one with `hybridreg generate`' in line
    assert not (tmp_path / 'run').exists()


def test_generate_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ['generate', 'room-mach-rigid', '--pairs', '1', '--out', str(tmp_path / 'd')]
    assert 'room-mach-rigid' in failure(capsys, arguments)


@pytest.mark.slow
def test_generate_evaluate_train(
    weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / 'data'
    arguments = ['generate', 'room-match-10-30', '--pairs', '3', '--seed', '40']
    assert main([*arguments, '--out', str(data)]) == 0
    assert (
        main(
            [
                'evaluate',
                str(data),
                '--weights',
                str(weights),
                '--limit',
                '2',
                '--json',
                str(tmp_path / 'e.json'),
                '--markdown',
                str(tmp_path / 'e.md'),
            ]
        )
        == 0
    )
    result = json.loads((tmp_path / 'e.json').read_text())
    assert len(result['scores']) == 2
    assert '| RR %' in (tmp_path / 'e.md').read_text()
    config = tmp_path / 'c.yaml'
    config.write_text(
        f'data: [{data}]\nvalidation: [{data}]\nsteps: 2\nvalidation_pairs: 1\n'
        'validate_every: 2\nworkers: 0\nmax_points: 1500\n'
    )
    run = tmp_path / 'run'
    assert main(['train', str(config), '--out', str(run), '--json', str(tmp_path / 't.json')]) == 0
    assert json.loads((tmp_path / 't.json').read_text())['step'] == 2
    assert 'best validation RR' in capsys.readouterr().out
    assert main(['train', str(config), '--out', str(run), '--steps', '3']) == 0
    assert (run / 'last.safetensors').exists()
