# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Scores on disk, one line each: a long evaluation that is stopped goes on where it was."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from hybridreg_ros.core.errors import ConfigError, FileFormatError
from hybridreg_ros.training.report import score_from_plain, score_to_plain

if TYPE_CHECKING:
    from pathlib import Path

    from hybridreg_ros.data.pair import PointPair
    from hybridreg_ros.training.report import PairScore


class KeptScores:
    """Scores of one method by the names of their pairs; the first line says of which method.

    Args:
        path: file, made when it does not exist; None keeps them in memory only.
        method: what tells two methods apart, such as a name and the hash of weights.

    Raises:
        ConfigError: the file holds the scores of another method.
        FileFormatError: it holds something else.
    """

    def __init__(self, path: Path | None, method: dict[str, Any]) -> None:
        self._path = path
        self._scores: dict[str, PairScore] = {}
        if path is None:
            return
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(method) + '\n', encoding='utf-8')
            return
        lines = path.read_text(encoding='utf-8').split('\n')
        # What follows the last newline is a line that a killed run did not finish.
        path.write_text(''.join(f'{line}\n' for line in lines[:-1]), encoding='utf-8')
        try:
            there = json.loads(lines[0])
            scores = [score_from_plain(json.loads(line)) for line in lines[1:-1]]
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise FileFormatError(f'{path} holds no scores of pairs: {error}') from None
        if there != method:
            raise ConfigError(f'{path} holds scores of {there}, but {method} was requested')
        self._scores = {score.name: score for score in scores}

    def add(self, score: PairScore) -> None:
        """Take in a score, on disk at once."""
        self._scores[score.name] = score
        if self._path is not None:
            with self._path.open('a', encoding='utf-8') as stream:
                stream.write(json.dumps(score_to_plain(score)) + '\n')

    def of(self, pair: PointPair) -> PairScore | None:
        """The score of a pair; None when there is none, or when the pair was another then."""
        score = self._scores.get(pair.name)
        same = score is not None and (score.overlap, score.dynamic_share) == (
            float(pair.overlap),
            float(pair.dynamic_share),
        )
        return score if same else None
