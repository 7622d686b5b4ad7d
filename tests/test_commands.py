# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Every command of README and guide is run as it stands, or named here with what stands for it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tiny_bags import room_points, write_room_bag

from hybridreg_ros.data.loaders.clouds import write_cloud

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    ROOT / 'README.md',
    ROOT / 'bags' / 'README.md',
    *sorted((ROOT / 'docs' / 'guide').glob('*.md')),
]
ELSEWHERE = {
    'make ': 'CI runs them',
    'python3 -m venv': 'scripts/setup.sh, which `make test` begins with',
    '. ': 'scripts/setup.sh',
    'pip install': 'scripts/setup.sh',
    'python -m colcon': 'tests/ros/test_colcon.py',
    'ros2 ': 'needs an installed ROS 2; tests/ros/test_launch_files.py has the launch files',
    'odometry_node': 'tests/ros/test_first_run.py, test_launch_files.py',
    'bag_player': 'tests/ros/test_bag_player.py',
    'hybridreg echo': 'tests/ros/test_echo.py',
    'hybridreg warm-up': 'takes minutes; tests/odometry/test_warm_up.py',
    'hybridreg generate': 'takes hours; tests/cli/test_cli_data.py',
    'hybridreg train': 'takes hours; tests/training/test_loop.py',
    'hybridreg evaluate': 'needs the above; tests/cli/test_cli_model.py',
    'hybridreg ship': 'needs the above; tests/cli/test_cli_ship.py',
    'START=': 'needs a GPU',
    'DEVICE=': 'takes minutes; tests/training',
    'python scripts/ablation.py': 'takes hours; tests/training/test_ablation.py',
    'export FASTRTPS': 'needs an installed ROS 2; tests/ros/test_quality_of_service.py',
}


def commands_of(page: Path) -> list[str]:
    """Commands of the fenced blocks without a language or of bash, comments left out."""
    blocks = re.findall(r'^```(\w*)\n(.*?)^```', page.read_text('utf-8'), re.M | re.S)
    shell = [text for language, text in blocks if language in ('', 'bash')]
    lines = [re.sub(r'\s+# .*', '', line).strip() for b in shell for line in b.splitlines()]
    return [line for line in lines if line]


def runs_here(command: str) -> bool:
    return not command.startswith(tuple(ELSEWHERE))


def test_what_stands_for_a_command_exists() -> None:
    for text in ELSEWHERE.values():
        for name in re.findall(r'(?:tests|scripts)/[\w/.]+\w', text):
            assert (ROOT / name).exists(), name
    said = [c for page in PAGES for c in commands_of(page)]
    assert sum(map(runs_here, said)) > 15
    for start in ELSEWHERE:
        assert any(c.startswith(start) for c in said), f'{start} is in no page any more'


def fill(folder: Path) -> None:
    """What the commands of the pages find: bags, clouds, folders of recorded files."""
    (folder / 'bags').mkdir()
    (folder / 'bags' / 'room.mcap').write_bytes((ROOT / 'bags' / 'room.mcap').read_bytes())
    (folder / 'logs').mkdir()
    for name in ('drive.mcap', 'drive', 'logs/one.mcap', 'logs/two.db3'):
        write_room_bag(folder / name, 4)
    points = room_points(np.random.default_rng(0), 4000)
    write_cloud(folder / 'a.ply', points)
    write_cloud(folder / 'b.pcd', points + np.float32(0.05))
    recorded = folder / 'DIR'
    (recorded / 'velodyne').mkdir(parents=True)
    rows, columns = np.mgrid[0:48, 0:64]
    listing, truth = [], []
    for k in range(4):
        write_cloud(recorded / 'velodyne' / f'{k:06d}.bin', points)
        depth = (2000 + 5 * columns + 3 * rows).astype(np.uint16)
        Image.fromarray(depth).save(recorded / f'frame-{k:06d}.depth.png')
        listing.append(f'{1.0 + 0.1 * k:.1f} frame-{k:06d}.depth.png')
        truth.append(f'{1.0 + 0.1 * k:.1f} 0 0 0 0 0 0 1')
    (recorded / 'depth.txt').write_text('\n'.join(listing))
    (recorded / 'groundtruth.txt').write_text('\n'.join(truth))
    (recorded / 'poses.txt').write_text('1 0 0 0 0 1 0 0 0 0 1 0\n' * 4)
    (recorded / 'camera-intrinsics.txt').write_text('50 0 32\n0 50 24\n0 0 1\n')
    shim = folder / 'bin' / 'hybridreg'
    shim.parent.mkdir()
    shim.write_text(f'#!/bin/sh\nexec {sys.executable} -m hybridreg_ros.cli.main "$@"\n')
    shim.chmod(0o755)
    (folder / 'scripts').symlink_to(ROOT / 'scripts')


def with_commands() -> list[Path]:
    return [page for page in PAGES if any(map(runs_here, commands_of(page)))]


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize('page', with_commands(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_commands_run_as_they_stand(page: Path, tmp_path: Path) -> None:
    fill(tmp_path)
    paths = [str(tmp_path / 'bin'), str(Path(sys.executable).parent), os.environ['PATH']]
    environment = {
        **os.environ,
        'PATH': os.pathsep.join(paths),
        'PYTHONPATH': os.pathsep.join([str(ROOT), os.environ.get('PYTHONPATH', '')]),
    }
    for command in filter(runs_here, commands_of(page)):
        made = re.search(r'simulate .*--out (\S+)', command)
        if made:  # some pages make the same bag twice
            (tmp_path / made[1]).unlink(missing_ok=True)
        done = subprocess.run(
            ['bash', '-c', command],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f'{command}\n{done.stdout}\n{done.stderr}'
