"""Gathers the evidence for suggestions: the newest frames, the untouched frame, and the examples."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from PyQt6.QtCore import QObject

from ...core.errors import TactuneError
from ...core.model.frames import SensorFrame
from ...core.preset import Preset
from ...core.tuning.advice.proposal import Evidence, Example
from ..context import Context
from ..worker.jobs import Progress
from ..worker.results import SourceInfo

#: Number of newest frames that suggestions are made from.
MAX_FRAMES: Final = 8
#: Share of the progress at which the untouched frame is found.
_FOUND: Final = 0.3


@dataclass(frozen=True, eq=False)
class Gathered:
    """Evidence without the untouched frame, which may take long to find; see `Evidence` for the attributes."""

    info: SourceInfo
    preset: Preset
    home: Path | None
    frames: tuple[SensorFrame, ...]
    examples: tuple[Example, ...]

    def evidence(self, progress: Progress) -> Evidence:
        """Find the untouched frame; call it on a job's thread."""
        untouched = None
        try:
            untouched = self.info.find_untouched(
                self.preset, self.home, lambda share, words: progress(_FOUND * share, words)
            ).frame
        except TactuneError:
            progress(_FOUND, "The untouched frame cannot be read")  # raises if the job was cancelled
        return Evidence(self.preset, self.info.rig, self.frames, untouched, self.examples)


class FrameRing(QObject):
    """Keeps the newest frames of the present source."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self._info: SourceInfo | None = None
        self._frames: deque[SensorFrame] = deque(maxlen=MAX_FRAMES)
        context.frameShown.connect(self._frame_shown)

    def gather(self, examples: tuple[Example, ...]) -> Gathered | None:
        """Return what is known now; None before the first frame."""
        document = self._context.document
        if self._info is None or not self._frames:
            return None
        return Gathered(self._info, document.preset, document.untouched_home, tuple(self._frames), examples)

    def _frame_shown(self) -> None:
        result = self._context.result
        if result is None:
            return
        if result.source is not self._info:
            self._info = result.source
            self._frames.clear()
        if not self._frames or self._frames[-1] is not result.frame:
            self._frames.append(result.frame)
