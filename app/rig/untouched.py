"""Captures the preset's untouched frame, and reads the present preset's one."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from PyQt6.QtCore import QObject

from ...core.contact.checks import for_rig
from ...core.errors import SourceError, counted
from ...core.model.frames import SensorFrame
from ...core.preset import Preset, UntouchedRecord
from ...core.rig.untouched import UNTOUCHED_FRAMES, average_untouched
from ...widgets.basics.messages import Severity
from ..context import Context
from ..document.document import UntouchedStore
from ..worker.jobs import Job, Progress, Work
from ..worker.results import SourceInfo
from .set_up_steps import SetUpStep


class UntouchedStep(SetUpStep):
    """Averages the next frames while nothing touches the membrane, as one undoable step."""

    title, intro = "Untouched frame", "The membrane while nothing touches it."
    button = "Cap&ture", "Average the next frames; nothing may touch the membrane"
    field = "untouched"
    wanted = UNTOUCHED_FRAMES
    prompt, recorded = "Do not touch the membrane", "Averaging frames"

    def known(self, preset: Preset) -> str:
        record = preset.untouched
        return "" if record is None else f"Captured, mean of {counted(record.frames, 'frame')}."

    def at_hand(self) -> list[SensorFrame]:
        """Return the untouched frame of a recording that has one, unless the preset has one already."""
        assert self.info is not None
        own: SensorFrame | None = None
        if self._document.preset.untouched is None and self.info.at_rest is not None:
            with suppress(SourceError):  # it cannot be read
                own = self.info.at_rest.untouched()
        return [] if own is None else [own]

    def work(self, kept: list[SensorFrame], info: SourceInfo) -> Work:
        store = self._document.untouched_store
        assert store is not None

        def average(_: Progress) -> UntouchedRecord:
            averaged = average_untouched(kept[: self.wanted])
            return store.keep(averaged.frame, averaged.frames)

        return average

    def changes(self) -> dict[str, Any]:
        """Without an alignment, which names its rig, the preset becomes that of the camera that saw this membrane."""
        changes, info = super().changes(), self.info
        if info is None or info.rig.has_proximity:
            return changes
        here = for_rig(self._document.preset, info.rig)
        inflation = {f"pressure.{name}": getattr(here.pressure, name) for name in ("gauge_pa", "gauge_sigma_pa")}
        return {"rig": info.rig.model_dump(), "noise": here.noise and here.noise.model_dump(), **inflation, **changes}

    def show_found(self, found: UntouchedRecord) -> None:
        fewer = ": the source has no more, or the membrane moved then" if found.frames < self.wanted else ""
        self.sentence.setText(
            f"Captured {counted(found.frames, 'frame')}{fewer}. "
            "Save the preset (Ctrl+S in the main window) to write the untouched frame beside it."
        )


class UntouchedKeeper(QObject):
    """Owns the store of untouched frames.

    A preset from a recording has no folder. Its untouched frame is copied from the recording to the store, and is
    saved from there.
    """

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._document = context.document
        self._store = self._document.untouched_store = UntouchedStore(context.data_folder / "untouched")
        self._store.tidy()
        self._info: SourceInfo | None = None
        self._copied: object = None
        self.job = Job(self)
        self._document.presetChanged.connect(self._look)
        self._document.warned.connect(
            lambda sentence: context.messages.show_message("untouched", Severity.WARNING, sentence)
        )
        context.worker.opened.connect(self._source_opened)

    def _source_opened(self, info: SourceInfo) -> None:
        self._info = info
        self._look()

    def close(self) -> None:
        self.job.stop()

    def _look(self) -> None:
        preset, info = self._document.preset, self._info
        record = preset.untouched
        if info is None or record is None or (record, info) == self._copied or self._document.untouched_home:
            return
        self._copied = record, info

        def copy(_: Progress) -> None:
            found = info.kept_untouched(preset, None)
            if found.frame is not None and not found.warnings:  # warnings are told where the frame is needed
                self._store.keep(found.frame, record.frames)

        self.job.start(copy)
