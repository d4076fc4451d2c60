"""The noise of both cameras and the bias between them: what the preset holds, and a new measurement."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from PyQt6.QtCore import Qt, QTimer, pyqtSignal
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QVBoxLayout, QWidget

from ...core.model.frames import SensorFrame
from ...core.preset import Preset, RigNoise
from ...core.rig.noise import (
    MAX_FRAMES,
    MIN_FRAMES,
    NOISE_FRAMES,
    describe,
    frames_at_rest,
    measure_noise,
    object_moves,
)
from ...core.sources.registry import open_source
from ...widgets.basics.controls import ProgressBar, frame_count, make_verdict, push_button
from ..document.document import Document
from ..worker.jobs import Job, Progress
from ..worker.results import Result, SourceInfo
from ..worker.worker import Worker

_SIMULATOR: Final = "sim:"
#: Share of the progress at which all frames have arrived.
_GATHERED: Final = 0.5
#: Seconds without a frame after which a source counts as stopped.
PATIENCE_S: Final = 5.0
_TICK_MS: Final = 100
_INTRO = (
    "Hold the sensor and what it sees still. The noise is measured from the differences of successive frames and from "
    "the mean frame on smooth surfaces. The bias is measured on prints of the mask's colour, which both cameras see, "
    "and where an object is pressed firmly into the membrane (10 cm2 or more)."
)
_NOT_MEASURED = "The rig was not measured: the preset holds no noise and no bias."
_NO_FRAME = "There is no frame yet: open a source in the main window first."
_NO_MORE_FRAMES = "No more frames arrive: play the source, in a loop if it is a recording, and measure again."
_OTHER_SOURCE = "Another source was opened meanwhile: measure again."
_OBJECT_REMOVED = "The simulator's object moves, so it was removed for the measurement."


@dataclass(frozen=True)
class Measured:
    """A measurement, and further sentences to show below it."""

    noise: RigNoise
    remarks: tuple[str, ...]


class NoiseTab(QWidget):
    """Collects frames of the main window, measures them on another thread, and puts the result into the preset."""

    _watchingFailed = pyqtSignal(str)

    def __init__(self, worker: Worker, document: Document) -> None:
        super().__init__()
        self._worker, self._document = worker, document
        self._result: Result | None = None
        self._info: SourceInfo | None = None
        self._gathering, self._pause_after = False, False
        self._frames: dict[int, SensorFrame] = {}
        self._counted, self._last_frame_s = 0, 0.0
        self.measured: Measured | None = None
        self._job = Job(self)
        self._timer = QTimer(self)
        self._timer.setInterval(_TICK_MS)
        self._timer.timeout.connect(self._look)
        self.stored = _sentences()
        self.frames = frame_count(MAX_FRAMES, "Number of frames to measure; more are more accurate", NOISE_FRAMES)
        self.frames.setMinimum(MIN_FRAMES)
        self.frames.setAccessibleName("Frames to measure")
        self.start = push_button("Measure", "Measure noise and bias on the current source (Ctrl+M)", "Ctrl+M")
        self.cancel = push_button("Cancel", "Cancel this measurement; the preset is unchanged")
        self.progress = ProgressBar()
        self.sentence = _sentences()
        self.use = push_button(
            "Use in preset",
            "Store this measurement in the preset (Ctrl+U); Ctrl+Z in the main window undoes it",
            "Ctrl+U",
        )
        self._lay_out()
        self.start.clicked.connect(self.begin)
        self.cancel.clicked.connect(self.stop)
        self.use.clicked.connect(self._use)
        self._job.progress.connect(
            lambda share, words: self.progress.show_share(_GATHERED + (1 - _GATHERED) * share, words)
        )
        self._job.done.connect(self._done)
        self._job.failed.connect(self._fail)
        self._watchingFailed.connect(self._give_up)
        document.presetChanged.connect(self._show_stored)
        self._show_stored()
        self._show_busy(False)

    @property
    def busy(self) -> bool:
        """Whether a measurement is running."""
        return self._gathering or self._job.busy

    def show_result(self, result: Result) -> None:
        """Note the source of a frame of the main window. The worker passes all frames on."""
        self._result = result
        if self._info is not None and result.source is not self._info:
            self._info = None
            if self.busy or self.measured is not None:
                self.measured = None
                self.stop()
                self.use.setEnabled(False)
                self.sentence.setText(_OTHER_SOURCE)

    def begin(self) -> None:
        """Start collecting frames; the simulator's are read by the job itself."""
        if self.busy:
            return
        self._forget()
        if self._result is None:
            self._fail(_NO_FRAME)
            return
        info = self._info = self._result.source
        if info.length is not None and info.length < MIN_FRAMES:
            self._fail(f"This source has {info.length} frames; the noise needs at least {MIN_FRAMES}.")
            return
        self._show_busy(True)
        if info.name.startswith(_SIMULATOR):
            count, preset, home = self.frames.value(), self._document.preset, self._document.untouched_home
            self._job.start(lambda progress: _measure_simulator(info, count, preset, home, progress))
            return
        frames: dict[int, SensorFrame] = {}
        self._frames, self._counted = frames, 0
        self._last_frame_s = time.monotonic()
        # also frames that the window drops; a recording in a loop gives each frame once
        self._worker.recorder.watch(lambda frame: frames.setdefault(frame.sequence, frame), self._watchingFailed.emit)
        self._gathering = True
        self._timer.start()
        self._pause_after = not self._result.playback.running
        if self._pause_after:
            self._worker.play()

    def stop(self) -> None:
        """Cancel the measurement."""
        self._stop_gathering()
        self._job.cancel()
        if not self._job.busy:
            self._show_busy(False)

    def close_down(self) -> None:
        """Cancel permanently and wait for the thread."""
        self._stop_gathering()
        self._job.stop()
        self._show_busy(False)

    def _stop_gathering(self) -> None:
        if self._gathering:
            self._gathering = False
            self._timer.stop()
            self._worker.recorder.unwatch()
            if self._pause_after:
                self._worker.pause()

    def _give_up(self, sentence: str) -> None:
        if self._gathering:
            self.stop()
            self._fail(sentence)

    def _look(self) -> None:
        """Check whether enough frames have arrived."""
        assert self._info is not None
        now, count = time.monotonic(), len(self._frames)
        wanted = min(self.frames.value(), self._info.length or MAX_FRAMES)
        if count > self._counted:
            self._counted, self._last_frame_s = count, now
        self.progress.show_share(_GATHERED * min(count / wanted, 1.0), f"Hold everything still: {count} frames")
        stopped = now - self._last_frame_s > PATIENCE_S
        if count >= wanted or (stopped and count >= MIN_FRAMES):
            self._measure(wanted)
        elif stopped:
            self._give_up(_NO_MORE_FRAMES)

    def _measure(self, count: int) -> None:
        self._stop_gathering()
        info, preset, home = self._info, self._document.preset, self._document.untouched_home
        assert info is not None
        frames, self._frames = list(self._frames.values())[:count], {}
        self._job.start(lambda progress: _measure(frames, info, preset, home, progress))

    def _lay_out(self) -> None:
        intro = QLabel(_INTRO)
        intro.setWordWrap(True)
        stored_title, new_title = QLabel("In the preset"), QLabel("New measurement")
        for title in (stored_title, new_title):
            make_verdict(title)
        policy = self.progress.sizePolicy()
        policy.setRetainSizeWhenHidden(True)  # so that the layout does not jump
        self.progress.setSizePolicy(policy)
        self.stored.setAccessibleName("Noise and bias in the preset")
        self.sentence.setAccessibleName("Measured noise and bias")
        row = QHBoxLayout()
        for widget in (self.frames, self.start, self.cancel):
            row.addWidget(widget)
        row.addWidget(self.progress, 1)
        keep = QHBoxLayout()
        keep.addWidget(self.use)
        keep.addStretch(1)
        layout = QVBoxLayout(self)
        layout.addWidget(intro)
        layout.addSpacing(8)
        layout.addWidget(stored_title)
        layout.addWidget(self.stored)
        layout.addSpacing(8)
        layout.addWidget(new_title)
        layout.addLayout(row)
        layout.addWidget(self.sentence)
        layout.addLayout(keep)
        layout.addStretch(1)

    def _done(self, measured: Measured) -> None:
        self.measured = measured
        self._show_busy(False)
        self.sentence.setText("\n".join([*describe(measured.noise), *measured.remarks]))
        self.use.setFocus()  # a focused number entry would handle Ctrl+Z itself

    def _fail(self, sentence: str) -> None:
        self._show_busy(False)
        if sentence:
            self.sentence.setText(f"{sentence[0].upper()}{sentence[1:]}".rstrip(".") + ".")

    def _use(self) -> None:
        assert self.measured is not None
        if self._document.edit("noise", self.measured.noise.model_dump()):
            self.measured = None
            self._show_busy(False)
            self.sentence.setText("The measurement is in the preset now; Ctrl+Z in the main window undoes it.")

    def _forget(self) -> None:
        self.measured = None
        self.sentence.clear()

    def _show_stored(self, *_: object) -> None:
        noise = self._document.preset.noise
        if noise is None:
            self.stored.setText(_NOT_MEASURED)
            return
        day = noise.measured.astimezone().strftime("%Y-%m-%d %H:%M")
        self.stored.setText("\n".join([*describe(noise), f"Measured {day} on {noise.frames} frames."]))

    def _show_busy(self, busy: bool) -> None:
        self.start.setEnabled(not busy)
        self.frames.setEnabled(not busy)
        self.cancel.setEnabled(busy)
        self.progress.setVisible(busy)
        self.use.setEnabled(self.measured is not None and not busy)


