# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest

from hybridreg_ros.core import provenance


def test_collect_names_inputs_and_versions(tmp_path):
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'a.mcap').write_bytes(b'abc' * 1000)
    found = provenance.collect({'voxel': 0.3}, (tmp_path / 'bag',), seed=4)
    assert found.inputs == {'a.mcap': hashlib.sha256(b'abc' * 1000).hexdigest()}
    assert found.versions['numpy'] == np.__version__
    assert json.loads(json.dumps(found.to_dict()))['config'] == {'voxel': 0.3}
    assert found.seed == 4


def test_absent_package_and_file(tmp_path):
    assert provenance.version('no-such-package-anywhere') == ''
    with pytest.raises(FileNotFoundError):
        provenance.sha256(tmp_path / 'missing')
