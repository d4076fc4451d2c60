"""The window that captures the preset's untouched frame, and what reads the present preset's one."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from PyQt6.QtCore import QObject, Qt, pyqtSignal
from PyQt6.QtGui import QKeyEvent
from PyQt6.QtWidgets import QDialog, QLabel

from ...core.errors import FrameError, PresetError, counted
from ...core.model.frames import SensorFrame
from ...core.preset import Preset, UntouchedRecord
from ...core.rig.untouched import (
    UNTOUCHED_FRAMES,
    average_untouched,
    load_untouched,
)
from ...widgets.basics.controls import make_verdict, push_button, wrapped_label
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.basics.messages import Severity
from ...widgets.images.image_pane import ImagePane
from ..calibration.pictures import picture
from ..context import SOURCE, Context
from ..document.document import Document, UntouchedStore
from ..worker.jobs import Job, Progress, Work
from ..worker.recorder import Recorder
from ..worker.results import SourceInfo
from .gather import Gather

_ADVICE: Final = (
    "The next frames are averaged into the preset's untouched frame. The check for drift and methods such as "
    "tactile-only compare with it. The simulator removes its object for these frames."
)
_NONE: Final = "This preset has no untouched frame yet"
_UNREAD: Final = "The preset's untouched frame cannot be found: capture it again"


class UntouchedPanel(Gather):
    """Averages the next frames while nothing touches the membrane, as one undoable step."""

    wanted = UNTOUCHED_FRAMES
    prompt = "Do not touch the membrane"

    def __init__(self, context: Context) -> None:
        start = push_button("&Capture", "Average the next frames into the untouched frame (Enter)")
        super().__init__(context, start)
        self.progress.setAccessibleName("Progress of capturing")
        self.sentence.setMinimumHeight(2 * self.sentence.fontMetrics().lineSpacing())
        vbox(self.row(), self.sentence, within=self, margins=0)
        self._show_busy()

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


class CaptureWindow(QDialog):
    """Shows the untouched frame, and captures a new one; the main window shows the membrane now."""

    def __init__(self, context: Context, keeper: UntouchedKeeper) -> None:
        super().__init__(context.window)
        self.setWindowTitle("Capture untouched frame – Tactune")
        self._context, self._keeper = context, keeper
        self.panel = UntouchedPanel(context)
        self.panel.start.setDefault(True)
        headline = QLabel("Nothing may touch the membrane")
        make_verdict(headline)
        self.untouched = ImagePane("Untouched frame, tactile depth")
        self.untouched.view.setMinimumSize(220, 165)
        self.untouched.resized.connect(self._fit)
        self.leave = push_button(
            "&Close", "Close this window (Esc); an unsaved untouched frame is kept with the unsaved preset"
        )
        self.leave.clicked.connect(self.reject)
        row = hbox(STRETCH, self.leave)
        vbox(headline, wrapped_label(_ADVICE), (self.untouched, 1), self.panel, row, within=self)
        self.resize(560, 560)
        keeper.changed.connect(self._show_untouched)
        self._show_untouched()
        self.panel.start.setFocus()

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Let Esc cancel capturing before it closes the window."""
        if event is not None and event.key() == Qt.Key.Key_Escape and self.panel.busy:
            self.panel.stop()
            return
        super().keyPressEvent(event)

    def done(self, result: int) -> None:
        self.panel.close_down()
        super().done(result)

    def _show_untouched(self) -> None:
        record, frame, result = self._context.document.preset.untouched, self._keeper.frame, self._context.result
        if frame is None or result is None or frame.tactile_depth.shape != result.source.rig.tactile.intrinsics.shape:
            self.untouched.set_pixels(None, (1, 1), 1)
        else:
            shown = picture(frame, result.source.rig, "tactile", "depth").pixels
            self.untouched.set_pixels(shown, (shown.shape[1], shown.shape[0]), 1)
            self._fit()
        found = frame is not None or self._keeper.busy
        self.untouched.set_message("" if found else _NONE if record is None else _UNREAD)

    def _fit(self) -> None:
        self.untouched.show_rect(self.untouched.image_rect())


class UntouchedControls(QObject):
    """Owns the store of untouched frames, and opens at most one window."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self.window: CaptureWindow | None = None
        self.store = UntouchedStore(context.data_folder / "untouched")
        self.store.tidy()
        context.document.untouched_store = self.store
        context.document.warned.connect(
            lambda sentence: context.messages.show_message("untouched", Severity.WARNING, sentence)
        )
        self.keeper = UntouchedKeeper(context.document, context.worker.recorder, self.store, self)
        context.worker.opened.connect(self.keeper.source_opened)

    def open(self) -> None:
        if self._context.result is None:
            sentence = "There is no frame to capture yet: open a source first."
            self._context.messages.show_message("untouched", Severity.WARNING, sentence, subject=SOURCE)
            return
        if self.window is None:
            self.window = CaptureWindow(self._context, self.keeper)
        bring_up(self.window)

    def close(self) -> None:
        if self.window is not None:
            self.window.reject()
        self.keeper.close()


class UntouchedKeeper(QObject):
    """Reads the untouched frame of the current preset, on its own thread.

    A preset from a recording has no folder. Its untouched frame is copied from the recording to the store, and is
    saved from there.

    Signals
    -------
    changed()
        `frame` has changed.
    """

    changed = pyqtSignal()

    def __init__(self, document: Document, recorder: Recorder, store: UntouchedStore, parent: QObject) -> None:
        super().__init__(parent)
        self._document, self._recorder, self._store = document, recorder, store
        self._info: SourceInfo | None = None
        self._key: object = None
        self._job = Job(self)
        self._job.done.connect(self._use)
        document.presetChanged.connect(self._look)
        document.fileChanged.connect(self._look)
        self._look()

    @property
    def frame(self) -> SensorFrame | None:
        """The preset's untouched frame; None if there is none, if it cannot be read, or while it is being read."""
        return self._recorder.untouched

    @property
    def busy(self) -> bool:
        return self._job.busy

    def source_opened(self, info: SourceInfo) -> None:
        self._info = info
        self._look()

    def close(self) -> None:
        self._job.stop()

    def _look(self) -> None:
        preset, home = self._document.preset, self._document.untouched_home
        key = (preset.untouched, home, self._info)
        if key == self._key:
            return
        self._key = key
        self._job.cancel()  # its result would belong to another preset or source
        if preset.untouched is not None:
            self._job.start(partial(_read, preset.untouched, preset, home, self._info, self._store))
        self._use(None)

    def _use(self, frame: SensorFrame | None) -> None:
        self._recorder.untouched = frame
        self.changed.emit()


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
