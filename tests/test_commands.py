# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Every command of README and guide is run as it stands, or named here with what stands for it."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image
from tiny_bags import room_points, write_room_bag

from hybridreg_ros.cli.arguments import build_parser
from hybridreg_ros.core.config import load_yaml
from hybridreg_ros.data.hybridmatch.shards import encode_pair, write_shard
from hybridreg_ros.data.loaders.clouds import write_cloud
from hybridreg_ros.data.loaders.labelled import Moving
from hybridreg_ros.data.loaders.posed_frames import recorded_pair
from hybridreg_ros.model.checkpoint import packaged_weights
from hybridreg_ros.training.config import TrainConfig

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / 'docs'
# The notebook is left out: what its entries ran stands as it was on their day.
PAGES = [ROOT / 'README.md', ROOT / 'bags' / 'README.md', *sorted(DOCS.rglob('*.md'))]
PAGES = [page for page in PAGES if page.parent != DOCS / 'lab']
ELSEWHERE = {
    'make ': 'CI runs them; hours: make goals',
    'python3 -m venv': 'scripts/setup.sh, which `make test` begins with',
    '. ': 'scripts/setup.sh',
    'pip install': 'scripts/setup.sh',
    'python -m colcon': 'tests/ros/test_colcon.py',
    'hybridreg ship': 'needs right and wrong results; tests/cli/test_cli_ship.py',
    'ros2 ': 'needs an installed ROS 2: .ci/jazzy, tests/ros/test_launch_files.py',
    'bag_player room.mcap --lossless & hybridreg echo': 'stays; tests/ros/test_first_run.py',
}
# What trains or scores for hours, or needs a GPU, is run with less of everything.
SMALLER = (
    (r'--pairs \d+', '--pairs 2'),
    (r'(generate all .*)', r'\1 --pairs 1'),
    (r'(generate room-match-30-50 --part test .*)', r'\1 --pairs 1'),
    (r'--steps \d+', '--steps 2'),
    (r'--limit \d+', '--limit 1'),
    (r'^START=(.*train_gpu.sh) 30', r'DEVICE=cpu VALIDATION=data/val VALIDATED=2 START=\1 0.1'),
    (r'(train_gpu.sh) 4', r'\1 0.1'),
    (r'--suite all', '--suite rooms --sequences room-02 --methods ours --strides 1 --frames 4'),
    (r'--frames 200', '--frames 4'),
)
EXECUTABLES = {
    'hybridreg': 'cli.main',
    'odometry_node': 'ros.odometry_node',
    'bag_player': 'ros.playback.bag_player',
}
GIVEN = """from hybridreg_ros.data.loaders.clouds import read_cloud
points = source = target = read_cloud('a.ply')"""
SETTINGS = [
    text
    for page in PAGES
    for text in re.findall(r'^```yaml\n(.*?)^```', page.read_text('utf-8'), re.M | re.S)
]
STAY = ('odometry_node', 'hybridreg echo')
"""They run until they are stopped; the rest of their block runs beside them."""


def blocks_of(page: Path) -> list[list[str]]:
    """Commands of each fenced block; one of Python is a single one, clouds are given to it."""
    found = []
    for language, text in re.findall(
        r'^```(\w*)\n(.*?)^```', page.read_text('utf-8'), re.M | re.S
    ):
        if language == 'python':
            found.append([f"python - <<'END'\n{GIVEN}\n{text}END"])
        elif language in ('', 'bash'):
            lines = re.sub(r'\s+# .*', '', text).strip()
            # a loop is one command: its lines are indented, its end is `done`
            found.append([c for c in re.split(r'\n(?![ \t]|done)', lines) if c])
    return found


def commands_of(page: Path) -> list[str]:
    return [command for block in blocks_of(page) for command in block]


def runs_here(command: str) -> bool:
    return not command.startswith(tuple(ELSEWHERE))


