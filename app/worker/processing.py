"""Processes one frame: finds the contact patch and draws what is visible."""

from __future__ import annotations

import time

from ...core.contact.pipeline import ContactPatch, ContactPipeline
from ...core.errors import TactuneError
from ...core.model.frames import SensorFrame
from ...core.preset import Preset
from .playback import PlaybackState
from .rendering import Renderer
from .results import RateMeter, Result, SourceInfo, Wanted


class FrameProcessor:
    """Holds the pipeline of the present source and counts processed frames."""

    def __init__(self) -> None:
        self._renderer = Renderer()
        self._pipeline: ContactPipeline | None = None
        self._processed = 0
        self._rate = RateMeter()

    def forget(self) -> None:
        """Discard the pipeline before another source."""
        self._pipeline = None

    def process(
        self,
        info: SourceInfo,
        frame: SensorFrame,
        preset: Preset,
        wanted: Wanted,
        playback: PlaybackState,
        *,
        dropped: int = 0,
        unmatched: int = 0,
        read_ms: float = 0.0,
    ) -> Result:
        """Return the patch and everything the window shows of a frame.

        Raises
        ------
        Exception
            Any exception of pipeline or drawing, except that preset and rig do not fit: that is `Result.problem`.
        """
        patch, problem = self._find_patch(info, frame, preset)
        started = time.perf_counter()
        rendered = self._renderer.render(
            frame, patch, preset, info.rig, wanted.while_running() if playback.running else wanted
        )
        render_ms = 1e3 * (time.perf_counter() - started)
        self._processed += 1
        self._rate.tick()
        return Result(
            source=info,
            frame=frame,
            preset=preset,
            patch=patch,
            area_mm2=patch.area_mm2 if patch is not None else 0.0,
            rendered=rendered,
            playback=playback,
            problem=problem,
            warnings=tuple(self._pipeline.warnings) if self._pipeline is not None else (),
            processed=self._processed,
            dropped=dropped,
            unmatched=unmatched,
            processed_fps=self._rate.rate(),
            read_ms=read_ms,
            render_ms=render_ms,
        )

    def _find_patch(self, info: SourceInfo, frame: SensorFrame, preset: Preset) -> tuple[ContactPatch | None, str]:
        """Return the patch; or None and the reason why this preset cannot be used with this rig."""
        try:
            if self._pipeline is None:
                self._pipeline = ContactPipeline(preset, info.rig)
            elif self._pipeline.preset is not preset:
                self._pipeline.update(preset)
            return self._pipeline.process(frame), ""
        except TactuneError as error:
            self._pipeline = None
            return None, str(error)
