"""The noise of both cameras and the bias between them: what the preset holds, and a new measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QLabel

from ...core.errors import counted
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
from ...widgets.basics.controls import frame_count, make_verdict, push_button, wrapped_label
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ..document.document import Document
from ..worker.jobs import Progress
from ..worker.results import Result, SourceInfo
from ..worker.worker import Worker
from .gathering import NO_FRAME, OTHER_SOURCE, GatheringTab

_SIMULATOR: Final = "sim:"
_INTRO = (
    "Hold the sensor and what it sees still. The noise is measured from the differences of successive frames and from "
    "the mean frame on smooth surfaces. The bias is measured on prints of the mask's colour, which both cameras see, "
    "and where an object is pressed firmly into the membrane (10 cm² or more)."
)
_NOT_MEASURED = "The rig was not measured: the preset holds no noise and no bias."
_OBJECT_REMOVED = "The simulator's object moves, so it was removed for the measurement."


@dataclass(frozen=True)
class Measured:
    """A measurement, and further sentences to show below it."""

    noise: RigNoise
    remarks: tuple[str, ...]


class NoiseTab(GatheringTab):
    """Measures frames of the main window, and puts the result into the preset."""

    def __init__(self, worker: Worker, document: Document) -> None:
        self.frames = frame_count(MAX_FRAMES, "Number of frames to measure; more are more accurate", NOISE_FRAMES)
        self.frames.setMinimum(MIN_FRAMES)
        self.frames.setAccessibleName("Frames to measure")
        start = push_button("Measure", "Measure noise and bias on the current source (Ctrl+M)", "Ctrl+M")
        cancel = push_button("Cancel", "Cancel this measurement; the preset is unchanged")
        super().__init__(worker, document, start, cancel, self.frames, gathered_share=0.5)
        self._frames: dict[int, SensorFrame] = {}
        self.measured: Measured | None = None
        self.stored = QLabel()
        self.use = push_button(
            "Use in preset",
            "Store this measurement in the preset (Ctrl+U); Ctrl+Z in the main window undoes it",
            "Ctrl+U",
        )
        self._lay_out()
        self.use.clicked.connect(self._use)
        document.presetChanged.connect(self._show_stored)
        self._show_stored()
        self._show_busy(False)

    def show_result(self, result: Result) -> None:
        """Note the source of a frame of the main window. The worker passes all frames on."""
        self._result = result
        if self._info is not None and result.source is not self._info:
            self._info = None
            if self.busy or self.measured is not None:
                self.measured = None
                self.stop()
                self.use.setEnabled(False)
                self.sentence.setText(OTHER_SOURCE)

    def begin(self) -> None:
        """Start collecting frames; the simulator's are read by the job itself."""
        if self.busy:
            return
        self.measured = None
        self.sentence.clear()
        if self._result is None:
            self._fail(NO_FRAME)
            return
        info = self._info = self._result.source
        if info.length is not None and info.length < MIN_FRAMES:
            self._fail(f"This source has {counted(info.length, 'frame')}; the noise needs at least {MIN_FRAMES}.")
            return
        if info.name.startswith(_SIMULATOR):
            self._show_busy(True)
            count, preset, home = self.frames.value(), self._document.preset, self._document.untouched_home
            self._job.start(lambda progress: _measure_simulator(info, count, preset, home, progress))
            return
        frames: dict[int, SensorFrame] = {}
        self._frames = frames
        self._gather(lambda frame: frames.setdefault(frame.sequence, frame))  # a loop gives each frame once

    def _gathered(self) -> tuple[int, float, str]:
        count = len(self._frames)
        return count, count / self._wanted(), f"Hold everything still: {counted(count, 'frame')}"

    def _are_enough(self) -> bool:
        return len(self._frames) >= MIN_FRAMES

    def _wanted(self) -> int:
        assert self._info is not None
        return min(self.frames.value(), self._info.length or MAX_FRAMES)

    def _measure(self) -> None:
        info, preset, home = self._info, self._document.preset, self._document.untouched_home
        assert info is not None
        frames, self._frames = list(self._frames.values())[: self._wanted()], {}
        self._job.start(lambda progress: _measure(frames, info, preset, home, progress))

    def _lay_out(self) -> None:
        intro = wrapped_label(_INTRO)
        stored_title, new_title = QLabel("In the preset"), QLabel("New measurement")
        for title in (stored_title, new_title):
            make_verdict(title)
        for label in (self.stored, self.sentence):
            label.setWordWrap(True)
            label.setTextInteractionFlags(
                Qt.TextInteractionFlag.TextSelectableByMouse | Qt.TextInteractionFlag.TextSelectableByKeyboard
            )
        self.stored.setAccessibleName("Noise and bias in the preset")
        self.sentence.setAccessibleName("Measured noise and bias")
        keep = hbox(self.use, STRETCH)
        vbox(intro, 8, stored_title, self.stored, 8, new_title, self._row(), self.sentence, keep, STRETCH, within=self)

    def _done(self, measured: Measured) -> None:
        self.measured = measured
        self._show_busy(False)
        self.sentence.setText("\n".join([*describe(measured.noise), *measured.remarks]))
        self.use.setFocus()  # a focused number entry would handle Ctrl+Z itself

    def _use(self) -> None:
        assert self.measured is not None
        if self._document.edit("noise", self.measured.noise.model_dump()):
            self.measured = None
            self._show_busy(False)
            self.sentence.setText("The measurement is in the preset now; Ctrl+Z in the main window undoes it.")

    def _show_stored(self, *_: object) -> None:
        noise = self._document.preset.noise
        if noise is None:
            self.stored.setText(_NOT_MEASURED)
            return
        day = noise.measured.astimezone().strftime("%Y-%m-%d %H:%M")
        self.stored.setText("\n".join([*describe(noise), f"Measured {day} on {noise.frames} frames."]))

    def _show_busy(self, busy: bool) -> None:
        super()._show_busy(busy)
        self.use.setEnabled(self.measured is not None and not busy)


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
