# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg train`: one run as a config says; started again, it goes on where it stopped."""

from __future__ import annotations

import dataclasses
import logging
from typing import TYPE_CHECKING, Any

from hybridreg_ros.cli.common import write_result
from hybridreg_ros.core.config import load_yaml
from hybridreg_ros.training.config import TrainConfig
from hybridreg_ros.training.loop import train

if TYPE_CHECKING:
    import argparse


def run(args: argparse.Namespace) -> int:
    """Train; under torchrun every process runs this."""
    logging.getLogger('hybridreg_ros').setLevel(logging.INFO)
    logging.getLogger().handlers[0].setLevel(
        logging.INFO
    ) if logging.getLogger().handlers else None
    changes: dict[str, Any] = {
        key: value for key in ('out', 'steps') if (value := getattr(args, key)) is not None
    }
    config = dataclasses.replace(load_yaml(TrainConfig, args.config), **changes)
    progress = train(config)
    print(
        f'{config.out}: {progress.step} steps, {progress.hours:.2f} h, best validation RR '
        f'{progress.best:.3f} at step {progress.best_step}'
    )
    write_result(args, {'out': config.out, **dataclasses.asdict(progress)})
    return 0
