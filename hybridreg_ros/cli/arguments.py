# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The argument parser of every command; imports nothing heavy, so that --help is immediate."""

from __future__ import annotations

import argparse
from difflib import get_close_matches
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

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; what is unknown is an error of its command, with the option that it resembles."""
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            command: argparse.ArgumentParser = found.parser
            near = get_close_matches(unknown[0].split('=')[0], command._option_string_actions, 1)
            hint = f', did you mean {near[0]}?' if near else ''
            command.error(f'unrecognized arguments: {" ".join(unknown)}{hint}')
        return found


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
        _compare,
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
    parser.set_defaults(body=body, parser=parser)
    parser.add_argument(
        '--json', type=Path, metavar='FILE', help='write the result as JSON (-: print it)'
    )
    parser.add_argument('-v', '--verbose', action='store_true', help='log what is being done')
    return parser


def _weights(p: argparse.ArgumentParser) -> None:
    p.add_argument(
        '--weights', type=Path, metavar='FILE', help='weights file (default: the packaged one)'
    )


def _budget(p: argparse.ArgumentParser) -> None:
    p.add_argument(
        '--max-points',
        type=_number(int, 100, 1e9),
        metavar='N',
        help='maximum number of points per cloud on the finest level (default: full size)',
    )
    p.add_argument(
        '--max-superpoints',
        type=_number(int, 8, 1e9),
        metavar='N',
        help='maximum number of superpoints per cloud (default: full size)',
    )


def _extrinsic(p: argparse.ArgumentParser, text: str) -> None:
    p.add_argument(
        '--extrinsic',
        type=float,
        nargs=7,
        help=text,
        metavar=('X', 'Y', 'Z', 'QX', 'QY', 'QZ', 'QW'),
    )


def _columns(p: argparse.ArgumentParser) -> None:
    p.add_argument(
        '--columns',
        type=_number(int, 3, 64),
        metavar='N',
        help='values per point of .bin files (default: by the values)',
    )


def _dask(p: argparse.ArgumentParser) -> None:
    p.add_argument(
        '--workers', type=COUNT, default=1, metavar='N', help='number of processes (default 1)'
    )
    p.add_argument(
        '--scheduler',
        metavar='tcp://HOST:PORT',
        help='Dask scheduler to use instead of local processes',
    )


def _bag_output(p: argparse.ArgumentParser) -> None:
    p.add_argument(
        '--out', type=Path, required=True, metavar='BAG', help='.mcap or .db3 file, or a directory'
    )
    p.add_argument(
        '--storage', choices=('mcap', 'sqlite3'), help='storage format if BAG is a directory'
    )
    p.add_argument('--overwrite', action='store_true', help='replace an existing bag')


def _register(commands: Commands) -> None:
    p = _command(commands, 'register', 'cmd_register', 'register two clouds')
    p.add_argument('source', type=Path, help='cloud to align: .npy .npz .ply .pcd or .bin')
    p.add_argument('target', type=Path, help='cloud to align it with')
    p.add_argument(
        '--voxel',
        type=POSITIVE,
        metavar='M',
        help='voxel size in metres (default: chosen from the clouds)',
    )
    _columns(p)
    p.add_argument('--no-refine', action='store_true', help='skip the final refinement')
    p.add_argument(
        '--out', type=Path, metavar='FILE', help='write the aligned source (.ply, .pcd)'
    )
    p.add_argument(
        '--html', type=Path, metavar='FILE', help='write a page with both clouds and what moves'
    )
    _weights(p)


def _convert(commands: Commands) -> None:
    p = _command(commands, 'convert', 'cmd_convert', 'convert recorded files to a bag')
    p.add_argument(
        'format', choices=('kitti', 'depth', 'tum', 'clouds'), help='format of the recording'
    )
    p.add_argument('directory', type=Path, metavar='DIR', help='folder with the recording')
    _bag_output(p)
    p.add_argument('--poses', type=Path, metavar='FILE', help='poses (default: poses.txt in DIR)')
    _columns(p)
    p.add_argument(
        '--rate',
        type=POSITIVE,
        default=None,
        metavar='HZ',
        help='frame rate of a recording without times',
    )
    p.add_argument('--stride', type=COUNT, default=1, metavar='N', help='use every N-th frame')
    p.add_argument(
        '--pixel-step',
        type=COUNT,
        default=1,
        metavar='N',
        help='depth images: use every N-th pixel',
    )
    p.add_argument(
        '--max-depth',
        type=POSITIVE,
        default=10.0,
        metavar='M',
        help='depth images: ignore points beyond M metres (default 10)',
    )


def _simulate(commands: Commands) -> None:
    p = _command(
        commands, 'simulate', 'cmd_simulate', 'simulate a scene in which things move, as a bag'
    )
    p.add_argument(
        '--scene',
        choices=('room', 'street'),
        required=True,
        help='kind of scene: depth camera in a room, lidar in a street',
    )
    _bag_output(p)
    p.add_argument(
        '--frames', type=COUNT, default=100, metavar='N', help='number of frames (default 100)'
    )
    p.add_argument('--seed', type=SEED, default=1, metavar='S', help='random seed (default 1)')
    p.add_argument(
        '--rate', type=POSITIVE, default=10.0, metavar='HZ', help='frame rate (default 10)'
    )
    p.add_argument(
        '--moving',
        choices=('none', '10-30', '30-50'),
        default='10-30',
        help='share of moving points in percent (default 10-30)',
    )


def _replay(commands: Commands) -> None:
    p = _command(
        commands, 'replay', 'cmd_replay', 'run the front end on bags and score the result'
    )
    p.add_argument(
        'bags',
        type=Path,
        nargs='*',
        metavar='LOG',
        help='bag (ROS 2: folder, .mcap, .db3; ROS 1: .bag), or folder of clouds or depth images',
    )
    p.add_argument(
        '--out',
        type=Path,
        metavar='DIR',
        help='folder for the results (default out/BAG); several bags get one subfolder each',
    )
    kept = p.add_mutually_exclusive_group()
    kept.add_argument('--overwrite', action='store_true', help='replace earlier results')
    kept.add_argument(
        '--resume', action='store_true', help='keep the results of logs that are finished'
    )
    p.add_argument(
        '--registrar',
        choices=('hybridreg', 'kiss-icp'),
        help='which branch leads (default: as in the config, else hybridreg)',
    )
    p.add_argument('--config', type=Path, metavar='YAML', help='settings (see dump-config)')
    _weights(p)
    p.add_argument('--topic', help='PointCloud2 topic (default: that with most messages)')
    p.add_argument('--truth-topic', help='topic with the true poses (default /ground_truth/odom)')
    _extrinsic(p, 'pose of the sensor in the body of the true poses')
    p.add_argument(
        '--time-unit',
        default='auto',
        help='unit of the per-point times (default auto)',
        choices=('auto', 's', 'ms', 'us', 'ns', 'normalised', 'none'),
    )
    p.add_argument(
        '--time-field',
        default='',
        metavar='NAME',
        help='field with the per-point times (default: the first usable one)',
    )
    p.add_argument('--stride', type=COUNT, default=1, metavar='N', help='use every N-th cloud')
    p.add_argument('--max-frames', type=COUNT, metavar='N', help='stop after N clouds')
    p.add_argument(
        '--start',
        type=_number(float, 0.0, 1e9),
        default=0.0,
        metavar='S',
        help='begin S seconds after the first cloud',
    )
    p.add_argument('--duration', type=POSITIVE, metavar='S', help='end S seconds later')
    p.add_argument('--no-clouds', action='store_true', help='write no clouds to dynamic.mcap')
    p.add_argument(
        '--map',
        type=Path,
        metavar='FILE',
        help='write what stands still as .ply or .pcd, without what other scans saw through',
    )
    p.add_argument('--moving', type=Path, metavar='FILE', help='write what moved as .ply or .pcd')
    p.add_argument(
        '--video',
        type=Path,
        metavar='FILE',
        help='write a .gif, .webp or .mp4 of what the sensor saw, with its moving points',
    )
    p.add_argument(
        '--rerun',
        metavar='live|FILE',
        help='show the run in Rerun while it goes on (live, or the address of a viewer), or '
        'write a .rrd file for it',
    )
    p.add_argument(
        '--no-compare', action='store_true', help='do not run kiss-icp alone on the same clouds'
    )
    p.add_argument('--live', action='store_true', help='play the bag to the real node over DDS')
    p.add_argument(
        '--rate',
        type=SPEED,
        default=0.0,
        metavar='X',
        help='with --live: playback speed, 1 = as recorded, 0 = as fast as the node can (default)',
    )
    p.add_argument(
        '--domain-id', type=_number(int, 0, 232), metavar='N', help='with --live: ROS domain'
    )
    p.add_argument(
        '--timeout',
        type=POSITIVE,
        default=60.0,
        metavar='S',
        help='with --live: give up if the node is silent for S seconds (default 60)',
    )
    _dask(p)
    _suite(p)


def _suite(p: argparse.ArgumentParser) -> None:
    group = p.add_argument_group(
        'benchmark', 'instead of bags: sequences, competing methods and one table'
    )
    group.add_argument(
        '--suite', choices=('all', 'rooms', 'streets', 'real', 'dev'), help='which sequences'
    )
    group.add_argument(
        '--sequences', nargs='+', default=[], metavar='NAME', help='run only these sequences'
    )
    group.add_argument(
        '--methods',
        nargs='+',
        default=[],
        metavar='NAME',
        help='ours, ours-no-mask, ours-no-network, kiss-icp, genz-icp, small-gicp (default: all)',
    )
    group.add_argument(
        '--strides',
        nargs='+',
        type=COUNT,
        default=[],
        metavar='N',
        help='use every N-th frame, once per N given (default 1 2 5 10)',
    )
    group.add_argument(
        '--frames', type=COUNT, metavar='N', help='maximum number of frames per sequence'
    )
    group.add_argument(
        '--data',
        type=Path,
        default=Path('../shared/data'),
        metavar='DIR',
        help='folder of the recordings (default ../shared/data)',
    )
    fit = group.add_mutually_exclusive_group()
    fit.add_argument(
        '--fit',
        type=Path,
        metavar='FILE',
        help='with --suite dev: fit the evidence and the covariance, write FILE',
    )
    fit.add_argument(
        '--fit-confidence',
        type=Path,
        metavar='FILE',
        help='with --suite dev: fit the reported confidence, write FILE',
    )
    group.add_argument(
        '--table-only', action='store_true', help='make the table from the results that exist'
    )


def _score(commands: Commands) -> None:
    p = _command(
        commands, 'score', 'cmd_score', 'compare a trajectory or a bag with the ground truth'
    )
    p.add_argument('estimate', type=Path, metavar='EST', help='TUM or KITTI poses, or a bag')
    p.add_argument('reference', type=Path, metavar='REF', help='TUM or KITTI poses, or a bag')
    p.add_argument('--topic', help='topic of the poses of EST (default /hybridreg/odom)')
    p.add_argument('--ref-topic', help='the same of REF (default /ground_truth/odom)')
    _extrinsic(p, 'pose of the body of EST in that of REF')
    p.add_argument(
        '--tolerance',
        type=POSITIVE,
        default=0.01,
        metavar='S',
        help='maximum difference between matching stamps, seconds (default 0.01)',
    )


def _compare(commands: Commands) -> None:
    p = _command(commands, 'compare', 'cmd_compare', 'compare results of replay frame by frame')
    p.add_argument(
        'runs',
        type=Path,
        nargs='+',
        metavar='RUN',
        help='folders of results, or folders of such folders; the first is the base',
    )
    p.add_argument(
        '--out',
        type=Path,
        default=Path('out/compare.html'),
        metavar='FILE',
        help='page to write (default out/compare.html)',
    )


def _generate(commands: Commands) -> None:
    p = _command(commands, 'generate', 'cmd_generate', 'generate pairs of HybridMatch splits')
    p.add_argument(
        'split',
        help='{room,street}-{match,lomatch}-{rigid,10-30,30-50}, "all" for these twelve (one '
        'folder each in DIR), or {room,street}-{train,recorded}',
    )
    p.add_argument(
        '--part',
        choices=('train', 'val', 'test'),
        default='train',
        help='part whose seeds and number of pairs are used (default train)',
    )
    p.add_argument(
        '--pairs',
        type=COUNT,
        metavar='N',
        help='number of pairs (default: val 100; test 1000, streets 200; train has none)',
    )
    p.add_argument(
        '--seed',
        type=SEED,
        metavar='S',
        help='first scene, instead of that of the part; train lies below 3,000,000, val below '
        '6,000,000, test below 9,000,000',
    )
    p.add_argument('--out', type=Path, required=True, metavar='DIR', help='folder for the pairs')
    p.add_argument(
        '--layout',
        choices=('shards', 'official'),
        default='shards',
        help='format of the files (default shards)',
    )
    p.add_argument('--preview', action='store_true', help='also write a contact sheet')
    _dask(p)


def _train(commands: Commands) -> None:
    p = _command(commands, 'train', 'cmd_train', 'train the network, or resume a run')
    p.add_argument(
        'config', type=Path, metavar='CONFIG', help='settings in YAML, such as config/train.yaml'
    )
    p.add_argument(
        '--out', metavar='DIR', help='run folder (default: as in the config); resumed if it exists'
    )
    p.add_argument(
        '--steps', type=COUNT, metavar='N', help='number of steps, instead of that in the config'
    )


def _ship(commands: Commands) -> None:
    p = _command(
        commands, 'ship', 'cmd_ship', 'make a weights file: fit the confidence and store float16'
    )
    p.add_argument('weights', type=Path, metavar='CHECKPOINT', help='checkpoint of a training run')
    p.add_argument(
        'data', type=Path, nargs='+', metavar='DATA', help='folders of validation pairs'
    )
    p.add_argument('--out', type=Path, required=True, metavar='FILE', help='weights file to write')
    _budget(p)


def _evaluate(commands: Commands) -> None:
    p = _command(
        commands,
        'evaluate',
        'cmd_evaluate',
        'score a registration method on pairs: RR IR FMR RRE RTE',
    )
    p.add_argument(
        'data',
        type=Path,
        nargs='+',
        metavar='DATA',
        help='folders of pairs: shards, 3DMatch, ETH, KITTI, TUM, 7-Scenes, or HybridMatch as '
        'released',
    )
    p.add_argument(
        '--method',
        default='hybridreg',
        metavar='NAME',
        help='hybridreg (default), no-mask, one-attempt, lgr, lgr-no-mask, ransac-N, lgr-top-N; '
        'without a network: fpfh, kiss-matcher (both need the extra bench)',
    )
    p.add_argument('--limit', type=COUNT, metavar='N', help='maximum number of pairs per folder')
    p.add_argument(
        '--keep',
        type=Path,
        metavar='FILE',
        help='file that keeps the score of every pair; the same command resumes from it',
    )
    p.add_argument('--markdown', type=Path, metavar='FILE', help='also write the tables to FILE')
    p.add_argument(
        '--moving',
        action='store_true',
        help='score the mask instead: AUC of moving against static points of labelled '
        'recordings (moving/*.label) and generated pairs',
    )
    p.add_argument(
        '--gap-s',
        type=_number(float, 0.0, 1e3),
        default=0.5,
        metavar='S',
        help='with --moving: time between the scans of a pair (default 0.5)',
    )
    p.add_argument(
        '--attempts',
        type=COUNT,
        metavar='N',
        help='maximum number of attempts at a pair (default: as the weights say)',
    )
    _budget(p)
    _weights(p)
    _dask(p)


def _bench(commands: Commands) -> None:
    p = _command(commands, 'bench', 'cmd_bench', 'measure the time per stage and the peak memory')
    p.add_argument(
        'pair',
        type=Path,
        nargs='*',
        metavar='CLOUD',
        help='source and target (default: a built-in pair)',
    )
    p.add_argument(
        '--repeat', type=COUNT, default=5, metavar='N', help='number of repetitions (default 5)'
    )
    p.add_argument(
        '--threads',
        type=_number(int, 1, 256),
        default=1,
        metavar='N',
        help='number of threads of a matrix product (default 1)',
    )
    p.add_argument(
        '--peers',
        action='store_true',
        help='also measure FPFH + RANSAC and KISS-Matcher (needs the extra bench)',
    )
    p.add_argument(
        '--data',
        action='store_true',
        help='measure how long pairs take to make, compared with ray casting alone',
    )
    p.add_argument(
        '--pairs',
        type=COUNT,
        default=24,
        metavar='N',
        help='with --data: number of pairs per split (default 24)',
    )
    p.add_argument(
        '--step',
        nargs='*',
        metavar='RECORDING',
        help='measure steps of the front end on recordings of the suite, kiss-icp beside '
        '(default: an HDL-64 and a depth camera)',
    )
    p.add_argument(
        '--recordings',
        type=Path,
        default=Path('../shared/data'),
        metavar='DIR',
        help='with --step: folder of the recordings (default ../shared/data)',
    )
    p.add_argument(
        '--scans', type=COUNT, metavar='N', help='with --step: maximum number of scans of each'
    )
    _weights(p)


def _dump_config(commands: Commands) -> None:
    p = _command(commands, 'dump-config', 'cmd_config', 'print every setting with its range')
    p.add_argument('--config', type=Path, metavar='YAML', help='print the values of this file')
    p.add_argument('--out', type=Path, metavar='FILE', help='write to FILE instead of printing')


def _warm_up(commands: Commands) -> None:
    _command(commands, 'warm-up', 'cmd_warm_up', 'compile all kernels in advance')


def _echo(commands: Commands) -> None:
    p = _command(commands, 'echo', 'cmd_echo', 'print the odometry of a running node')
    p.add_argument('--node', default='hybridreg', metavar='NAME', help='with its namespace')
    p.add_argument('--count', type=COUNT, default=0, metavar='N', help='end after N messages')
    p.add_argument('--wait', type=POSITIVE, default=0.0, metavar='S', help='longest silence')


def _demo(commands: Commands) -> None:
    p = _command(commands, 'demo', 'cmd_demo', 'simulate, play to the real node, score and report')
    p.add_argument(
        '--out',
        type=Path,
        default=Path('out/demo'),
        metavar='DIR',
        help='folder for the results (default out/demo)',
    )
    p.add_argument(
        '--frames', type=COUNT, default=60, metavar='N', help='number of frames (default 60)'
    )
    p.add_argument('--seed', type=SEED, default=1, metavar='S', help='random seed (default 1)')
    p.add_argument(
        '--rate',
        type=SPEED,
        default=1.0,
        metavar='X',
        help='playback speed, 1 = as recorded (default)',
    )
    p.add_argument('--domain-id', type=_number(int, 0, 232), metavar='N', help='ROS domain')
    p.add_argument(
        '--bag', type=Path, metavar='BAG', help='use this bag instead of simulating one'
    )
