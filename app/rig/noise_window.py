"""The window that measures the noise of both cameras and the bias between them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from PyQt6.QtCore import QObject
from PyQt6.QtWidgets import QDialog, QLabel

from ...core.model.frames import SensorFrame
from ...core.preset import Preset, RigNoise
from ...core.rig.noise import MIN_FRAMES, NOISE_FRAMES, describe, measure_noise
from ...widgets.basics.controls import make_verdict, push_button, wrapped_label
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ..context import Context
from ..worker.jobs import Progress, Work
from ..worker.results import Result, SourceInfo
from .gather import Gather

_NOISE_INTRO: Final = (
    "Hold the sensor and what it sees still. The noise is measured from the differences of successive frames and from "
    "the mean frame on smooth surfaces. The simulator removes its object for this."
)
_BIAS_INTRO: Final = (
    " The bias is measured on prints of the mask's colour, which both cameras see, and where an object is pressed "
    "firmly into the membrane (1,000 mm² or more)."
)


class NoisePanel(Gather):
    """The noise of both cameras and the bias between them: what the preset holds, and a new measurement for it."""

    wanted, min_frames = NOISE_FRAMES, MIN_FRAMES

    def __init__(self, context: Context) -> None:
        super().__init__(context, push_button("&Measure", "Measure noise and bias into the preset (Ctrl+M)", "Ctrl+M"))
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

    def changes(self) -> dict[str, Any]:
        return {"noise": self.found.model_dump()}

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


class NoiseWindow(QDialog):
    """Noise and bias of the source of the main window. A closed window takes no frames."""

    def __init__(self, context: Context) -> None:
        super().__init__(context.window)
        self.setWindowTitle("Noise and bias – Tactune")
        self.panel = NoisePanel(context)
        leave = push_button("&Close", "Close this window (Esc)")
        leave.clicked.connect(self.reject)
        self.finished.connect(lambda _: self.panel.close_down())
        vbox((self.panel, 1), hbox(STRETCH, leave), within=self)
        self.resize(720, 460)

    def show_result(self, result: Result) -> None:
        """Take a frame of the main window; one camera has no bias."""
        self.panel.intro.setText(_NOISE_INTRO + (_BIAS_INTRO if result.source.rig.has_proximity else ""))


class NoiseControl(QObject):
    """Opens at most one window and passes frames to it."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self.window: NoiseWindow | None = None
        context.frameShown.connect(self._frame_shown)

    def open(self) -> None:
        if self.window is None:
            self.window = NoiseWindow(self._context)
        bring_up(self.window)
        self._frame_shown()

    def close(self) -> None:
        if self.window is not None:
            self.window.close()

    def _frame_shown(self) -> None:
        result = self._context.result
        if self.window is not None and result is not None:
            self.window.show_result(result)
