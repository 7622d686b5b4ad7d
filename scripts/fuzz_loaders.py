# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged files through the loaders of the command line: read, or refused in one line.

Small sound files of every format are cut, overwritten, shuffled and mixed by a seeded generator,
and given to `hybridreg score`, `register` (its network left out), `convert` and `replay`, in this
process. Counted are tracebacks (warnings of numpy included), calls of more than five seconds of
processor time, and
silent successes: exit code 0 with nothing read, with numbers that are not finite, with fewer
points than a cut file announces and no word about it, or with other values than those of the sound
file where the format has checksums. Elsewhere a flipped bit of a coordinate cannot be known.

    python scripts/fuzz_loaders.py --files 10000 --seed 1            # a quarter of an hour
    python scripts/fuzz_loaders.py --files 500 --formats mcap db3    # only these
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import logging
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.cli import cmd_register
from hybridreg_ros.cli.main import main as command
from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.core.pointcloud2 import from_arrays
from hybridreg_ros.data.loaders.clouds import write_cloud
from hybridreg_ros.model.geometry.voxel_size import choose_voxel_size_m
from hybridreg_ros.replay.bag_writer import BagWriter
from hybridreg_ros.replay.outputs import DYNAMIC_TOPIC, ODOM_TOPIC, STATIC_TOPIC
from hybridreg_ros.replay.trajectory_io import tum_row

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

LIMIT_S = 5.0
START_NS = 1_700_000_000_123_456_789
PERIOD_NS = 100_000_000
FRAMES = 3
POINTS = 300
REPLAYED = 10
"""Of so many bags, one also goes through the front end."""
MEMORY = 6 * 2**30
CHECKED = ('checked.mcap', 'cloud.npz')


class Hang(BaseException):
    """A call took longer than the limit."""


@dataclass(frozen=True)
class Outcome:
    """What became of one damaged file.

    Attributes:
        kind: read, refused, traceback, hang or silent.
        text: what was said.
    """

    kind: str
    text: str


def poses() -> list[np.ndarray]:
    """True poses of a few frames."""
    return [se3.exp(np.array([0.1 * i, 0.02 * i, 0, 0, 0, 0.03 * i])) for i in range(FRAMES)]


def room(i: int) -> np.ndarray:
    """(N, 3) points on the walls of a room, seen from frame i."""
    rng = np.random.default_rng(i)
    points = rng.uniform(-4, 4, (POINTS, 3))
    points[np.arange(POINTS), np.arange(POINTS) % 3] = rng.choice([-4, 4], POINTS)
    moved: np.ndarray = se3.apply(se3.inverse(poses()[i]), points)
    return moved.astype(np.float32)


def write_bag(path: Path) -> None:
    """Clouds and poses, as the node publishes them."""
    with BagWriter(path) as bag:
        for i, T in enumerate(poses()):
            stamp = START_NS + i * PERIOD_NS
            label = (np.arange(POINTS) % 9 == 0).astype(np.uint8)
            extra = {'t': np.linspace(0, 0.1, POINTS).astype(np.float32), 'label': label}
            bag.write_odometry(ODOM_TOPIC, stamp, ('odom', 'lidar'), T)
            bag.write_odometry('/ground_truth/odom', stamp, ('world', 'lidar'), T)
            for topic in (DYNAMIC_TOPIC, STATIC_TOPIC):
                bag.write_cloud(topic, stamp, 'lidar', from_arrays(room(i), extra))


