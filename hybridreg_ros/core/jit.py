# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The one decorator of compiled kernels, and their cache on disk that cannot be stale.

A kernel inlines the kernels that it calls and the constants that it reads, also those of other
modules, while numba looks at the file of the kernel alone. So the folder of the cache carries a
hash of every file that may end up inside a kernel, of numba, numpy and the processor.
"""

from __future__ import annotations

import functools
import hashlib
import logging
import os
import re
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import llvmlite
import llvmlite.binding as llvm
import numba
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

PACKAGE = Path(__file__).resolve().parents[1]
ALL = 'all'
"""Part of the kernels that is every one of them."""
HASH_DIGITS = 16
_IMPORT = re.compile(r'^from (hybridreg_ros[\w.]*) import (\([^)]*\)|[^\n(]+)', re.MULTILINE)
_HAS_KERNELS = re.compile(r'^from hybridreg_ros\.core\.jit import .*\bcompiled', re.MULTILINE)
_FAST = {'reassoc', 'contract', 'nsz'}
_log = logging.getLogger(__name__)


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function: one thread, without Python's lock, floats divide as numpy's do.

    Machine code is kept in `cache_folder()`.
    """
    return _compiled(function, fastmath=False)


def compiled_fast(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `compiled`, but sums may be taken in any order and products fused (vector registers).

    For the network's forward pass, which is compared with torch to a tolerance.
    """
    return _compiled(function, fastmath=_FAST)


def compiled_into(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `compiled_fast`, and part of each kernel that calls it, whose loops may then be vectors.

    For branchless arithmetic that is too long for LLVM to take in by itself.
    """
    return _compiled(function, fastmath=_FAST, forceinline=True)


def compiled_inline(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `compiled`, and part of each kernel that calls it.

    A call hands on each array of what it is given, and a loop with one in it counts references to
    them; either takes longer than a small kernel itself.
    """
    return _compiled(function, fastmath=False, forceinline=True)


def _compiled(function: Callable[..., Any], **flags: Any) -> Callable[..., Any]:
    # numba asks this setting once, as the decorator runs; other users of numba keep theirs.
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_folder())
    try:
        jit = numba.njit(cache=True, nogil=True, error_model='numpy', **flags)
        made: Callable[..., Any] = jit(function)
    finally:
        numba.config.CACHE_DIR = before
    return made


@functools.cache
def cache_folder() -> Path:
    """The folder that holds the machine code of these sources, made when it is missing.

    It lies in `$NUMBA_CACHE_DIR`, else in `$XDG_CACHE_HOME` (`~/.cache`); where neither can be
    written, in the folder for temporary files, with a warning.
    """
    xdg = os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache'
    base = Path(os.environ.get('NUMBA_CACHE_DIR') or xdg) / 'hybridreg_ros'
    spare = Path(tempfile.gettempdir()) / f'hybridreg_ros-{os.getuid()}'
    for folder in (base / _key(), spare / _key()):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            _log.warning(
                'compiled kernels cannot be stored in %s (%s): set NUMBA_CACHE_DIR to a writable '
                'folder',
                folder,
                error.strerror,
            )
            continue
        if os.access(folder, os.W_OK):
            return folder
    return spare


def is_filled(part: str = ALL) -> bool:
    """Whether `mark_filled` was called for a part, or for all, of the sources as they lie here."""
    return any(_mark(name).exists() for name in (part, ALL))


def mark_filled(part: str = ALL) -> None:
    """Note that every kernel of a part was compiled."""
    _mark(part).touch()


def _mark(part: str) -> Path:
    """The note of `mark_filled`; numba drops the code of a file that was written again."""
    times = ' '.join(str(p.stat().st_mtime_ns) for p in kernel_sources())
    key = hashlib.sha256(times.encode()).hexdigest()[:HASH_DIGITS]
    return cache_folder() / f'filled-{part}-{key}'


def kernel_sources() -> list[Path]:
    """Files whose text can end up in machine code: those with kernels and all that they import.

    Imports for type checkers do not count.
    """
    files = {_name(p): p for p in PACKAGE.rglob('*.py')}
    texts = {name: p.read_text(encoding='utf-8') for name, p in files.items()}
    found = {name for name, text in texts.items() if _HAS_KERNELS.search(text)}
    waiting = list(found)
    while waiting:
        new = {m for m in _imported(texts[waiting.pop()]) if m in texts} - found
        found |= new
        waiting += new
    return sorted(files[name] for name in found)


def _key() -> str:
    """Hash of sources and their places, numba, numpy and processor."""
    digest = hashlib.sha256()
    versions = (numba.__version__, llvmlite.__version__, np.__version__)
    for word in (*versions, llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()):
        digest.update(f'{word}\n'.encode())
    for path in kernel_sources():
        digest.update(str(path).encode() + path.read_bytes())
    return digest.hexdigest()[:HASH_DIGITS]


def _name(path: Path) -> str:
    """Dotted name of a module of the package."""
    parts = ('hybridreg_ros', *path.relative_to(PACKAGE).with_suffix('').parts)
    return '.'.join(parts).removesuffix('.__init__')


def _imported(text: str) -> Iterator[str]:
    """Modules of the package, and names in them, that a module imports as it runs."""
    for module, names in _IMPORT.findall(text):
        yield module
        for name in re.findall(r'\w+', names):
            yield f'{module}.{name}'
