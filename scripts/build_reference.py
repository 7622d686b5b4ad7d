# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Hook of mkdocs: the pages of docs/reference/ that are made from the code.

A page says where with `<!-- generated: NAME -->`; the pages of the Python API are added whole.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import importlib
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mkdocs.structure.files import File

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'hybridreg_ros'
OPTIONS = (
    ('Front end', 'odometry.config', 'OdometryConfig', 'Read by `--config` and by the node.'),
    ('Node', 'ros.node_config', 'NodeConfig', 'Read by `odometry_node` only.'),
    ('Budget', 'model.budget', 'Budget', 'How large a cloud may be within a sequence.'),
    ('Network', 'model.config', 'ModelConfig', 'Stored with the weights.'),
    ('Training', 'training.config', 'TrainConfig', 'Read by `hybridreg train`.'),
)
_MARK = re.compile(r'<!-- generated: (\w+) -->')
_UNITS = (
    ('_m', 'm'),
    ('_s', 's'),
    ('_ns', 'ns'),
    ('_deg', '°'),
    ('_rad', 'rad'),
    ('_hz', 'Hz'),
    ('_voxels', 'voxels'),
    ('_mb', 'MB'),
    ('_minutes', 'min'),
    ('_hours', 'h'),
)


# mkdocs


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Let the package be importable, and the API and the notebook stand in the navigation."""
    sys.path.insert(0, str(ROOT))
    for section in config.nav or []:
        if 'Reference' in section:
            section['Reference'].append({'API': [{n: page_of(n)} for n in packages()]})
        if 'Laboratory' in section:
            entries = sorted(p.name for p in (ROOT / 'docs' / 'lab').glob('2*.md'))
            section['Laboratory'] += [f'lab/{name}' for name in entries]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add one page per folder of the package."""
    for name in packages():
        files.append(File.generated(config, page_of(name), content=api_page(name)))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Put the generated parts into the pages that ask for them."""
    return _MARK.sub(lambda match: GENERATED[match[1]](), markdown)


# the Python API


def packages() -> list[str]:
    """Dotted names of the package and of its folders, outer ones first."""
    found = sorted((ROOT / PACKAGE).rglob('__init__.py'))
    return ['.'.join(p.parent.relative_to(ROOT).parts) for p in found]


def page_of(package: str) -> str:
    """Page of the API of a folder."""
    return f'reference/api/{package}.md'


def modules_in(package: str) -> list[str]:
    """Dotted names of the modules that lie directly in a folder."""
    folder = ROOT.joinpath(*package.split('.'))
    return [f'{package}.{p.stem}' for p in sorted(folder.glob('*.py')) if p.stem != '__init__']


def api_page(package: str) -> str:
    """Markdown of the API of a folder; mkdocstrings fills it in."""
    lines = [f'# {package}', '', Code(package).doc, '']
    for module in modules_in(package):
        lines += [f'## {module}', '', f'::: {module}', '']
    return '\n'.join(lines)


def api_index() -> str:
    """Table of all folders of the package."""
    rows = [
        (f'[{name}](api/{name}.md)', Code(name).doc.split('\n')[0], str(len(modules_in(name))))
        for name in packages()
    ]
    return '## Modules\n\n' + table(('package', 'contents', 'modules'), rows)


# commands


def cli() -> str:
    """Every command of `hybridreg`, and the bag player."""
    arguments = importlib.import_module(f'{PACKAGE}.cli.arguments')
    player = importlib.import_module(f'{PACKAGE}.ros.playback.arguments')
    root = arguments.build_parser()
    commands = next(a for a in root._actions if isinstance(a, argparse._SubParsersAction))
    texts = [command(f'hybridreg {name}', p) for name, p in commands.choices.items()]
    texts.append(command('bag_player', player.parser()))
    texts.append(
        '## odometry_node\n\nTakes `--help`, `--version` and ROS arguments: '
        '`--ros-args -r points:=TOPIC`, `-p NAME:=VALUE`, `--params-file FILE`. See '
        '[ROS interface](ros.md) and [options](options.md).'
    )
    return '\n\n'.join(texts)


def command(title: str, parser: argparse.ArgumentParser) -> str:
    """Section of one command: description, usage, and a table of arguments per group."""
    formatter = argparse.HelpFormatter(prog=title, width=96)
    formatter.add_usage(parser.usage, parser._actions, parser._mutually_exclusive_groups)
    parts = [
        f'## {title.removeprefix("hybridreg ")}',
        cell(parser.description or ''),
        f'```\n{formatter.format_help().strip()}\n```',
    ]
    for group in parser._action_groups:
        rows = [
            argument(action)
            for action in group._group_actions
            if '-h' not in action.option_strings
        ]
        if rows and group.description:
            parts.append(f'**{group.title}**: {group.description}')
        if rows:
            parts.append(table(('argument', 'value', 'default', ''), rows))
    return '\n\n'.join(parts)


def argument(action: argparse.Action) -> tuple[str, str, str, str]:
    """Row of one argument: names, value, default, help."""
    names = ', '.join(f'`{name}`' for name in action.option_strings)
    value = action.metavar if isinstance(action.metavar, str) else action.dest.upper()
    if action.choices is not None:
        value = ' '.join(str(c) for c in action.choices)
    if not action.option_strings:
        names = f'`{action.metavar or action.dest}`'
    takes_none = action.nargs == 0
    empty = action.default is None or action.default in (argparse.SUPPRESS, False, [])
    default = '' if empty or takes_none else f'`{action.default}`'
    if action.required and action.option_strings:
        default = 'required'
    return names, '' if takes_none else f'`{value}`', default, action.help or ''


# options


def options() -> str:
    """Every user option, section by section."""
    parts = []
    for title, module, name, about in OPTIONS:
        config = getattr(importlib.import_module(f'{PACKAGE}.{module}'), name)()
        parts += [f'## {title}', f'`{module}.{name}`. {about}']
        parts += list(sections(config, '', title))
    return '\n\n'.join(parts)


def sections(config: Any, path: str, title: str) -> Iterator[str]:
    """Tables of a config and of its sections."""
    fields = dataclasses.fields(config)
    plain = [f for f in fields if not dataclasses.is_dataclass(getattr(config, f.name))]
    if plain:
        last = ('at run time',) if title == 'Node' else ()
        head = ('option', 'default', 'range', 'unit', 'description', *last)
        yield table(head, [option(f, getattr(config, f.name), path, title) for f in plain])
    for field in fields:
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            anchor = f'{title.replace(" ", "-").lower()}-{path}{field.name}'
            yield f'### {path}{field.name} {{ #{anchor} }}'
            yield sentence(field.metadata['doc'])
            yield from sections(value, f'{path}{field.name}.', title)


def option(field: dataclasses.Field[Any], value: Any, path: str, title: str) -> tuple[str, ...]:
    """Row of one option."""
    doc = field.metadata['doc']
    row = (
        f'`{path}{field.name}`',
        f'`{literal(value)}`',
        limits(field.metadata),
        unit(field.name, doc),
        doc,
    )
    if title != 'Node':
        return row
    fixed = importlib.import_module(f'{PACKAGE}.ros.node_config').RESTART_ONLY
    return (*row, 'no' if field.name in fixed else 'yes')


def limits(meta: Mapping[str, Any]) -> str:
    """Choices or range of an option."""
    low, high = meta.get('low'), meta.get('high')
    if meta.get('choices'):
        return ' '.join(f'`{choice}`' for choice in meta['choices'])
    if low is None and high is None:
        return ''
    if high is None:
        return f'from {low:,.10g}'
    return f'up to {high:,.10g}' if low is None else f'{low:,.10g} to {high:,.10g}'


def literal(value: Any) -> str:
    """A default as it is written in YAML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return str(list(value))
    return "''" if value == '' else str(value)


