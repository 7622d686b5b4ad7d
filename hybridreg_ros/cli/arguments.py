# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The argument parser of every command; imports nothing heavy, so that --help is immediate."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from collections.abc import Callable

Commands = Any  # argparse's sub-parser action has no public type


class _Parser(argparse.ArgumentParser):
    """Reports a wrong command line in one line."""

    def error(self, message: str) -> NoReturn:
        """Print the message with where help is found, and exit with 2."""
        self.exit(2, f'{self.prog}: error: {message} (see {self.prog} --help)\n')


class _Version(argparse.Action):
    """Prints the installed version."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print(f'hybridreg {version("hybridreg_ros")}')
        parser.exit(0)


def _number(kind: type, low: float, high: float) -> Callable[[str], Any]:
    """Type of an argument that is an int or float within limits, inclusive."""

    def convert(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f'expected {kind.__name__}, found {text!r}') from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f'expected {low:g} to {high:g}, found {value:g}')
        return value

    return convert


COUNT = _number(int, 1, 1e9)
SEED = _number(int, 0, 2**31 - 1)
POSITIVE = _number(float, 1e-9, 1e9)
SPEED = _number(float, 0.0, 1000.0)


def build_parser() -> argparse.ArgumentParser:
    """Parser of `hybridreg` with all its commands."""
    parser = _Parser(
        prog='hybridreg',
        description='Registration and odometry of point clouds in scenes where things move.',
    )
    parser.add_argument('--version', action=_Version, nargs=0, help='print the version')
    commands = parser.add_subparsers(title='commands', metavar='COMMAND', required=True)
    for add in (
        _register,
        _convert,
        _simulate,
        _replay,
        _score,
        _generate,
        _train,
        _ship,
        _evaluate,
        _bench,
        _dump_config,
        _warm_up,
        _echo,
        _demo,
    ):
        add(commands)
    return parser


def _command(commands: Commands, name: str, body: str, text: str) -> argparse.ArgumentParser:
    """Sub-parser with the options that every command has."""
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=text, description=text[0].upper() + text[1:] + '.'
    )
    parser.set_defaults(body=body)
    parser.add_argument('--json', type=Path, metavar='FILE', help='write the result as JSON')
    parser.add_argument('-v', '--verbose', action='store_true', help='log what is being done')
    return parser


def _weights(p: argparse.ArgumentParser) -> None:
    p.add_argument('--weights', type=Path, metavar='FILE', help='checkpoint instead of ours')


def _dask(p: argparse.ArgumentParser) -> None:
    p.add_argument('--workers', type=COUNT, default=1, metavar='N', help='processes (default 1)')
    p.add_argument(
        '--scheduler', metavar='tcp://HOST:PORT', help='Dask scheduler instead of local processes'
    )


def _bag_output(p: argparse.ArgumentParser) -> None:
    p.add_argument(
        '--out', type=Path, required=True, metavar='BAG', help='.mcap or .db3 file, or a directory'
    )
    p.add_argument('--storage', choices=('mcap', 'sqlite3'), help='storage of a directory bag')
    p.add_argument('--overwrite', action='store_true', help='replace an existing bag')


def _register(commands: Commands) -> None:
    p = _command(commands, 'register', 'cmd_register', 'register two clouds')
    p.add_argument('source', type=Path, help='.npy .npz .ply .pcd or .bin')
    p.add_argument('target', type=Path, help='.npy .npz .ply .pcd or .bin')
    p.add_argument(
        '--voxel', type=POSITIVE, metavar='M', help='voxel size (default: by the clouds)'
    )
    p.add_argument('--no-refine', action='store_true', help='leave out the final refinement')
    _weights(p)


def _convert(commands: Commands) -> None:
    p = _command(commands, 'convert', 'cmd_convert', 'turn recorded files into a bag')
    p.add_argument('format', choices=('kitti', 'depth', 'tum'), help='layout of the files')
    p.add_argument('directory', type=Path, metavar='DIR', help='folder with the recording')
    _bag_output(p)
    p.add_argument('--poses', type=Path, metavar='FILE', help='poses (default: poses.txt in DIR)')
    p.add_argument('--rate', type=POSITIVE, default=None, metavar='HZ', help='without times: rate')
    p.add_argument('--stride', type=COUNT, default=1, metavar='N', help='take every n-th frame')
    p.add_argument(
        '--pixel-step', type=COUNT, default=1, metavar='N', help='depth: every n-th pixel'
    )
    p.add_argument(
        '--max-depth', type=POSITIVE, default=10.0, metavar='M', help='depth: far limit'
    )


def _simulate(commands: Commands) -> None:
    p = _command(
        commands, 'simulate', 'cmd_simulate', 'make a procedural dynamic sequence as a bag'
    )
    p.add_argument('--scene', choices=('room', 'street'), required=True)
    _bag_output(p)
    p.add_argument('--frames', type=COUNT, default=100, metavar='N', help='default 100')
    p.add_argument('--seed', type=SEED, default=1, metavar='S', help='default 1')
    p.add_argument('--rate', type=POSITIVE, default=10.0, metavar='HZ', help='default 10')
    p.add_argument(
        '--moving', choices=('none', '10-30', '30-50'), default='10-30',
        help='share of moving points in percent (default 10-30)',
    )  # fmt: skip


def _replay(commands: Commands) -> None:
    p = _command(
        commands, 'replay', 'cmd_replay', 'send bags through the front end and score them'
    )
    p.add_argument('bags', type=Path, nargs='*', metavar='BAG')
    p.add_argument(
        '--out', type=Path, metavar='DIR',
        help='folder of the results (default out/BAG); with several bags one folder each in it',
    )  # fmt: skip
    p.add_argument(
        '--registrar', choices=('hybridreg', 'kiss-icp'),
        help='front end (default: as the config says, else hybridreg)',
    )  # fmt: skip
    p.add_argument('--config', type=Path, metavar='YAML', help='settings, see dump-config')
    _weights(p)
    p.add_argument('--topic', help='PointCloud2 topic, where a bag has several')
    p.add_argument('--truth-topic', help='Odometry topic with true poses')
    p.add_argument('--time-unit', default='auto', help='unit of per-point times (default auto)',
                   choices=('auto', 's', 'ms', 'us', 'ns', 'normalised', 'none'))  # fmt: skip
    p.add_argument('--stride', type=COUNT, default=1, metavar='N', help='take every n-th cloud')
    p.add_argument('--max-frames', type=COUNT, metavar='N', help='stop after n clouds')
    p.add_argument('--no-clouds', action='store_true', help='leave the clouds out of dynamic.mcap')
    p.add_argument('--live', action='store_true', help='through the real node over DDS')
    p.add_argument('--rate', type=SPEED, default=0.0, metavar='X',
                   help='live: speed, 1 = as recorded, 0 = as the node can (default)')  # fmt: skip
    p.add_argument('--domain-id', type=_number(int, 0, 232), metavar='N', help='live: ROS domain')
    p.add_argument('--timeout', type=POSITIVE, default=60.0, metavar='S', help='live: at most')
    _dask(p)
    _suite(p)


def _suite(p: argparse.ArgumentParser) -> None:
    group = p.add_argument_group('benchmark', 'instead of bags: sequences, rivals and one table')
    group.add_argument('--suite', choices=('all', 'rooms', 'streets', 'real', 'dev'))
    group.add_argument('--sequences', nargs='+', default=[], metavar='NAME', help='only these')
    group.add_argument('--methods', nargs='+', default=[], metavar='NAME',
                       help='ours, ours-no-mask, ours-no-network, kiss-icp, genz-icp, '
                       'small-gicp (default all)')  # fmt: skip
    group.add_argument('--strides', nargs='+', type=COUNT, default=[], metavar='N',
                       help='default 1 2 5 10')  # fmt: skip
    group.add_argument('--frames', type=COUNT, metavar='N', help='at most n of each sequence')
    group.add_argument('--data', type=Path, default=Path('../shared/data'), metavar='DIR',
                       help='real recordings (default ../shared/data)')  # fmt: skip
    fit = group.add_mutually_exclusive_group()
    fit.add_argument('--fit', type=Path, metavar='FILE',
                     help='with --suite dev: fit evidence and covariance')  # fmt: skip
    fit.add_argument('--fit-confidence', type=Path, metavar='FILE',
                     help='with --suite dev: fit the confidence that is reported')  # fmt: skip
    group.add_argument('--table-only', action='store_true', help='make the table of what is there')


def _score(commands: Commands) -> None:
    p = _command(commands, 'score', 'cmd_score', 'compare a trajectory or a bag with the truth')
    p.add_argument('estimate', type=Path, metavar='EST', help='TUM or KITTI poses, or a bag')
    p.add_argument('reference', type=Path, metavar='REF', help='TUM or KITTI poses, or a bag')
    p.add_argument('--topic', help='Odometry topic of EST (default /hybridreg/odom)')
    p.add_argument('--ref-topic', help='Odometry topic of REF (default /ground_truth/odom)')
    p.add_argument('--tolerance', type=POSITIVE, default=0.01, metavar='S', help='default 0.01')


def _generate(commands: Commands) -> None:
    p = _command(commands, 'generate', 'cmd_generate', 'generate pairs of HybridMatch splits')
    p.add_argument(
        'split',
        help='{room,street}-{match,lomatch}-{rigid,10-30,30-50}, all for these twelve (one folder '
        'each in DIR), or {room,street}-train',
    )
    p.add_argument('--part', choices=('train', 'val', 'test'), default='train',
                   help='whose seeds and number of pairs (default train)')  # fmt: skip
    p.add_argument('--pairs', type=COUNT, metavar='N',
                   help='default: val 100; test 1000, streets 200; train has none')  # fmt: skip
    p.add_argument(
        '--seed', type=SEED, metavar='S',
        help='first scene instead of that of the part; train lies below 3,000,000, val below '
        '6,000,000, test below 9,000,000',
    )  # fmt: skip
    p.add_argument('--out', type=Path, required=True, metavar='DIR')
    p.add_argument('--layout', choices=('shards', 'official'), default='shards')
    p.add_argument('--preview', action='store_true', help='also write a contact sheet')
    _dask(p)


def _train(commands: Commands) -> None:
    p = _command(commands, 'train', 'cmd_train', 'train the network as a config says, or go on')
    p.add_argument('config', type=Path, metavar='CONFIG', help='YAML, see config/')
    p.add_argument(
        '--out', metavar='DIR', help='run folder (default from the config); resumed if it exists'
    )
    p.add_argument('--steps', type=COUNT, metavar='N', help='instead of the number in the config')


def _ship(commands: Commands) -> None:
    p = _command(commands, 'ship', 'cmd_ship', 'make a weights file: fit the confidence, halve')
    p.add_argument('weights', type=Path, metavar='CHECKPOINT', help='of a training run')
    p.add_argument('data', type=Path, nargs='+', metavar='DATA', help='validation pairs')
    p.add_argument('--out', type=Path, required=True, metavar='FILE')


def _evaluate(commands: Commands) -> None:
    p = _command(
        commands, 'evaluate', 'cmd_evaluate', 'score a method on pairs: RR IR FMR RRE RTE'
    )
    p.add_argument(
        'data', type=Path, nargs='+', metavar='DATA',
        help='folders: shards, 3DMatch, ETH, KITTI, TUM, 7-Scenes, or HybridMatch as released',
    )  # fmt: skip
    p.add_argument('--method', default='hybridreg', metavar='NAME',
                   help='hybridreg; no-mask lgr lgr-no-mask ransac-N lgr-top-N; without a '
                        'network: fpfh kiss-matcher (need the extra bench)')  # fmt: skip
    p.add_argument('--limit', type=COUNT, metavar='N', help='at most n pairs of each')
    p.add_argument('--keep', type=Path, metavar='FILE',
                   help='scores pair by pair; started again with it, goes on')  # fmt: skip
    p.add_argument('--markdown', type=Path, metavar='FILE', help='also write the tables')
    _weights(p)
    _dask(p)


def _bench(commands: Commands) -> None:
    p = _command(commands, 'bench', 'cmd_bench', 'measure milliseconds per stage and peak memory')
    p.add_argument(
        'pair', type=Path, nargs='*', metavar='CLOUD', help='SRC TGT (default built in)'
    )
    p.add_argument('--repeat', type=COUNT, default=5, metavar='N', help='default 5')
    p.add_argument(
        '--threads', type=_number(int, 1, 256), default=1, metavar='N', help='default 1'
    )
    p.add_argument(
        '--peers', action='store_true', help='beside FPFH + RANSAC and KISS-Matcher (extra bench)'
    )
    p.add_argument('--data', action='store_true',
                   help='measure the making of pairs, beside ray casting alone')  # fmt: skip
    p.add_argument('--pairs', type=COUNT, default=24, metavar='N',
                   help='with --data: pairs of each split (default 24)')  # fmt: skip
    _weights(p)


def _dump_config(commands: Commands) -> None:
    p = _command(commands, 'dump-config', 'cmd_config', 'print every setting with its range')
    p.add_argument('--config', type=Path, metavar='YAML', help='show these values')
    p.add_argument('--out', type=Path, metavar='FILE', help='write instead of print')


def _warm_up(commands: Commands) -> None:
    _command(commands, 'warm-up', 'cmd_warm_up', 'compile all kernels, so that no start waits')


def _echo(commands: Commands) -> None:
    p = _command(commands, 'echo', 'cmd_echo', 'print the odometry of a running node')
    p.add_argument('--node', default='hybridreg', metavar='NAME', help='with its namespace')
    p.add_argument('--count', type=COUNT, default=0, metavar='N', help='end after N messages')
    p.add_argument('--wait', type=POSITIVE, default=0.0, metavar='S', help='longest silence')


def _demo(commands: Commands) -> None:
    p = _command(commands, 'demo', 'cmd_demo', 'simulate, play into the real node, score, report')
    p.add_argument('--out', type=Path, default=Path('out/demo'), metavar='DIR')
    p.add_argument('--frames', type=COUNT, default=60, metavar='N', help='default 60')
    p.add_argument('--seed', type=SEED, default=1, metavar='S')
    p.add_argument('--rate', type=SPEED, default=1.0, metavar='X', help='speed, 1 = as recorded')
    p.add_argument('--domain-id', type=_number(int, 0, 232), metavar='N', help='ROS domain')
    p.add_argument('--bag', type=Path, metavar='BAG', help='use this bag instead of simulating')
