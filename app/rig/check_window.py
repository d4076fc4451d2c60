"""The window that checks the cameras: depth quality, the delay between them, their noise and bias."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from PyQt6.QtCore import QObject
from PyQt6.QtWidgets import QDialog, QLabel, QTabWidget

from ...core.model.frames import SensorFrame
from ...core.preset import Preset, RigNoise
from ...core.rig.noise import MIN_FRAMES, NOISE_FRAMES, describe, measure_noise
from ...core.rig.skew import MAX_GAP_S, Sample, Skew, measure_skew
from ...widgets.basics.controls import make_verdict, push_button, wrapped_label
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ..context import Context
from ..worker.jobs import Progress, Work
from ..worker.results import Result, SourceInfo
from .gather import Gather
from .quality_tab import QualityTab

_NOISE_INTRO: Final = (
    "Hold the sensor and what it sees still. The noise is measured from the differences of successive frames and from "
    "the mean frame on smooth surfaces. The simulator removes its object for this."
)
_BIAS_INTRO: Final = (
    " The bias is measured on prints of the mask's colour, which both cameras see, and where an object is pressed "
    "firmly into the membrane (10 cm² or more)."
)
#: Duration of the measurement of the skew, seconds.
_WATCHED_S: Final = 6.0
_SKEW_INTRO: Final = (
    "For six seconds, press an object into the membrane and pull it out, a few centimetres deep and irregularly. "
    "Both cameras see this motion. The delay at which they agree best is their skew, independent of their time stamps."
)
_SKEW, _SKEW_TIP = 1, "The delay between both cameras, from motion"  # place and tooltip of the tab
DELAY_PATH: Final = "cameras.tactile_delay_s"


class NoiseTab(Gather):
    """The noise of both cameras and the bias between them: what the preset holds, and a new measurement for it."""

    wanted, min_frames = NOISE_FRAMES, MIN_FRAMES

    def __init__(self, context: Context) -> None:
        super().__init__(context, push_button("Measure", "Measure noise and bias into the preset (Ctrl+M)", "Ctrl+M"))
        self.stored = wrapped_label(selectable=True)
        self.stored.setAccessibleName("Noise and bias in the preset")
        title = QLabel("In the preset")
        make_verdict(title)
        self.intro = wrapped_label(_NOISE_INTRO + _BIAS_INTRO)
        vbox(self.intro, 8, self.row(), self.sentence, 8, title, self.stored, STRETCH, within=self)
        self._document.presetChanged.connect(self._show_stored)
        self._show_stored()
        self._show_busy()

    def work(self, kept: list[SensorFrame], info: SourceInfo) -> Work:
        count, preset, home = self.wanted, self._document.preset, self._document.untouched_home
        return lambda progress: _measure(kept[:count], info, preset, home, progress)

    def show_found(self, found: RigNoise) -> None:
        self.sentence.setText("The measurement is in the preset now; Undo (Ctrl+Z) takes it out again.")

    def change(self) -> tuple[str, Any]:
        return "noise", self.found.model_dump()

    def _show_stored(self, *_: object) -> None:
        noise = self._document.preset.noise
        if noise is None:
            self.stored.setText("The rig was not measured: the preset holds no noise and no bias.")
            return
        day = noise.measured.astimezone().strftime("%Y-%m-%d %H:%M")
        self.stored.setText("\n".join([*describe(noise), f"Measured {day} on {noise.frames} frames."]))


def _measure(
    frames: Sequence[SensorFrame], info: SourceInfo, preset: Preset, home: Path | None, progress: Progress
) -> RigNoise:
    untouched = info.find_untouched(preset, home, lambda share, words: progress(0.3 * share, words)).frame
    return measure_noise(frames, info.rig, preset, untouched, lambda share, words: progress(0.3 + 0.7 * share, words))


class SkewTab(Gather):
    """The delay between both cameras, measured from motion that both see, and its compensation."""

    min_frames = 2
    at_rest = False
    prompt = "Press in and pull out now"

    def __init__(self, context: Context) -> None:
        super().__init__(
            context, push_button("Measure skew", "Observe the motion and measure the delay (Ctrl+M)", "Ctrl+M")
        )
        make_verdict(self.sentence)
        vbox(wrapped_label(_SKEW_INTRO), self.row(), self.sentence, STRETCH, within=self)
        self._show_busy()

    def keep(self, frame: SensorFrame) -> Sample:
        return Sample.of(frame)

    def share(self, kept: Sequence[Sample]) -> float:
        steps = np.diff([sample.proximity_time_s for sample in kept])
        return float(steps[(steps > 0) & (steps <= MAX_GAP_S)].sum()) / _WATCHED_S

    def work(self, kept: list[Sample], info: SourceInfo) -> Work:
        """Measure the delay; a loop may have begun anywhere."""
        ordered = sorted(kept, key=lambda sample: sample.proximity_time_s)
        return partial(measure_skew, ordered, info.rig, self._document.preset.alignment)

    def show_found(self, found: Skew) -> None:
        now = " The preset compensates it when cameras are opened again." if found.significant else ""
        self.sentence.setText(found.sentence + now)

    def change(self) -> tuple[str, Any] | None:
        """Return the field and its value. Live time stamps are already corrected by the present one."""
        live = self.info is not None and self.info.length is None
        present = self._document.preset.cameras.tactile_delay_s if live else 0.0
        return (DELAY_PATH, round(self.found.delay_s + present, 4)) if self.found.significant else None


class CheckWindow(QDialog):
    """Depth quality, skew, noise and bias on the source of the main window. A closed window takes no frames."""

    def __init__(self, context: Context) -> None:
        super().__init__(context.window)
        self.setWindowTitle("Check cameras – Tactune")
        self.quality, self.skew, self.noise = QualityTab(context.document), SkewTab(context), NoiseTab(context)
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        for tab, title, tip in (
            (self.quality, "&Quality", "Fill rate and flatness in a region"),
            (self.skew, "&Skew", _SKEW_TIP),
            (self.noise, "&Noise and bias", "The noise of both cameras and the bias between them, for the preset"),
        ):
            self.tabs.setTabToolTip(self.tabs.addTab(tab, title), tip)
        leave = push_button("Close", "Close this window (Esc)")
        leave.clicked.connect(self.reject)
        self.finished.connect(self._end)
        vbox((self.tabs, 1), hbox(STRETCH, leave), within=self)
        self.resize(1040, 760)

    def show_result(self, result: Result) -> None:
        """Take a frame of the main window; without two cameras there is no skew."""
        two = result.source.rig.has_proximity
        if self.tabs.isTabEnabled(_SKEW) != two:
            self.tabs.setTabEnabled(_SKEW, two)
            self.tabs.setTabToolTip(_SKEW, _SKEW_TIP if two else "This rig has one camera: there is no delay")
            self.tabs.setTabText(self.tabs.indexOf(self.noise), "&Noise and bias" if two else "&Noise")
            self.noise.intro.setText(_NOISE_INTRO + (_BIAS_INTRO if two else ""))
        self.quality.show_result(result)

    def _end(self) -> None:
        self.quality.stop()
        self.skew.close_down()
        self.noise.close_down()


class CameraChecks(QObject):
    """Opens at most one window and passes frames to it."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self.window: CheckWindow | None = None
        context.frameShown.connect(self._frame_shown)

    def open_noise(self) -> None:
        self.open()
        assert self.window is not None
        self.window.tabs.setCurrentWidget(self.window.noise)

    def open(self) -> None:
        if self.window is None:
            self.window = CheckWindow(self._context)
        bring_up(self.window)
        self._frame_shown()

    def close(self) -> None:
        if self.window is not None:
            self.window.close()

    def _frame_shown(self) -> None:
        result = self._context.result
        if self.window is not None and result is not None:
            self.window.show_result(result)
