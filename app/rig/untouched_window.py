"""The window that captures the preset's untouched frame."""

from __future__ import annotations

import math
from functools import partial
from typing import Final

from PyQt6.QtCore import QObject, Qt, QTimer
from PyQt6.QtGui import QKeyEvent
from PyQt6.QtWidgets import QDialog, QLabel, QWidget

from ...core.errors import as_sentence
from ...core.model.frames import Rig, SensorFrame
from ...core.rig.untouched import MAX_FRAMES, UNTOUCHED_FRAMES
from ...widgets.basics.controls import ProgressBar, caption, frame_count, make_verdict, push_button, wrapped_label
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.basics.messages import Severity
from ...widgets.images.image_pane import ImagePane
from ..calibration.pictures import picture
from ..context import SOURCE, Context
from ..document.document import Document
from ..document.untouched_store import UntouchedStore
from ..worker.feed import FrameFeed
from ..worker.results import SourceInfo
from .untouched_capture import Capture, Captured, UntouchedKeeper

_PREVIEW_MS: Final = 80
_ADVICE: Final = (
    "The next frames are averaged into the preset's untouched frame. Proximity-only, tactile-only and membrane "
    "mechanics compare with it, and Re-check calibration uses it to detect a changed inflation or camera."
)
_SIMULATED: Final = " The simulator removes its object for these frames."
_NONE: Final = "This preset has no untouched frame yet"
_UNREAD: Final = "The preset's untouched frame cannot be found: capture it again"
_CAPTURING: Final = "Capturing: do not touch the membrane."
_AVERAGING: Final = "Averaging the frames; the membrane may be touched again."
_OTHER_SOURCE: Final = "Capturing was cancelled because another source was opened."