def write_checked_mcap(path: Path, source: Path) -> None:
    """The same messages in compressed chunks with checksums."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer

    with source.open('rb') as stream, path.open('wb') as out:
        writer = Writer(out, chunk_size=4096, compression=CompressionType.ZSTD)
        writer.start(profile='ros2')
        channels: dict[str, int] = {}
        for schema, channel, message in make_reader(stream).iter_messages():
            if channel.topic not in channels and schema is not None:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, 'cdr', kind)
            writer.add_message(
                channels[channel.topic], message.log_time, message.data, message.publish_time
            )
        writer.finish()


def text_clouds(folder: Path) -> None:
    """ASCII variants of PLY and PCD, with elements and fields of others."""
    rows = ''.join(f'{x} {y} {z} 1\n' for x, y, z in room(0).tolist())
    (folder / 'text.ply').write_text(
        f'ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int i\n'
        f'element vertex {POINTS}\nproperty float x\nproperty float y\nproperty float z\n'
        f'property uchar label\nend_header\n3 0 1 2\n{rows}'
    )
    (folder / 'text.pcd').write_text(
        f'# .PCD v0.7\nVERSION 0.7\nFIELDS x y z label\nSIZE 4 4 4 1\nTYPE F F F U\n'
        f'COUNT 1 1 1 1\nWIDTH {POINTS}\nHEIGHT 1\nPOINTS {POINTS}\nDATA ascii\n{rows}'
    )
    plain = np.ascontiguousarray(room(0).T).tobytes()
    packed = b''.join(
        bytes([len(plain[i : i + 32]) - 1]) + plain[i : i + 32] for i in range(0, len(plain), 32)
    )
    head = (
        f'FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {POINTS}\nHEIGHT 1\n'
        f'POINTS {POINTS}\nDATA binary_compressed\n'
    )
    sizes = np.array([len(packed), len(plain)], '<u4').tobytes()
    (folder / 'packed.pcd').write_bytes(head.encode() + sizes + packed)


def recordings(folder: Path, rows: list[str]) -> None:
    """Folders that `convert` reads: KITTI, depth images with poses, TUM RGB-D."""
    from PIL import Image

    kitti, depth, tum = (folder / f'as_{kind}' for kind in ('kitti', 'depth', 'tum'))
    for path in (kitti, depth, tum / 'depth'):
        path.mkdir(parents=True)
    (kitti / 'poses.txt').write_text('\n'.join(rows) + '\n')
    (kitti / 'calib.txt').write_text('P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: 1 0 0 0 0 1 0 0 0 0 1 0\n')
    (kitti / 'times.txt').write_text(''.join(f'{0.1 * i:.6f}\n' for i in range(FRAMES)))
    (depth / 'camera-intrinsics.txt').write_text('20 0 8\n0 20 6\n0 0 1\n')
    names = [f'{1e9 + 0.1 * i:.6f}' for i in range(FRAMES)]
    for i, T in enumerate(poses()):
        write_cloud(kitti / f'{i}.bin', room(i))
        image = Image.fromarray(np.full((12, 16), 1000 + 100 * i, np.uint16))
        image.save(depth / f'frame-{i}.depth.png')
        image.save(tum / 'depth' / f'{names[i]}.png')
        np.savetxt(depth / f'frame-{i}.pose.txt', T)
    (tum / 'depth.txt').write_text(''.join(f'{n} depth/{n}.png\n' for n in names))
    (tum / 'groundtruth.txt').write_text(''.join(f'{n} 0 0 0 0 0 0 1\n' for n in names))


def seeds(folder: Path) -> dict[str, list[Path]]:
    """Sound files of every format."""
    for suffix in ('mcap', 'db3'):
        write_bag(folder / f'bag.{suffix}')
    write_checked_mcap(folder / 'checked.mcap', folder / 'bag.mcap')
    write_bag(folder / 'directory')
    for suffix in ('ply', 'pcd', 'bin', 'npy', 'npz'):
        write_cloud(folder / f'cloud.{suffix}', room(0))
    np.column_stack([room(0), np.zeros(POINTS), np.arange(POINTS) % 16]).astype('<f4').tofile(
        folder / 'five.bin'
    )
    np.save(folder / 'columns.npy', room(0).T.astype(np.float64))
    text_clouds(folder)
    lines = [tum_row(START_NS + i * PERIOD_NS, T) for i, T in enumerate(poses())]
    (folder / 'poses.tum').write_text('\n'.join(lines) + '\n')
    rows = [' '.join(f'{v:.9g}' for v in T[:3].ravel()) for T in poses()]
    (folder / 'kitti.txt').write_text('\n'.join(rows) + '\n')
    recordings(folder, rows)
    patterns = {'npy': '*.np[yz]', 'kitti': '*.txt', 'bag': 'directory', 'folder': 'as_*'}
    names = ('mcap', 'db3', 'pcd', 'ply', 'bin', 'npy', 'tum', 'kitti', 'bag', 'folder')
    return {name: sorted(folder.glob(patterns.get(name, f'*.{name}'))) for name in names}


TOKENS = (
    b'nan',
    b'inf',
    b'-inf',
    b'1e400',
    b'',
    b'0',
    b'-1',
    b'99999999999999999999',
    b'x y z',
    b'\x00',
    b'\xff\xfe',
    b'1700000000123456789',
    b'\n',
    b'#',
)


def damaged(data: bytes, rng: np.random.Generator, others: list[bytes]) -> tuple[bytes, bool]:
    """Damaged bytes, and whether they are just cut."""
    kind = rng.integers(9)
    out = bytearray(data)
    n = max(len(out), 1)
    place = int(rng.integers(n))
    size = min(int(rng.integers(1, 2 + n // 3)), n - place)
    if kind == 0:
        return bytes(out[:place]), True
    if kind == 1:
        for k in rng.integers(n, size=int(rng.integers(1, 9))):
            out[k] ^= 1 << int(rng.integers(8))
    elif kind == 2:
        out[place : place + size] = bytes([int(rng.choice([0, 255, 127]))]) * size
    elif kind == 3:
        out[place : place + size] = rng.bytes(size)
    elif kind == 4:
        del out[place : place + size]
    elif kind == 5:
        out[place:place] = out[place : place + size]
    elif kind == 6:
        out[place:place] = rng.bytes(int(rng.integers(1, 64)))
    elif kind == 7:
        other = others[int(rng.integers(len(others)))]
        out[place:] = other[min(place, len(other)) :]
    else:
        words = bytes(out[:4000]).split(b' ')
        for k in rng.integers(len(words), size=int(rng.integers(1, 4))):
            words[int(k)] = TOKENS[int(rng.integers(len(TOKENS)))]
        out[:4000] = b' '.join(words)
    if rng.random() < 0.2:
        return damaged(bytes(out), rng, others)
    return bytes(out), False


class StandIn:
    """In the place of the network: checks what `register` checks first, and counts."""

    points = 0
    digest = ''

    @classmethod
    def from_pretrained(cls, _: Any) -> StandIn:
        """No weights."""
        return cls()

    def register(self, source: np.ndarray, target: np.ndarray, voxel_m: float | None) -> Any:
        """What the command prints, of no registration."""
        sizes = [int(np.isfinite(c).all(axis=1).sum()) for c in (source, target)]
        if min(sizes) < 3:
            raise RegistrationError(f'{min(sizes)} points: expected at least 3')
        voxel = choose_voxel_size_m(source, target) if voxel_m is None else voxel_m
        StandIn.points = sizes[0]
        StandIn.digest = hashlib.sha256(source.tobytes()).hexdigest()
        return SimpleNamespace(
            T_target_source=np.eye(4),
            T_lgr=np.eye(4),
            confidence=0.0,
            inliers=0,
            correspondences=(),
            voxel_size_m=voxel,
            source_uncertainty=np.zeros(1),
            target_uncertainty=np.zeros(1),
            timings_s={},
            attempts=1,
        )


class Fuzzer:
    """Runs the commands on damaged files in a folder of its own."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder = folder
        self.sound = folder / 'sound'
        self.sound.mkdir()
        self.files = seeds(self.sound)
        self.rng = np.random.default_rng(seed)
        self.others = [f.read_bytes() for fs in self.files.values() for f in fs if f.is_file()]
        self.source = self.sound
        self.truth: dict[tuple[str, str], Any] = {}
        self.log = io.StringIO()
        logging.basicConfig(level=logging.WARNING, stream=self.log, force=True)

    def make(self, name: str) -> tuple[Path, bool]:
        """A damaged file or directory of a format, and whether it is just cut."""
        files = self.files[name]
        source = files[int(self.rng.integers(len(files)))]
        self.source = source
        path = self.folder / (source.name if source.is_dir() else f'fuzzed{source.suffix}')
        shutil.rmtree(path, ignore_errors=True)
        path.unlink(missing_ok=True)
        if not source.is_dir():
            data, cut = damaged(source.read_bytes(), self.rng, self.others)
            path.write_bytes(data)
            return path, cut
        shutil.copytree(source, path)
        members = sorted(p for p in path.rglob('*') if p.is_file())
        member = members[int(self.rng.integers(len(members)))]
        if self.rng.random() < 0.1:
            member.unlink()
            return path, False
        member.write_bytes(damaged(member.read_bytes(), self.rng, self.others)[0])
        return path, False

    def commands(self, name: str, path: Path, every: bool = False) -> Iterator[list[str]]:
        """Command lines that read a file of a format; `every` leaves none to chance."""
        out = self.folder / 'out'
        shutil.rmtree(out, ignore_errors=True)
        truth = str(self.sound / 'poses.tum')
        if name in ('mcap', 'db3', 'bag'):
            yield ['score', str(path), truth]
            if every or self.rng.integers(REPLAYED) == 0:
                yield [
                    'replay',
                    str(path),
                    '--registrar',
                    'kiss-icp',
                    '--topic',
                    STATIC_TOPIC,
                    '--out',
                    str(out),
                    '--no-clouds',
                ]
        elif name == 'tum':
            yield ['score', str(path), truth, '--tolerance', '1']
            yield ['score', truth, str(path)]
        elif name == 'kitti':
            yield ['score', str(path), str(self.sound / 'kitti.txt')]
        elif name == 'folder':
            yield [
                'convert',
                path.name.removeprefix('as_'),
                str(path),
                '--overwrite',
                '--out',
                str(self.folder / 'k.mcap'),
            ]
        else:
            yield ['register', str(path), str(self.sound / 'cloud.npy')]
        if name == 'bin':
            shutil.rmtree(self.folder / 'k', ignore_errors=True)
            (self.folder / 'k').mkdir()
            shutil.copy(path, self.folder / 'k' / '0.bin')
            yield [
                'convert',
                'kitti',
                str(self.folder / 'k'),
                '--overwrite',
                '--out',
                str(self.folder / 'k.mcap'),
            ]

    def check_sound(self, name: str, path: Path) -> None:
        """A sound file must be read; this also compiles and imports what the others need.

        Raises:
            RuntimeError: it is not.
        """
        for arguments in self.commands(name, path, every=True):
            self.source = path
            outcome = self.run(arguments, cut=True, limit_s=300.0)
            if outcome.kind != 'read':
                raise RuntimeError(f'{path.name}, a sound file, is {outcome.kind}: {outcome.text}')

    def run(self, arguments: list[str], cut: bool, limit_s: float = LIMIT_S) -> Outcome:
        """One call of the command."""
        result = self.folder / 'result.json'
        result.unlink(missing_ok=True)
        out, err = io.StringIO(), io.StringIO()
        self.log.seek(0)
        self.log.truncate()
        StandIn.points, StandIn.digest = 0, ''
        began = time.process_time()
        try:
            signal.setitimer(signal.ITIMER_PROF, limit_s)
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                code = command([*arguments, '--json', str(result)])
        except Hang:
            return Outcome('hang', traceback.format_exc(limit=-6))
        except BaseException:  # whatever escapes is what is looked for
            return Outcome('traceback', traceback.format_exc())
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
        said = err.getvalue() + self.log.getvalue()
        if 'Traceback' in said:
            return Outcome('traceback', said)
        if code != 0:
            lines = [x for x in err.getvalue().splitlines() if x.startswith('hybridreg')]
            return Outcome('refused' if lines else 'silent', said)
        if time.process_time() - began > limit_s:
            return Outcome('hang', said)
        why = self.unsound(arguments, result, bool(said), cut)
        return Outcome('silent', f'{why}\n{said}') if why else Outcome('read', said)

    def unsound(self, arguments: list[str], result: Path, said: bool, cut: bool) -> str:
        """What is wrong with a success, '' for nothing."""
        found = json.loads(result.read_text())
        checked = self.source.name in CHECKED and arguments[0] in ('register', 'score')
        values = (found, StandIn.digest)
        if checked and values != self.truth.setdefault((self.source.name, arguments[0]), values):
            return '' if said else 'other values than the sound file'
        if arguments[0] == 'register':
            announced = Path(arguments[1]).suffix in ('.ply', '.pcd', '.npy', '.npz')
            if cut and announced and not said and StandIn.points < POINTS:
                return f'cut, {StandIn.points} points read'
            return '' if StandIn.points else 'no points read'
        if arguments[0] == 'convert':
            return '' if found['clouds'] else 'no clouds converted'
        if arguments[0] == 'replay':
            return '' if found['accepted'] else 'no cloud accepted'
        score = found['trajectory']
        if not score['matched'] or score['ate_rmse_m'] is None:
            return f'scores are not finite: {score}'
        if (
            cut
            and not said
            and score['matched'] < FRAMES
            and arguments[1].endswith(('cap', 'db3'))
        ):
            return f'cut, {score["matched"]} poses read'
        return ''