def unit(name: str, doc: str) -> str:
    """Unit of an option, by the end of its name or by what its description says."""
    if 'degrees/s' in doc:
        return '°/s'
    for end, text in _UNITS:
        if name.endswith(end):
            return text
    for text in ('finest voxels', 'coarse voxels', 'voxels', 'metres', 'seconds', 'm/s', 'points'):
        if re.search(rf'(in|,)( its)? ({text})\b', doc):
            return text
    return 'share' if re.search(r'\bshare\b|\bP\(', doc.split(',', maxsplit=1)[0]) else ''


# the ROS interface


def ros() -> str:
    """Tables of topics and services."""
    topics = importlib.import_module(f'{PACKAGE}.ros.topics')
    config = importlib.import_module(f'{PACKAGE}.ros.node_config')
    rows = [
        (
            'in' if t.received else 'out',
            f'`{t.by_default}`',
            f'`{t.name}`',
            f'`{t.type}`',
            str(t.depth or '`input_qos_depth`'),
            t.doc,
        )
        for t in topics.TOPICS
    ]
    services = [(f'`{s.by_default}`', f'`{s.name}`', s.doc) for s in topics.SERVICES]
    at_run_time = ', '.join(f'`{name}`' for name in config.RUNTIME)
    return '\n\n'.join(
        (
            table(('', 'topic by default', 'name', 'type', 'depth', 'contents'), rows),
            'Services, all of type `std_srvs/srv/Trigger`:',
            table(('service by default', 'name', 'effect'), services),
            f'Of the front-end parameters, {at_run_time} can be changed while the node runs; of '
            'the node parameters, those marked in [their table](options.md#node).',
        )
    )


