"""Captures the preset's untouched frame, and reads the present preset's one."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from PyQt6.QtCore import QObject

from ...core.errors import FrameError, PresetError, SourceError, counted
from ...core.model.frames import SensorFrame
from ...core.preset import Preset, UntouchedRecord
from ...core.rig.untouched import (
    UNTOUCHED_FRAMES,
    average_untouched,
    load_untouched,
)
from ...widgets.basics.controls import push_button
from ...widgets.basics.messages import Severity
from ..calibration.measuring_step import MeasuringStep
from ..context import Context
from ..document.document import UntouchedStore
from ..worker.jobs import Job, Progress, Work
from ..worker.results import SourceInfo


class UntouchedStep(MeasuringStep):
    """Averages the next frames while nothing touches the membrane, as one undoable step."""

    wanted = UNTOUCHED_FRAMES
    prompt, recorded = "Do not touch the membrane", "Averaging frames"

    def __init__(self, context: Context) -> None:
        super().__init__(context, push_button("Cap&ture", "Average the next frames; nothing may touch the membrane"))

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

    def show_found(self, found: UntouchedRecord) -> None:
        fewer = " because the source has no more" if found.frames < self.wanted else ""
        self.sentence.setText(
            f"Captured {counted(found.frames, 'frame')}{fewer}. "
            "Save the preset (Ctrl+S in the main window) to write the untouched frame beside it."
        )

    def changes(self) -> dict[str, Any]:
        return {"untouched": self.found.model_dump()}


class UntouchedKeeper(QObject):
    """Owns the store of untouched frames, and reads that of the current preset on its own thread.

    A preset from a recording has no folder. Its untouched frame is copied from the recording to the store, and is
    saved from there.
    """

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._document, self._recorder = context.document, context.worker.recorder
        self._store = self._document.untouched_store = UntouchedStore(context.data_folder / "untouched")
        self._store.tidy()
        self._info: SourceInfo | None = None
        self._key: object = None
        self.job = Job(self)
        self.job.done.connect(self._use)
        self._document.presetChanged.connect(self._look)
        self._document.fileChanged.connect(self._look)
        self._document.warned.connect(
            lambda sentence: context.messages.show_message("untouched", Severity.WARNING, sentence)
        )
        context.worker.opened.connect(self._source_opened)
        self._look()

    @property
    def frame(self) -> SensorFrame | None:
        """The preset's untouched frame; None if there is none, if it cannot be read, or while it is being read."""
        return self._recorder.untouched

    def _source_opened(self, info: SourceInfo) -> None:
        self._info = info
        self._look()

    def close(self) -> None:
        self.job.stop()

    def _look(self) -> None:
        preset, home = self._document.preset, self._document.untouched_home
        key = (preset.untouched, home, self._info)
        if key == self._key:
            return
        self._key = key
        self.job.cancel()  # its result would belong to another preset or source
        if preset.untouched is not None:
            self.job.start(partial(_read, preset.untouched, preset, home, self._info, self._store))
        self._use(None)

    def _use(self, frame: SensorFrame | None) -> None:
        self._recorder.untouched = frame


def _read(
    record: UntouchedRecord,
    preset: Preset,
    home: Path | None,
    info: SourceInfo | None,
    store: UntouchedStore,
    progress: Progress,
) -> SensorFrame | None:
    """Return the preset's untouched frame from its folder, else from the recording that contains both, else None."""
    if home is not None:
        with suppress(PresetError, FrameError):  # reported where the frame is needed
            frame = load_untouched(record, home)
            if info is not None:
                frame.check_against(info.rig)
            return frame
    if info is None or info.preset is None or info.preset.untouched != record:
        return None
    found = info.find_untouched(preset, None, progress)
    if found.frame is None or found.warnings:
        return None
    store.keep(found.frame, record.frames)
    return found.frame
