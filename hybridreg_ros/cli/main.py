# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Entry point of the `hybridreg` command: parses, loads the command's body, reports errors."""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import sys
from typing import TYPE_CHECKING

from hybridreg_ros.cli.arguments import build_parser
from hybridreg_ros.core.errors import HybridRegError

if TYPE_CHECKING:
    from collections.abc import Sequence

EXIT_ERROR = 2
EXIT_INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: arguments without the program's name; None takes those of the process.

    Returns:
        0 on success, 2 after an error (one line on stderr), 130 after Ctrl-C.
    """
    parser = build_parser()
    if '_ARGCOMPLETE' in os.environ:  # the shell asks what could come next
        import argcomplete

        argcomplete.autocomplete(parser)
    try:
        args = parser.parse_args(argv)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else EXIT_ERROR
    logging.basicConfig(
        level=logging.INFO if args.verbose else logging.WARNING,
        format='%(levelname)s: %(message)s',
        stream=sys.stderr,
    )
    try:
        # Threads on numpy's small matrices cost a quarter of a registration; before numpy loads.
        os.environ.setdefault('OPENBLAS_NUM_THREADS', str(getattr(args, 'threads', 1)))
        body = importlib.import_module(f'hybridreg_ros.cli.{args.body}')
        args.stdout = sys.stdout
        with contextlib.redirect_stdout(sys.stderr if str(args.json) == '-' else sys.stdout):
            code: int = body.run(args)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        print('hybridreg: interrupted', file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (HybridRegError, OSError, MemoryError) as error:
        text = ' '.join(str(error).split()) or type(error).__name__
        print(f'hybridreg: error: {text}', file=sys.stderr)
        return EXIT_ERROR


if __name__ == '__main__':
    sys.exit(main())