# file formats


class Code:
    """A module, read without being imported.

    Attributes:
        doc: its docstring.
    """

    def __init__(self, name: str) -> None:
        path = ROOT.joinpath(*name.split('.'))
        self._tree = ast.parse(
            (path / '__init__.py' if path.is_dir() else path.with_suffix('.py')).read_text('utf-8')
        )
        self.doc = ast.get_docstring(self._tree) or ''

    def find(self, name: str) -> Any:
        """Definition of a class or function."""
        kinds = (ast.ClassDef, ast.FunctionDef)
        for node in ast.walk(self._tree):
            if isinstance(node, kinds) and node.name == name:
                return node
        raise LookupError(name)

    def constant(self, name: str) -> Any:
        """Value of a constant."""
        for node in self._tree.body:
            if isinstance(node, ast.Assign) and getattr(node.targets[0], 'id', '') == name:
                return ast.literal_eval(node.value)
        raise LookupError(name)

    def keys(self, function: str) -> list[str]:
        """Keys of the largest dict literal in a function."""
        found = (n for n in ast.walk(self.find(function)) if isinstance(n, ast.Dict))
        largest = max(found, key=lambda n: len(n.keys))
        return [str(k.value) for k in largest.keys if isinstance(k, ast.Constant)]

    def attributes(self, name: str) -> str:
        """Table of the attributes that the docstring of a class describes, with their types."""
        node = self.find(name)
        types = {
            n.target.id: ast.unparse(n.annotation)
            for n in node.body
            if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)
        }
        text = (ast.get_docstring(node) or '').partition('Attributes:\n')[2].partition('\n\n')[0]
        found = re.findall(r'^ {4}(\w+): (.*(?:\n {8}.*)*)', text, re.MULTILINE)
        rows = [(f'`{n}`', f'`{types.get(n, "")}`', ' '.join(t.split())) for n, t in found]
        return table(('field', 'type', ''), rows)


def files() -> str:
    """Formats of the files that commands read and write."""
    return '\n\n'.join((*replay_files(), *pair_files(), *model_files()))


