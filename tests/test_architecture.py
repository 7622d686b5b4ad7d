# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The rules of the house: imports go one way, libraries neither print nor exit."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'hybridreg_ros'
FILES = sorted(PACKAGE.rglob('*.py'))
SCRIPTS = sorted((ROOT / 'scripts').glob('*.py'))

ALLOWED = {
    'core': set(),
    'data': {'core'},
    'metrics': {'core'},
    'model': {'core'},
    'odometry': {'core', 'model'},
    'training': {'core', 'data', 'metrics', 'model', 'odometry'},
    'replay': {'core', 'data', 'metrics', 'model', 'odometry'},
    'benchmark': {'core', 'data', 'metrics', 'model', 'odometry', 'replay', 'training'},
    'ros': {'core', 'model', 'odometry'},
    'cli': {
        'core',
        'data',
        'metrics',
        'model',
        'odometry',
        'replay',
        'ros',
        'training',
        'benchmark',
    },
}
EXCEPTIONS = {
    # The bag player is the one executable of ros/ that reads bags.
    ('ros/playback/playing.py', 'replay'),
    # The one writer of cloud files writes the map too.
    ('ros/requests.py', 'data'),
}
LEAVES = 'ros/stop_signals.py'
"""The one module that ends the process: a signal does."""
HOMES = {
    'rclpy': ('ros/',),
    'sensor_msgs': ('ros/',),
    'nav_msgs': ('ros/',),
    'geometry_msgs': ('ros/',),
    'std_srvs': ('ros/',),
    'diagnostic_msgs': ('ros/',),
    'tf2_msgs': ('ros/',),
    'tf2_ros': ('ros/',),
    'rosbags': ('replay/bag_',),
    'mcap': ('replay/bag_',),
    'kiss_icp': ('odometry/registration/kiss.py', 'benchmark/pipelines.py'),
    'torch': ('model/reference/', 'training/'),
    'embreex': ('data/meshes/raycast.py',),
    'evo': ('metrics/trajectory.py',),
}


def name_of(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def imported_modules(tree: ast.AST) -> list[str]:
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, 'relative imports hide the direction'
            found += [f'{node.module}.{alias.name}' for alias in node.names]
    return found


@pytest.mark.parametrize('path', FILES, ids=name_of)
def test_imports_go_one_way(path: Path) -> None:
    name = name_of(path)
    layer = name.split('/')[0]
    tree = ast.parse(path.read_text(encoding='utf-8'))
    for module in imported_modules(tree):
        parts = module.split('.')
        if parts[0] == 'hybridreg_ros' and layer in ALLOWED and len(parts) > 1:
            target = parts[1]
            if target in ALLOWED and target != layer and (name, target) not in EXCEPTIONS:
                assert target in ALLOWED[layer], f'{layer} must not import {target} ({module})'
        homes = HOMES.get(parts[0])
        if homes:
            assert name.startswith(homes), f'{parts[0]} belongs into {homes}, not {name}'


@pytest.mark.parametrize('path', FILES, ids=name_of)
def test_header_docstring_and_manners(path: Path) -> None:
    text = path.read_text(encoding='utf-8')
    assert text.startswith('# SPDX-FileCopyrightText: '), 'SPDX header missing'
    assert text.split('\n')[1] == '# SPDX-License-Identifier: Apache-2.0'
    tree = ast.parse(text)
    assert ast.get_docstring(tree), 'module docstring missing'
    for node in ast.walk(tree):
        if isinstance(node, ast.ExceptHandler):
            kinds = ast.unparse(node.type) if node.type else ''
            assert kinds not in ('', 'Exception', 'BaseException'), f'broad except: {path}'
        if name_of(path).startswith('cli/') or not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        assert called != 'print', f'libraries log, they do not print (line {node.lineno})'
        leaving = called in ('sys.exit', 'exit', 'os._exit') and name_of(path) != LEAVES
        assert not leaving, f'only cli exits ({node.lineno})'


def module_of(path: Path) -> str:
    return '.'.join(('hybridreg_ros', *path.relative_to(PACKAGE).with_suffix('').parts))


def imports_of_modules() -> dict[str, set[str]]:
    """Module to the modules of the package that it imports, for type checkers too."""
    modules = {module_of(p) for p in FILES}
    graph = {}
    for path in FILES:
        names = imported_modules(ast.parse(path.read_text(encoding='utf-8')))
        found = {n if n in modules else n.rpartition('.')[0] for n in names}
        graph[module_of(path)] = (found & modules) - {module_of(path)}
    return graph


def room_of(module: str) -> str:
    """Sub-folder of a layer (model.pose), or a module that stands in the layer itself."""
    return '.'.join(module.split('.')[1:3])


def circle_in(graph: dict[str, set[str]]) -> list[str]:
    """One circle of a graph, empty when there is none."""
    done: set[str] = set()

    def walk(node: str, way: list[str]) -> list[str]:
        if node in way:
            return [*way[way.index(node) :], node]
        if node not in done:
            for after in sorted(graph.get(node, ())):
                if found := walk(after, [*way, node]):
                    return found
            done.add(node)
        return []

    for start in sorted(graph):
        if found := walk(start, []):
            return found
    return []


def test_a_circle_is_found() -> None:
    assert circle_in({'a': {'b'}, 'b': {'c'}, 'c': {'b'}, 'd': set()}) == ['b', 'c', 'b']
    assert circle_in({'a': {'b', 'c'}, 'b': {'c'}, 'c': set()}) == []


def test_no_circles_between_modules() -> None:
    assert circle_in(imports_of_modules()) == []


def test_no_circles_between_sub_folders() -> None:
    rooms: dict[str, set[str]] = {}
    for module, targets in imports_of_modules().items():
        room = room_of(module)
        rooms.setdefault(room, set()).update({room_of(t) for t in targets} - {room})
    assert circle_in(rooms) == []


@pytest.mark.parametrize('folder', sorted({p.parent for p in FILES}), ids=lambda p: p.name)
def test_no_folder_holds_more_than_20_modules(folder: Path) -> None:
    assert len(list(folder.glob('[!_]*.py'))) <= 20


def test_importing_the_package_is_cheap() -> None:
    code = (
        'import sys, hybridreg_ros, hybridreg_ros.cli.main as m; m.build_parser();'
        'heavy = {"torch", "numba", "scipy", "matplotlib", "rclpy", "rosbags", "kiss_icp"};'
        'assert not heavy & set(sys.modules), heavy & set(sys.modules)'
    )
    environment = {k: v for k, v in os.environ.items() if k != 'PYTHONSTARTUP'}
    subprocess.run([sys.executable, '-c', code], check=True, env=environment)
