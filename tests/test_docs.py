# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The documentation: builds without a warning, lists every option, and its pages stay short."""

from __future__ import annotations

import dataclasses
import html
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from hybridreg_ros.model.budget import Budget
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.result import Reason
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.topics import SERVICES, TOPICS
from hybridreg_ros.training.config import TrainConfig

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / 'docs'
LARGEST_PAGE = 8000
SHORT = sorted([*(DOCS / 'guide').rglob('*.md'), *(DOCS / 'explanation').rglob('*.md')])
OUTSIDE = [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', ROOT / 'bags' / 'README.md']
CONFIGS = (OdometryConfig(), NodeConfig(), Budget(), ModelConfig(), TrainConfig())


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.fixture(scope='module')
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built strictly."""
    missing = [
        n for n in ('mkdocs', 'material', 'mkdocstrings') if not importlib.util.find_spec(n)
    ]
    if missing:
        pytest.skip(f'{", ".join(missing)} not installed (pip install -e .[docs])')
    folder = tmp_path_factory.mktemp('site')
    command = [sys.executable, '-m', 'mkdocs', 'build', '--strict', '--site-dir', str(folder)]
    path = os.pathsep.join([str(ROOT), os.environ.get('PYTHONPATH', '')])
    environment = {**os.environ, 'NO_MKDOCS_2_WARNING': '1', 'PYTHONPATH': path}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def text_of(page: Path) -> str:
    return html.unescape(re.sub(r'<[^>]+>', '', page.read_text('utf-8')))


def options_of(config: Any, path: str = '') -> Iterator[tuple[str, str]]:
    """Dotted name and description of every option."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from options_of(value, f'{path}{field.name}.')
        else:
            yield path + field.name, field.metadata['doc']


def test_every_option_is_listed_with_its_description(site: Path) -> None:
    text = text_of(site / 'reference' / 'options.html')
    for config in CONFIGS:
        for name, doc in options_of(config):
            assert name in text
            assert ' '.join(doc.replace('`', '').split()) in text, name


def test_every_command_and_topic_is_listed(site: Path) -> None:
    from hybridreg_ros.cli.arguments import build_parser

    commands = text_of(site / 'reference' / 'cli.html')
    usage = build_parser().format_help().partition('commands:')[2]
    for name in re.findall(r'^    ([a-z-]+)', usage, re.MULTILINE):
        assert f'usage: hybridreg {name}' in commands
    assert 'usage: bag_player' in commands
    interface = text_of(site / 'reference' / 'ros.html')
    for item in (*TOPICS, *SERVICES):
        assert item.by_default in interface


def test_every_module_has_its_docstrings_on_a_page(site: Path) -> None:
    pages = {p.stem: p.read_text('utf-8') for p in (site / 'reference' / 'api').glob('*.html')}
    modules = [p for p in (ROOT / 'hybridreg_ros').rglob('*.py') if p.stem != '__init__']
    for path in modules:
        package = '.'.join(path.parent.relative_to(ROOT).parts)
        assert f'id="{package}.{path.stem}"' in pages[package], name_of(path)


def test_nothing_is_left_to_generate(site: Path) -> None:
    for page in site.rglob('*.html'):
        assert '<!-- generated' not in page.read_text('utf-8'), page


@pytest.mark.parametrize('page', SHORT, ids=name_of)
def test_pages_stay_short(page: Path) -> None:
    size = page.stat().st_size
    assert size <= LARGEST_PAGE, f'{size} bytes; move figures to docs/lab or docs/results'


@pytest.mark.parametrize('page', [*SHORT, *OUTSIDE], ids=name_of)
def test_options_that_are_named_exist(page: Path) -> None:
    known = {name for config in CONFIGS for name, _ in options_of(config)}
    sections = '|'.join(sorted({name.partition('.')[0] for name in known if '.' in name}))
    named = set(re.findall(rf'`((?:{sections})\.(?!py`)\w+)[`:]', page.read_text('utf-8')))
    assert named <= known, f'no such options: {named - known}'


def test_each_reason_is_explained_with_what_to_do() -> None:
    rows = (DOCS / 'guide' / 'troubleshooting.md').read_text('utf-8').splitlines()
    told = {
        r: row.split('|')
        for row in rows
        if row.count('|') == 4
        for r in re.findall(r'`(\w+)`', row.split('|')[1])
    }
    for reason in Reason:
        _, _, meaning, remedy, _ = told[reason.value]
        assert meaning.strip(), reason
        assert remedy.strip(), reason


@pytest.mark.parametrize('page', OUTSIDE, ids=name_of)
def test_links_outside_the_site_lead_somewhere(page: Path) -> None:
    for target in re.findall(r'\]\(([^)#\s]+)', page.read_text('utf-8')):
        if not target.startswith('http'):
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize('page', ['guide/faq.md', 'results/features.md'])
def test_tests_that_are_named_exist(page: str) -> None:
    there = {path.stem for path in (ROOT / 'tests').rglob('test_*.py')}
    named = set(re.findall(r'`(?:\w+/)?(test_\w+)(?:\.py)?`', (DOCS / page).read_text('utf-8')))
    assert named
    assert named <= there, named - there


def test_every_lab_entry_is_in_the_index() -> None:
    index = (DOCS / 'lab' / 'index.md').read_text('utf-8')
    for entry in (DOCS / 'lab').glob('2*.md'):
        assert f']({entry.name})' in index