def replay_files() -> Iterator[str]:
    """Bags, folders, and what a replay writes."""
    outputs = Code(f'{PACKAGE}.replay.outputs')
    topics = [outputs.constant(f'{n}_TOPIC') for n in ('ODOM', 'DYNAMIC', 'STATIC', 'PATH')]
    field = outputs.constant('PROBABILITY_FIELD')
    yield '## Clouds'
    yield Code(f'{PACKAGE}.data.loaders.clouds').doc
    yield '## Recordings'
    needs = '../guide/recordings.md#what-a-bag-needs'
    yield f'A rosbag2 directory, `.mcap` or `.db3`: [what a bag needs]({needs}).'
    yield 'Folders that `hybridreg evaluate` recognises, and by which files:'
    signs = importlib.import_module(f'{PACKAGE}.data.loaders.openers')._SIGNS
    yield table(('format', 'sign'), [(what, f'`{sign}`') for what, sign, _ in signs])
    yield '## odometry.tum'
    yield Code(f'{PACKAGE}.replay.trajectory_io').doc
    yield '## dynamic.mcap'
    listed = ', '.join(f'`{t}`' for t in topics)
    yield (
        f'{listed}, as the node publishes them: the clouds keep every field of the input and '
        f'add `{field}` (float32). `/tf` leads from `odom` to the sensor, `/tf_static` from '
        '`upright`, whose z points up, to `odom`, and to `world`, the frame of '
        '`/ground_truth/path` and `/ground_truth/odom`, aligned with the path. `foxglove.json` '
        'beside it is a layout of Foxglove (import from file) that shows all of it.'
    )
    yield '## metrics.json'
    keys = outputs.keys('metrics_of')
    yield 'Keys: ' + ', '.join(f'`{k}`' for k in keys) + '; NaN and infinity are written as null.'
    rows = ', '.join(f'`{k}`' for k in outputs.keys('_frame_row'))
    yield f'Each entry of `per_frame` has {rows} (stamps in ns). `provenance`:'
    yield Code(f'{PACKAGE}.core.provenance').attributes('Provenance')
    yield '## report.html'
    yield 'One page, without network access: paths, errors, confidence, times, frames with masks.'


def pair_files() -> Iterator[str]:
    """Splits of pairs."""
    shards = Code(f'{PACKAGE}.data.hybridmatch.shards')
    yield '## Splits of pairs'
    yield 'A folder with `split.json` and shards `*.hrs`.'
    yield shards.doc
    yield 'A pair holds'
    yield Code(f'{PACKAGE}.data.pair').attributes('PointPair')
    yield '`split.json` holds'
    yield Code(f'{PACKAGE}.data.hybridmatch.splits_summary').attributes('SplitSummary')
    keys = Code(f'{PACKAGE}.data.hybridmatch.splits_files').keys('pack')
    yield '## Splits in the released layout'
    yield Code(f'{PACKAGE}.data.loaders.official').doc
    yield 'With `--layout official` a folder has ' + ', '.join(f'`{k}`' for k in keys) + '.'


def model_files() -> Iterator[str]:
    """Weights, settings and calibration."""
    checkpoint = Code(f'{PACKAGE}.model.checkpoint')
    yield '## Weights'
    yield checkpoint.doc
    keys = ', '.join(f'`{k}`' for k in checkpoint.keys('save_network'))
    kind = checkpoint.constant('FORMAT')
    yield f'Metadata: {keys}, of which `format` is `{kind}` and the others are JSON.'
    yield '## Settings'
    yield (
        'YAML with nested keys, or a ROS parameter file with nested or dotted keys below '
        '`ros__parameters`. `hybridreg dump-config` writes one; [options](options.md) lists '
        'the keys.'
    )
    yield '## calibration.json'
    calibration = Code(f'{PACKAGE}.odometry.selection.calibration')
    yield calibration.doc
    yield calibration.attributes('OdometryCalibration')


# Markdown


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """Table in Markdown."""
    lines = ['| ' + ' | '.join(head) + ' |', '|' + '---|' * len(head)]
    return '\n'.join([*lines, *('| ' + ' | '.join(cell(c) for c in row) + ' |' for row in rows)])


def cell(text: str) -> str:
    """A text that fits a cell of a table."""
    return ' '.join(text.split()).replace('|', '\\|').replace('<', '&lt;')


def sentence(text: str) -> str:
    """A description as a sentence."""
    return text[0].upper() + text[1:] + '.'


GENERATED: dict[str, Callable[[], str]] = {
    'api': api_index,
    'cli': cli,
    'files': files,
    'options': options,
    'ros': ros,
}