def _sentences() -> QLabel:
    """Return a label of several sentences that can be selected."""
    label = QLabel()
    label.setWordWrap(True)
    label.setTextInteractionFlags(
        Qt.TextInteractionFlag.TextSelectableByMouse | Qt.TextInteractionFlag.TextSelectableByKeyboard
    )
    return label


def _measure(
    frames: Sequence[SensorFrame],
    info: SourceInfo,
    preset: Preset,
    home: Path | None,
    progress: Progress,
    remarks: Sequence[str] = (),
) -> Measured:
    found = info.find_untouched(preset, home, lambda share, words: progress(0.3 * share, words))
    said = [*remarks, *found.warnings]
    noise = measure_noise(
        frames,
        info.rig,
        preset,
        found.frame,
        lambda share, words: progress(0.3 + 0.7 * share, words),
        warn=said.append,
    )
    return Measured(noise, tuple(said))


def _measure_simulator(info: SourceInfo, count: int, preset: Preset, home: Path | None, progress: Progress) -> Measured:
    """Measure frames of the simulator, without an object that moves."""
    with open_source(info.name, lambda share, words: progress(0.1 * share, words)) as source:
        remarks = [_OBJECT_REMOVED] if object_moves(source) else []
        with frames_at_rest(source, count, lambda share, words: progress(0.2 * share, words)) as shown:
            frames: list[SensorFrame] = []
            for frame in shown:
                progress(0.2, f"Frame {len(frames) + 1} of {count}")
                frames.append(frame)
    return _measure(frames, info, preset, home, progress, remarks)
