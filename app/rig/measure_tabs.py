"""The measurements of the window Check cameras that take frames: noise and bias, and the delay between the cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from PyQt6.QtWidgets import QDoubleSpinBox, QLabel

from ...core.model.frames import SensorFrame
from ...core.preset import Preset, RigNoise
from ...core.rig.noise import MAX_FRAMES, MIN_FRAMES, NOISE_FRAMES, describe, measure_noise
from ...core.rig.skew import MAX_GAP_S, MIN_TIME_S, Sample, Skew, measure_skew
from ...widgets.basics.controls import frame_count, make_verdict, push_button, wrapped_label
from ...widgets.basics.layouts import STRETCH, vbox
from ..context import Context
from ..worker.jobs import Progress, Work
from ..worker.results import SourceInfo
from .gather import Gather

_NOISE_INTRO: Final = (
    "Hold the sensor and what it sees still. The noise is measured from the differences of successive frames and from "
    "the mean frame on smooth surfaces. The bias is measured on prints of the mask's colour, which both cameras see, "
    "and where an object is pressed firmly into the membrane (10 cm² or more). The "
    "simulator removes its object for this."
)
_SKEW_INTRO: Final = (
    "Press an object into the membrane and pull it out, several times, a few centimetres deep and irregularly. "
    "Both cameras see this motion. The delay at which they agree best is their skew, independent of their time stamps."
)
DELAY_PATH: Final = "cameras.tactile_delay_s"


@dataclass(frozen=True)
class Measured:
    """A measurement of the noise, and further sentences to show below it."""

    noise: RigNoise
    remarks: list[str]


class NoiseTab(Gather):
    """The noise of both cameras and the bias between them: what the preset holds, and a new measurement."""

    min_frames = MIN_FRAMES

    def __init__(self, context: Context) -> None:
        self.frames = frame_count(MAX_FRAMES, "Number of frames to measure; more are more accurate", NOISE_FRAMES)
        self.frames.setMinimum(MIN_FRAMES)
        self.frames.setAccessibleName("Frames to measure")
        start = push_button("Measure", "Measure noise and bias on the current source (Ctrl+M)", "Ctrl+M")
        use = push_button("Use in preset", "Store this measurement in the preset (Ctrl+U)", "Ctrl+U")
        super().__init__(context, start, self.frames, use)
        self.stored = wrapped_label(selectable=True)
        self.stored.setAccessibleName("Noise and bias in the preset")
        self.sentence.setAccessibleName("Measured noise and bias")
        titles = QLabel("In the preset"), QLabel("New measurement")
        for title in titles:
            make_verdict(title)
        vbox(
            wrapped_label(_NOISE_INTRO), 8, titles[0], self.stored, 8, titles[1], self.taking_row(), self.sentence,
            self.applying_row(), STRETCH, within=self,
        )  # fmt: skip
        self._document.presetChanged.connect(self._show_stored)
        self._show_stored()
        self._show_busy()

    def work(self, kept: list[SensorFrame], info: SourceInfo) -> Work:
        """Measure the frames."""
        count, preset, home = self.frames.value(), self._document.preset, self._document.untouched_home
        return lambda progress: _measure(kept[:count], info, preset, home, progress)

    def show_found(self, found: Measured | None) -> None:
        """Show a measurement."""
        if found is not None:
            self.sentence.setText("\n".join([*describe(found.noise), *found.remarks]))

    def change(self) -> tuple[str, Any]:
        """Return the field and its value."""
        return "noise", self.found.noise.model_dump()

    def _show_stored(self, *_: object) -> None:
        noise = self._document.preset.noise
        if noise is None:
            self.stored.setText("The rig was not measured: the preset holds no noise and no bias.")
            return
        day = noise.measured.astimezone().strftime("%Y-%m-%d %H:%M")
        self.stored.setText("\n".join([*describe(noise), f"Measured {day} on {noise.frames} frames."]))


def _measure(
    frames: Sequence[SensorFrame], info: SourceInfo, preset: Preset, home: Path | None, progress: Progress
) -> Measured:
    found = info.find_untouched(preset, home, lambda share, words: progress(0.3 * share, words))
    said = list(found.warnings)

    def report(share: float, words: str) -> None:
        progress(0.3 + 0.7 * share, words)

    return Measured(measure_noise(frames, info.rig, preset, found.frame, report, warn=said.append), said)


class SkewTab(Gather):
    """The delay between both cameras, measured from motion that both see, and its compensation."""

    min_frames = 2
    at_rest = False
    prompt = "Press in and pull out now"

    def __init__(self, context: Context) -> None:
        self.seconds = QDoubleSpinBox()
        self.seconds.setRange(MIN_TIME_S, 30.0)
        self.seconds.setValue(6.0)
        self.seconds.setDecimals(0)
        self.seconds.setSuffix(" s")
        self.seconds.setAccessibleName("Duration")
        self.seconds.setToolTip("Duration of the measurement in seconds; longer is more accurate")
        start = push_button("Measure skew", "Observe the motion and measure the delay (Ctrl+M)", "Ctrl+M")
        use = push_button("Compensate", "Set the preset's tactile delay; it takes effect when cameras are opened again")
        super().__init__(context, start, self.seconds, use)
        make_verdict(self.sentence)
        row = self.taking_row(QLabel("Watch for"))
        vbox(wrapped_label(_SKEW_INTRO), row, self.sentence, self.applying_row(), STRETCH, within=self)
        self._show_busy()

    def keep(self, frame: SensorFrame) -> Sample:
        """Return the frame, subsampled."""
        return Sample.of(frame)

    def share(self, kept: Sequence[Sample]) -> float:
        """Return which share of the duration the frames cover according to their own stamps."""
        steps = np.diff([sample.proximity_time_s for sample in kept])
        return float(steps[(steps > 0) & (steps <= MAX_GAP_S)].sum()) / self.seconds.value()

    def work(self, kept: list[Sample], info: SourceInfo) -> Work:
        """Measure the delay; a loop may have begun anywhere."""
        ordered = sorted(kept, key=lambda sample: sample.proximity_time_s)
        return partial(measure_skew, ordered, info.rig, self._document.preset.alignment)

    def show_found(self, found: Skew | None) -> None:
        """Show a measurement."""
        if found is not None:
            self.sentence.setText(found.sentence)
            self.apply.setText(f"Set the tactile delay to {1e3 * self.change()[1]:.1f} ms")

    def change(self) -> tuple[str, Any]:
        """Return the field and its value. Live time stamps are already corrected by the present one."""
        live = self.info is not None and self.info.length is None
        present = self._document.preset.cameras.tactile_delay_s if live else 0.0
        return DELAY_PATH, round(self.found.delay_s + present, 4)

    def _show_busy(self) -> None:
        super()._show_busy()
        if self.found is not None and not self.found.significant:
            self.apply.setEnabled(False)