def test_what_stands_for_a_command_exists() -> None:
    for text in ELSEWHERE.values():
        for name in re.findall(r'(?:tests|scripts|\.ci)/[\w/.]+\w', text):
            assert (ROOT / name).exists(), name
    said = [c for page in PAGES for c in commands_of(page)]
    assert sum(map(runs_here, said)) > 60
    for start in ELSEWHERE:
        assert any(c.startswith(start) for c in said), f'{start} is in no page any more'
    for pattern, _ in SMALLER:
        assert any(re.search(pattern, c) for c in said), f'{pattern} fits no command any more'


def test_commands_are_understood() -> None:
    """Also those that are not run, and what they are replaced by."""
    parser, count = build_parser(), 0
    for command in [c for page in PAGES for c in commands_of(page)]:
        for text in (command, smaller(command)):
            for arguments in re.findall(r'(?:^|& |\n\s+)hybridreg (.*)', text):
                parser.parse_args(shlex.split(arguments))
                count += 1
    assert count > 80


def smaller(command: str) -> str:
    for pattern, replacement in SMALLER:
        command = re.sub(pattern, replacement, command)
    return command


def pair() -> bytes:
    """A pair of a room, as `hybridreg generate` stores it."""
    T = np.eye(4)
    T[0, 3] = 0.1
    rng = np.random.default_rng(0)
    source, target = room_points(rng, 4000), room_points(rng, 4000) + T[:3, 3].astype(np.float32)
    return encode_pair(recorded_pair(source, target, T, 0.1, 'room'))


def fill(folder: Path) -> None:
    """What the commands of the pages find: bags, clouds, recordings, pairs, small settings."""
    shutil.copytree(ROOT / 'scripts', folder / 'scripts')
    shutil.copytree(ROOT / 'config', folder / 'config')
    shutil.copytree(DOCS / 'results', folder / 'docs' / 'results')
    weights = Path('hybridreg_ros', 'model', 'weights')  # the package itself comes from ROOT
    (folder / weights.parent).mkdir(parents=True)
    (folder / weights).symlink_to(ROOT / weights)
    (folder / 'bags').mkdir()
    (folder / 'bags' / 'room.mcap').write_bytes((ROOT / 'bags' / 'room.mcap').read_bytes())
    for name in ('drive.mcap', 'drive', 'recording.mcap'):
        write_room_bag(folder / name, 4, topics=('/lidar/points',))
    for name in ('one.mcap', 'two.db3'):
        write_room_bag(folder / 'logs' / name, 4)
    rng = np.random.default_rng(0)
    # Mixed, since the points of the two pillars alternate: as a .bin file, eight columns.
    points = rng.permutation(room_points(rng, 4000))
    write_cloud(folder / 'a.ply', points)
    write_cloud(folder / 'b.pcd', points + np.float32(0.05))
    for name in ('data/test/room-match-30-50', 'data/test/room-lomatch-30-50', 'REAL...'):
        (folder / name).mkdir(parents=True)
        write_shard(folder / name / '0000.hrs', [pair()])
    (folder / 'runs' / 'stream').mkdir(parents=True)
    for name in ('WEIGHTS', 'runs/stream/last.safetensors'):
        (folder / name).symlink_to(packaged_weights())
    config = folder / 'config' / 'train.yaml'
    few = (('steps: 40000', 'steps: 2'), ('validation_pairs: 72', 'validation_pairs: 2'))
    for much, little in few:
        assert much in config.read_text('utf-8')
        config.write_text(config.read_text('utf-8').replace(much, little), encoding='utf-8')
    fill_recording(folder / 'DIR', points)
    fill_recording(folder / 'RECORDING...', points)
    shim = folder / 'bin' / 'hybridreg'
    shim.parent.mkdir()
    for name, module in EXECUTABLES.items():
        text = f'#!/bin/sh\nexec {sys.executable} -m hybridreg_ros.{module} "$@"\n'
        shim.with_name(name).write_text(text)
        shim.with_name(name).chmod(0o755)