class CaptureWindow(QDialog):
    """Shows the membrane now and in the untouched frame, and captures a new untouched frame as one undoable step."""

    def __init__(
        self,
        document: Document,
        feed: FrameFeed,
        store: UntouchedStore,
        keeper: UntouchedKeeper,
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle("Capture untouched frame – Tactune")
        self._document, self._feed, self._keeper = document, feed, keeper
        self.capture = Capture(feed, store, self)
        self._redraw = QTimer(self)
        self._redraw.setSingleShot(True)
        self._redraw.setInterval(_PREVIEW_MS)
        self._make_controls()
        self._lay_out()
        self._connect()
        self._show_frame()
        self._show_untouched()
        self._show_busy(False)
        self.take.setFocus()

    def _make_controls(self) -> None:
        self.headline = QLabel("Nothing may touch the membrane")
        make_verdict(self.headline)
        simulated = _SIMULATED if self._feed.info.name.startswith("sim:") else ""
        self.advice = wrapped_label(_ADVICE + simulated)
        self.now = ImagePane("Now, tactile depth")
        self.untouched = ImagePane("Untouched frame, tactile depth")
        for pane in (self.now, self.untouched):
            pane.view.setMinimumSize(220, 165)
            pane.resized.connect(partial(_fit, pane))
        self.frames = frame_count(
            MAX_FRAMES,
            f"Number of frames to average, 1 to {MAX_FRAMES}: the median of each pixel. More frames, less noise; "
            "the membrane must not move meanwhile",
            UNTOUCHED_FRAMES,
        )
        self.progress = ProgressBar()
        self.progress.setAccessibleName("Progress of capturing")
        self.sentence = wrapped_label()
        self.sentence.setMinimumHeight(3 * self.sentence.fontMetrics().lineSpacing())
        self.take = push_button(
            "&Capture", "Average the next frames into the untouched frame (Enter), as one undoable step"
        )
        self.take.setDefault(True)
        self.go_on = push_button("&Go on", "Continue playback and take the missing frames")
        self.use_taken = push_button("Use &these", "Average only the frames taken so far")
        self.cancel = push_button("Cance&l", "Cancel capturing (Esc); the preset's untouched frame is unchanged")
        self.undo = push_button("&Undo", "Undo the last change of the preset (Ctrl+Z)")
        self.undo.setShortcut("Ctrl+Z")
        self.save = push_button("&Save preset", "Save the preset; the untouched frame is written beside it (Ctrl+S)")
        self.save.setShortcut("Ctrl+S")
        self.leave = push_button(
            "Close", "Close this window (Esc); an unsaved untouched frame is kept with the unsaved preset"
        )

    def _lay_out(self) -> None:
        images = hbox(self.now, self.untouched)
        average = (caption("A&verage", self.frames), self.frames, self.take)
        taking = hbox(*average, (self.progress, 1), self.go_on, self.use_taken, self.cancel)
        taking.addStretch(0)
        row = hbox(self.undo, self.save, STRETCH, self.leave)
        vbox(self.headline, self.advice, (images, 1), taking, self.sentence, row, within=self)
        self.resize(760, 560)

    def _connect(self) -> None:
        self._feed.frameArrived.connect(lambda _: self._redraw.isActive() or self._redraw.start())
        self._redraw.timeout.connect(self._show_frame)
        self._keeper.changed.connect(self._show_untouched)
        self._document.undo_stack.indexChanged.connect(self._show_state)
        self._document.fileChanged.connect(self._show_state)
        self.take.clicked.connect(self._start)
        self.go_on.clicked.connect(self.capture.go_on)
        self.use_taken.clicked.connect(self.capture.use_taken)
        self.cancel.clicked.connect(self.capture.cancel)
        self.undo.clicked.connect(self._document.undo_stack.undo)
        self.leave.clicked.connect(self.reject)
        self.capture.progress.connect(self.progress.show_share)
        self.capture.pausedChanged.connect(self._show_paused)
        self.capture.averaging.connect(lambda: self.sentence.setText(_AVERAGING))
        self.capture.captured.connect(self._use)
        self.capture.failed.connect(self._fail)

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Let Esc cancel capturing before it closes the window."""
        if event is not None and event.key() == Qt.Key.Key_Escape and self.capture.busy:
            self.capture.cancel()
            return
        super().keyPressEvent(event)

    def done(self, result: int) -> None:
        """Stop capturing and disconnect; a closed window is not reused."""
        self.capture.close()
        self._document.undo_stack.indexChanged.disconnect(self._show_state)
        super().done(result)

    def source_changed(self) -> None:
        """Cancel: frames of another source show another membrane."""
        if self.capture.busy:
            self.capture.cancel()
            self.sentence.setText(_OTHER_SOURCE)

    def _start(self) -> None:
        self._show_busy(True)
        self.sentence.setText(_CAPTURING)
        self.progress.show_share(0.0, "")
        self.capture.start(self.frames.value())

    def _use(self, captured: Captured) -> None:
        self._show_busy(False)
        self._document.edit("untouched", captured.record.model_dump())
        self.sentence.setText(captured_words(captured, self._feed.rig))
        self.save.setFocus()  # a focused number entry would handle Ctrl+Z itself

    def _fail(self, sentence: str) -> None:
        self._show_busy(False)
        if sentence:
            self.sentence.setText(as_sentence(sentence))
        elif self.sentence.text() != _OTHER_SOURCE:
            self.sentence.setText("Capturing was cancelled; the preset is unchanged.")

    def _show_busy(self, busy: bool) -> None:
        self.progress.setVisible(busy)
        self.cancel.setVisible(busy)
        self._show_paused(False)
        self.take.setEnabled(not busy)
        self.frames.setEnabled(not busy)
        self._show_state()

    def _show_paused(self, paused: bool) -> None:
        self.go_on.setVisible(paused)
        self.use_taken.setVisible(paused)
        if paused:
            taken = self.capture.taken
            self.sentence.setText(
                f"Paused after {taken} frame{'' if taken == 1 else 's'}, which are kept. Press “Go on”, or play in "
                "the main window, to capture the rest."
            )
            self.go_on.setFocus()
        elif self.capture.taking:
            self.sentence.setText(_CAPTURING)

    def _show_state(self) -> None:
        self.undo.setEnabled(self._document.undo_stack.canUndo() and not self.capture.busy)
        self.save.setEnabled(self._document.dirty and not self.capture.busy)

    def _show_frame(self) -> None:
        self._draw(self.now, self._feed.frame)

    def _show_untouched(self) -> None:
        record, frame = self._document.preset.untouched, self._keeper.frame
        if frame is not None:
            self._draw(self.untouched, frame)
        else:
            self.untouched.set_pixels(None, (1, 1), 1)
        found = frame is not None or self._keeper.busy
        self.untouched.set_message("" if found else _NONE if record is None else _UNREAD)

    def _draw(self, pane: ImagePane, frame: SensorFrame) -> None:
        rig = self._feed.rig
        if frame.tactile_depth.shape == rig.tactile.intrinsics.shape:
            shown = picture(frame, rig, "tactile", "depth", stretch=True).pixels
            pane.set_pixels(shown, (shown.shape[1], shown.shape[0]), 1)
            _fit(pane)


def captured_words(captured: Captured, rig: Rig) -> str:
    """Return a sentence on what was captured and the next step."""
    averaged = captured.untouched
    count = f"{averaged.frames} frame{'' if averaged.frames == 1 else 's'}"
    fewer = f" of {captured.asked}, because the source has no more" if averaged.frames < captured.asked else ""
    before, after = (1e3 * rig.tactile.depth_unit_m * counts for counts in averaged.noise_counts)
    noise = "" if math.isnan(before) else f" Noise of the tactile depth: {before:.2f} mm before, {after:.2f} mm after."
    return f"Captured {count}{fewer}.{noise} Save the preset to write the untouched frame beside it."


def _fit(pane: ImagePane) -> None:
    pane.show_rect(pane.image_rect())


class UntouchedControls(QObject):
    """Owns the store of untouched frames, and opens at most one window."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self._feed: FrameFeed | None = None
        self.window: CaptureWindow | None = None
        self.store = UntouchedStore(context.data_folder / "untouched")
        self.store.tidy(context.data_folder)
        context.document.untouched_store = self.store
        context.document.warned.connect(
            lambda sentence: context.messages.show_message("untouched", Severity.WARNING, sentence)
        )
        self.keeper = UntouchedKeeper(context.document, context.worker.recorder, self.store, self)
        context.worker.opened.connect(self._source_opened)
        context.frameShown.connect(self._frame_shown)

    def open(self) -> None:
        """Open the window on the current source, or bring it to the front."""
        context = self._context
        if context.result is None:
            context.messages.show_message(
                "untouched",
                Severity.WARNING,
                "There is no frame to capture yet: open a source first.",
                subject=SOURCE,
            )
            return
        if self.window is None:
            self._feed = FrameFeed(context.worker, context.result, context.playback, self)
            self.window = CaptureWindow(context.document, self._feed, self.store, self.keeper, context.window)
            self.window.save.clicked.connect(context.saveRequested)
            self.window.finished.connect(self._closed)
        bring_up(self.window)

    def close(self) -> None:
        """Stop capturing, close the window and stop following the preset."""
        if self.window is not None:
            self.window.reject()
        self.keeper.close()

    def _closed(self) -> None:
        if self.window is not None:
            self.window.deleteLater()
        if self._feed is not None:
            self._feed.deleteLater()
        self.window, self._feed = None, None

    def _source_opened(self, info: SourceInfo) -> None:
        self.keeper.source_opened(info)
        if self.window is not None and self._feed is not None:
            self.window.source_changed()
            if info.rig != self._feed.rig:
                self.window.reject()

    def _frame_shown(self) -> None:
        if self._feed is not None and self._context.result is not None:
            self._feed.show_result(self._context.result)
