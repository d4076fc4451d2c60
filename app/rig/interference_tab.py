"""Does the proximity camera's laser disturb the tactile camera? A test at the press of a button."""

from __future__ import annotations

from html import escape

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QProgressBar, QPushButton, QVBoxLayout, QWidget

from ...core.rig.interference import Half, Interference
from ...core.sources.base import CameraOption
from ..worker.results import Result
from ..worker.worker import Worker
from .interference_flow import InterferenceFlow
from .parts import keep_place, make_verdict

_INTRO = (
    "Leave the scene at rest. The proximity camera's laser is left on and then switched off, for a few seconds each, "
    "and the tactile camera's fill rate and temporal noise are compared. Then the laser is as it was."
)
_NO_FRAME = "There is no frame yet: open the cameras in the main window first."
_NO_CAMERAS = (
    "This source has no camera that can be switched: it is a recording or the simulator, or the camera is not "
    "connected. Open the live cameras in the main window (F3)."
)
_NO_SWITCH = (
    "The proximity camera has neither the option emitter_enabled nor a laser_power that goes down to 0, so its laser "
    "cannot be switched off from here. Cover it by hand and compare the readings of the Quality tab instead."
)


class InterferenceTab(QWidget):
    """Runs the test and shows what it found."""

    def __init__(self, worker: Worker) -> None:
        super().__init__()
        self.flow = InterferenceFlow(worker, self)
        self._result: Result | None = None
        self.found: Interference | None = None
        self.start = QPushButton("Test interference")
        self.cancel = QPushButton("Cancel")
        self.progress = QProgressBar()
        self.sentence = _label()
        self.remedy = _label()
        self.numbers = _label()
        self._lay_out()
        self.start.clicked.connect(self._begin)
        self.cancel.clicked.connect(self.flow.cancel)
        self.flow.progress.connect(self._show_progress)
        self.flow.done.connect(self._done)
        self.flow.failed.connect(self._fail)
        worker.optionRefused.connect(self.flow.refuse)
        self._show_busy(False)

    def show_result(self, result: Result) -> None:
        """Take a frame of the main window."""
        self._result = result
        self.flow.take(result)

    def set_options(self, options: tuple[CameraOption, ...]) -> None:
        """Take the settings of the source's cameras."""
        self.flow.set_options(options)

    def close_down(self) -> None:
        """Give up for good; the laser is put back."""
        self.flow.stop()
        self._show_busy(False)

    def _lay_out(self) -> None:
        intro = QLabel(_INTRO)
        intro.setWordWrap(True)
        self.start.setToolTip("Compare the tactile camera with the proximity camera's laser on and off (Ctrl+T)")
        self.start.setShortcut("Ctrl+T")
        self.cancel.setToolTip("Give the test up; the laser is put back at once")
        keep_place(self.progress)
        make_verdict(self.sentence)
        row = QHBoxLayout()
        row.addWidget(self.start)
        row.addWidget(self.cancel)
        row.addWidget(self.progress, 1)
        layout = QVBoxLayout(self)
        layout.addWidget(intro)
        layout.addLayout(row)
        layout.addSpacing(8)
        layout.addWidget(self.sentence)
        layout.addWidget(self.remedy)
        layout.addSpacing(8)
        layout.addWidget(self.numbers)
        layout.addStretch(1)
        for button in (self.start, self.cancel):
            button.setAutoDefault(False)

    def _begin(self) -> None:
        self._clear()
        if self._result is None:
            self._fail(_NO_FRAME)
        elif not self.flow.has_proximity_camera:
            self._fail(_NO_CAMERAS)
        elif self.flow.switch is None:
            self._fail(_NO_SWITCH)
        else:
            self._show_busy(True)
            self.flow.start(self._result.source)

    def _done(self, found: Interference) -> None:
        self.found = found
        self._show_busy(False)
        self.sentence.setText(found.sentence)
        self.remedy.setText(found.remedy)
        self.numbers.setText(_table(found))

    def _fail(self, sentence: str) -> None:
        self._show_busy(False)
        self.sentence.setText(f"{sentence[:1].upper()}{sentence[1:]}")

    def _clear(self) -> None:
        self.found = None
        for label in (self.sentence, self.remedy, self.numbers):
            label.clear()

    def _show_busy(self, busy: bool) -> None:
        self.start.setEnabled(not busy)
        self.cancel.setEnabled(busy)
        self.progress.setVisible(busy)

    def _show_progress(self, share: float, words: str) -> None:
        self.progress.setValue(round(100 * share))
        self.progress.setFormat(f"{words} – %p %")


def _table(found: Interference) -> str:
    rows = [
        ("", "laser on", "laser off"),
        ("Fill rate", f"{100 * found.on.fill_rate:.1f} %", f"{100 * found.off.fill_rate:.1f} %"),
        ("Temporal noise", _noise(found.on), _noise(found.off)),
        ("Frames", str(found.on.frames), str(found.off.frames)),
    ]
    cells = "".join(
        "<tr>" + "".join(f"<td style='padding:2px 18px 2px 0'>{escape(cell)}</td>" for cell in row) + "</tr>"
        for row in rows
    )
    return f"<table>{cells}</table>"


def _noise(half: Half) -> str:
    return (
        "not known" if half.noise_m != half.noise_m else f"{1e3 * half.noise_m:.2f} mm, {100 * half.noise_share:.2f} %"
    )


def _label() -> QLabel:
    label = QLabel()
    label.setWordWrap(True)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    return label