def fill_recording(recorded: Path, points: NDArray[np.float32]) -> None:
    """Four scans and depth images in the layouts of KITTI, TUM, 7-Scenes and of labels."""
    (recorded / 'velodyne').mkdir(parents=True)
    (recorded / 'moving').mkdir()
    rows, columns = np.mgrid[0:48, 0:64]
    listing, truth = [], []
    label = np.where(points[:, 2] > 1.0, Moving.MOVING, Moving.STATIC).astype(np.uint8)
    for k in range(4):
        write_cloud(recorded / 'velodyne' / f'{k:06d}.bin', points)
        label.tofile(recorded / 'moving' / f'{k:06d}.label')
        depth = (2000 + 5 * columns + 3 * rows).astype(np.uint16)
        Image.fromarray(depth).save(recorded / f'frame-{k:06d}.depth.png')
        listing.append(f'{1.0 + 0.1 * k:.1f} frame-{k:06d}.depth.png')
        truth.append(f'{1.0 + 0.1 * k:.1f} 0 0 0 0 0 0 1')
    (recorded / 'depth.txt').write_text('\n'.join(listing))
    (recorded / 'groundtruth.txt').write_text('\n'.join(truth))
    (recorded / 'poses.txt').write_text('1 0 0 0 0 1 0 0 0 0 1 0\n' * 4)
    (recorded / 'times.txt').write_text('0.0\n0.25\n0.5\n0.75\n')
    (recorded / 'camera-intrinsics.txt').write_text('50 0 32\n0 50 24\n0 0 1\n')


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    fill(tmp_path)
    opened = Shell(tmp_path)
    yield opened
    for _, process, _ in opened.staying:  # after a failure
        process.kill()


class Shell:
    """A user's terminals in a folder with what the pages name."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        paths = [str(folder / 'bin'), str(Path(sys.executable).parent), os.environ['PATH']]
        self.environment = {
            **os.environ,
            'PATH': os.pathsep.join(paths),
            'PYTHONPATH': os.pathsep.join([str(ROOT), os.environ.get('PYTHONPATH', '')]),
            'PYTHONUNBUFFERED': '1',
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
            'ROS_DOMAIN_ID': str(os.getpid() % 90 + 10),
        }
        self.staying: list[tuple[str, subprocess.Popen[bytes], Path]] = []

    def run(self, command: str) -> None:
        done = subprocess.run(
            ['bash', '-c', command],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f'{command}\n{done.stdout}\n{done.stderr}'

    def start(self, command: str) -> None:
        """Start what stays, and wait until it has said something."""
        output = self.folder / f'terminal-{len(self.staying)}.txt'
        with output.open('wb') as stream:
            process = subprocess.Popen(
                ['bash', '-c', f'exec {command}'],
                cwd=self.folder,
                env=self.environment,
                stdout=stream,
                stderr=subprocess.STDOUT,
            )
        self.staying.append((command, process, output))
        wanted = re.search(r'points:=(\S+)', command)
        topic = wanted[1] if wanted else '/points'
        said = f'subscribed to {topic}' if command.startswith('odometry_node') else 'hybridreg'
        while said not in output.read_text():
            assert process.poll() is None, f'{command}\n{output.read_text()}'
            time.sleep(0.1)

    def stop(self) -> None:
        """Ctrl-C in every terminal."""
        for _, process, _ in self.staying:
            process.send_signal(signal.SIGINT)
        for command, process, output in self.staying:
            assert process.wait(60) == 0, f'{command}\n{output.read_text()}'
        self.staying.clear()


def with_commands() -> list[Path]:
    return [page for page in PAGES if any(map(runs_here, commands_of(page)))]


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize('page', with_commands(), ids=name_of)
def test_commands_run_as_they_stand(page: Path, shell: Shell) -> None:
    for block in blocks_of(page):
        for command in map(smaller, filter(runs_here, block)):
            made = re.search(r'(?:simulate|generate) .*--out (\S+)', command)
            if made and (there := shell.folder / made[1]).exists():  # from another block
                shutil.rmtree(there) if there.is_dir() else there.unlink()
            if command.startswith(STAY):
                shell.start(command)
            else:
                shell.run(command)
        shell.stop()


@pytest.mark.parametrize('number', range(len(SETTINGS)))
def test_settings_are_accepted(number: int, tmp_path: Path) -> None:
    path = tmp_path / 'train.yaml'
    path.write_text(SETTINGS[number], encoding='utf-8')
    assert load_yaml(TrainConfig, path) != TrainConfig()
