# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Weights files: one safetensors file with config, provenance and calibration in its metadata.

Files are loaded strictly and never unpickled.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from hybridreg_ros.core.config import from_dict, to_dict
from hybridreg_ros.core.errors import ConfigError, WeightsError
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.network.packed import Weights, packed
from hybridreg_ros.model.pose.confidence import PairCalibration

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from hybridreg_ros.model.reference.network import HybridRegNet

FORMAT = 'hybridreg-weights-1'
_PICKLE_STARTS = (b'PK\x03\x04', b'\x80')


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """The weights of a network and what their file says about them.

    Attributes:
        config: sizes of the network.
        parameters: by name, as they are stored.
        weights: the same, packed for the compiled functions, float32.
        calibration: logistic model of the confidence.
        provenance: how the weights were made, plain values.
    """

    config: ModelConfig
    parameters: Mapping[str, NDArray[Any]]
    weights: Weights
    calibration: PairCalibration
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def network(self) -> HybridRegNet:
        """The network as a torch module, in evaluation mode, on the CPU, float32."""
        from hybridreg_ros.model.reference.network import HybridRegNet

        return HybridRegNet.of(self.config, self.parameters)


def save_network(
    path: str | Path,
    network: HybridRegNet,
    provenance: Mapping[str, Any],
    calibration: PairCalibration | None = None,
    half: bool = False,
) -> None:
    """Write a weights file.

    Args:
        path: file to write.
        network: its parameters and its config are stored.
        provenance: plain values (data version, seeds, steps, hours, validation table).
        calibration: of the confidence; None leaves it to the default of the loading package.
        half: store float16 numbers, half the size.

    Raises:
        WeightsError: the file cannot be written.
    """
    kind = np.float16 if half else np.float32
    parameters = {k: v.astype(kind) for k, v in network.parameters_by_name().items()}
    metadata = {
        'format': FORMAT,
        'config': json.dumps(to_dict(network.config)),
        'calibration': json.dumps(to_dict(calibration or PairCalibration())),
        'provenance': json.dumps(dict(provenance)),
    }
    try:
        save_file(parameters, str(path), metadata)
    except (OSError, SafetensorError) as error:
        raise WeightsError(f'cannot write weights to {path}: {_one_line(error)}') from None


def load_checkpoint(path: str | Path) -> Checkpoint:
    """Read a weights file strictly.

    Raises:
        WeightsError: the file is missing, truncated, a pickle, not ours, or does not fit.
    """
    metadata, parameters = _read(Path(path))
    if metadata.get('format') != FORMAT:
        raise WeightsError(
            f'{path} is a safetensors file without HybridReg metadata: expected format '
            f'{FORMAT}, found {metadata.get("format")!r}'
        )
    try:
        config = from_dict(ModelConfig, json.loads(metadata['config']))
        stored = json.loads(metadata['calibration'])
        calibration = (
            from_dict(PairCalibration, stored) if stored.get('fitted') else PairCalibration()
        )
        provenance = json.loads(metadata['provenance'])
    except (KeyError, ValueError, ConfigError) as error:
        raise WeightsError(f'{path} has unreadable metadata: {_one_line(error)}') from None
    try:
        weights = packed(config, parameters)
    except WeightsError as error:
        raise WeightsError(f'{path} does not fit its config: {error}') from None
    return Checkpoint(config, parameters, weights, calibration, provenance)


def packaged_weights() -> Path:
    """The weights file that this package ships.

    Raises:
        WeightsError: the package holds none, or more than one.
    """
    folder = Path(__file__).parent / 'weights'
    found = sorted(folder.glob('*.safetensors'))
    if not found:
        raise WeightsError(
            'this version ships no trained weights yet: train some with `hybridreg train`, or '
            'give the path of a weights file'
        )
    if len(found) > 1:
        names = ', '.join(f.name for f in found)
        raise WeightsError(f'expected one weights file in {folder}, found {names}')
    return found[0]


def _read(path: Path) -> tuple[dict[str, str], dict[str, NDArray[Any]]]:
    """Metadata and arrays of a safetensors file."""
    try:
        with open(path, 'rb') as stream:
            start = stream.read(9)
    except OSError as error:
        raise WeightsError(f'cannot read weights {path}: {error.strerror}') from None
    # A safetensors file holds the length of its header in 8 bytes, then the header, a JSON object.
    if start.startswith(_PICKLE_STARTS) and start[8:] != b'{':
        raise WeightsError(
            f'{path} is a pickle or torch.save file, which is never opened because it can run '
            'code: expected a .safetensors file'
        )
    try:
        with safe_open(str(path), framework='numpy') as file:
            metadata = dict(file.metadata() or {})
            arrays = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise WeightsError(
            f'{path} is truncated or not a safetensors file: {_one_line(error)}'
        ) from None
    return metadata, arrays


def _one_line(error: Exception) -> str:
    return ' '.join(str(error).split())