def stop(*_: object) -> None:
    """The alarm has gone off."""
    raise Hang


def fuzz(
    count: int,
    seed: int,
    formats: list[str],
    keep: Path | None,
    tick: Callable[[int], None] = lambda _: None,
) -> tuple[dict[str, Counter[str]], list[str]]:
    """Outcomes by format, and a text about each that must not be.

    Args:
        count: damaged files.
        seed: of the generator.
        formats: which; empty = all.
        keep: folder for the files with bad outcomes.
        tick: called with the number of each file.
    """
    counts: dict[str, Counter[str]] = {}
    bad: list[str] = []
    vars(cmd_register)['HybridReg'] = StandIn
    signal.signal(signal.SIGPROF, stop)
    with tempfile.TemporaryDirectory() as scratch, warnings.catch_warnings():
        warnings.simplefilter('error', RuntimeWarning)
        fuzzer = Fuzzer(Path(scratch), seed)
        names = formats or list(fuzzer.files)
        for name in names:
            for path in fuzzer.files[name]:
                fuzzer.check_sound(name, path)
        for number in range(count):
            name = names[number % len(names)]
            path, cut = fuzzer.make(name)
            for arguments in fuzzer.commands(name, path):
                outcome = fuzzer.run(arguments, cut)
                counts.setdefault(name, Counter())[outcome.kind] += 1
                if outcome.kind not in ('read', 'refused'):
                    bad.append(f'{number} {name} {arguments[0]}: {outcome.kind}\n{outcome.text}')
                    if keep is not None:
                        keep.mkdir(parents=True, exist_ok=True)
                        target = keep / f'{number}{path.suffix or "_bag"}'
                        (shutil.copytree if path.is_dir() else shutil.copy)(path, target)
            tick(number)
    return counts, bad


def main(argv: list[str] | None = None) -> int:
    """Fuzz and print a table; exit code 1 when something was found."""
    p = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    p.add_argument('--files', type=int, default=2000, metavar='N')
    p.add_argument('--seed', type=int, default=1, metavar='S')
    p.add_argument('--formats', nargs='+', default=[], metavar='NAME')
    p.add_argument('--keep', type=Path, metavar='DIR', help='keep the files with bad outcomes')
    args = p.parse_args(argv)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.RLIM_INFINITY))
    counts, bad = fuzz(args.files, args.seed, args.formats, args.keep)
    kinds = ('read', 'refused', 'traceback', 'hang', 'silent')
    print('format   calls  ' + '  '.join(f'{kind:>9}' for kind in kinds))
    for name, found in counts.items():
        row = '  '.join(f'{found[kind]:>9}' for kind in kinds)
        print(f'{name:<8} {found.total():>5}  {row}')
    for text in bad:
        print(f'\n{text}')
    return 1 if bad else 0


if __name__ == '__main__':
    sys.exit(main())
