"""Looks for findings on the newest frame, seldom enough to take a small share of the worker's time."""

from __future__ import annotations

import time
from pathlib import Path

from ...core.errors import TactuneError
from ...core.model.frames import SensorFrame
from ...core.preset import Preset
from ...core.rig.untouched import kept_untouched
from ...core.tuning.advice.findings import Examiner
from ...core.tuning.advice.proposal import Finding
from .results import Result, SourceInfo

#: Shortest time between two examinations, seconds: they take a small share of the thread's time.
INTERVAL_S = 1.0


class Examination:
    """Examines results; for the worker's thread only."""

    def __init__(self) -> None:
        self._result: Result | None = None  # not examined yet
        self._examiner: Examiner | None = None
        self._info: SourceInfo | None = None
        self._home: Path | None = None
        self._untouched_key: object = None
        self._untouched: SensorFrame | None = None
        self._ended_s = -INTERVAL_S

    def note(self, result: Result, home: Path | None) -> None:
        """Examine this result when it is due; ``home`` is the file beside which the preset's untouched frame lies."""
        self._result, self._home = result, home

    def forget(self) -> None:
        self._result, self._examiner, self._info, self._untouched_key = None, None, None, None

    def wait_s(self) -> float | None:
        """Seconds until the next examination is due (0: now); None while there is nothing new to examine."""
        if self._result is None:
            return None
        return max(0.0, self._ended_s + INTERVAL_S - time.perf_counter())

    def findings(self) -> tuple[tuple[Finding, ...], Preset]:
        """Return what is wrong with the newest result, and its preset; call it only when that is due."""
        result, self._result = self._result, None
        assert result is not None
        if result.patch is None:
            return (), result.preset
        if self._examiner is None or result.source is not self._info:
            self._examiner, self._info = Examiner(result.source.rig), result.source
        untouched = self._stored_untouched(result.source, result.preset)
        found = self._examiner.findings(result.frame, result.patch, result.preset, untouched)
        self._ended_s = time.perf_counter()
        return found, result.preset

    def _stored_untouched(self, info: SourceInfo, preset: Preset) -> SensorFrame | None:
        """Return the stored untouched frame, read again only if the preset names another one."""
        key = info, preset.untouched
        if key != self._untouched_key:
            self._untouched_key = key
            try:
                at_rest = info.at_rest
                self._untouched = None if at_rest is None else kept_untouched(preset, self._home, at_rest).frame
            except TactuneError:
                self._untouched = None  # who needs it says why it cannot be read
        return self._untouched
