# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The trained network with parts switched off or replaced, for the tables of the paper."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.model.register import HybridReg

if TYPE_CHECKING:
    from pathlib import Path

RANSAC_SAMPLES = (250, 500, 1000, 2500, 5000)
TOP_PAIRS = (32, 48, 64, 96)

_LGR: dict[str, Any] = {'estimator': 'lgr', 'attempts': 1}
_RANSAC: dict[str, Any] = {'estimator': 'ransac', 'attempts': 1}

VARIANTS: dict[str, dict[str, Any]] = {
    'hybridreg': {},
    'no-mask': {'use_mask': False},
    'one-attempt': {'attempts': 1},
    'lgr': _LGR,
    'lgr-no-mask': {**_LGR, 'use_mask': False},
    **{f'ransac-{n}': {**_RANSAC, 'ransac_samples': n} for n in RANSAC_SAMPLES},
    **{f'lgr-top-{n}': {**_LGR, 'top_pairs': n} for n in TOP_PAIRS},
}
"""What each variant changes in the `ModelConfig` of the weights."""


def load_variant(
    name: str, weights: str | Path | None = None, attempts: int | None = None
) -> HybridReg:
    """The packaged weights, or those of a file, in one of the `VARIANTS`.

    Args:
        name: of the variant.
        weights: checkpoint; None for the packaged one.
        attempts: at most, at a pair; None: as the variant says.

    Raises:
        ConfigError: no such variant.
        WeightsError: missing, truncated, foreign or unfit weights.
    """
    if name not in VARIANTS:
        raise ConfigError(f'method: expected one of {", ".join(VARIANTS)}, found {name}')
    changes = VARIANTS[name] | ({} if attempts is None else {'attempts': attempts})
    model = HybridReg.from_pretrained(weights)
    model.config = dataclasses.replace(model.config, **changes)
    return model
