"""Does the preset's calibration still hold? The answer on the present frame, with arrows and in words."""

from __future__ import annotations

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtGui import QCloseEvent, QFont
from PyQt6.QtWidgets import QComboBox, QDialog, QGridLayout, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from ...core.calibration.recheck import Drift, recheck
from ...core.frames import Rig, SensorFrame
from ...core.preset import Preset
from ...widgets.marks import Mark, MarkKind
from ...widgets.point_image import PointImage
from .jobs import Job
from .pictures import picture
from .state import ImageChoice

_FACTORS = {"Arrows ×1": 1.0, "Arrows ×10": 10.0, "Arrows ×30": 30.0}
_CHECKING = "Looking the points up on the present frame…"
_WORST_SHARE = 0.95


class RecheckWindow(QDialog):
    """Runs the check on a frame and shows drift, in pixels and millimetres, and whether to calibrate again.

    Signals
    -------
    againRequested()
        Check on the newest frame.
    calibrateRequested()
    """

    againRequested = pyqtSignal()
    calibrateRequested = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Re-check calibration – Tactune")
        self.drift: Drift | None = None
        self._job = Job(self)
        self.sentence = QLabel(_CHECKING)
        self.sentence.setWordWrap(True)
        font = QFont(self.sentence.font())
        font.setPointSizeF(1.2 * font.pointSizeF())
        font.setBold(True)
        self.sentence.setFont(font)
        self.image = PointImage("Tactile camera: where the proximity camera finds each place, from where it should be")
        self.image.set_loupe_wanted(False)
        self.numbers = QGridLayout()
        self.factor = QComboBox()
        self.factor.addItems(list(_FACTORS))
        self.factor.setCurrentIndex(1)
        self.factor.setAccessibleName("Arrows")
        self.factor.setToolTip("Enlargement of the arrows; they are offsets in proximity pixels")
        self.again = _push("Check again", "Check on the newest frame (Ctrl+R)")
        self.again.setShortcut("Ctrl+R")
        self.calibrate = _push("Calibrate…", "Open the calibration wizard")
        self.leave = _push("Close", "Close this window")
        row = QHBoxLayout()
        row.addWidget(self.factor)
        row.addStretch(1)
        for button in (self.again, self.calibrate, self.leave):
            row.addWidget(button)
        layout = QVBoxLayout(self)
        layout.addWidget(self.sentence)
        layout.addLayout(self.numbers)
        layout.addWidget(self.image, 1)
        layout.addLayout(row)
        self.resize(760, 720)
        self.factor.currentTextChanged.connect(lambda text: self.image.layer.set_arrow_factor(_FACTORS[text]))
        self.image.layer.set_arrow_factor(_FACTORS[self.factor.currentText()])
        self.again.clicked.connect(self.againRequested)
        self.calibrate.clicked.connect(self.calibrateRequested)
        self.leave.clicked.connect(self.close)
        self._job.done.connect(self._show)
        self._job.failed.connect(self._fail)

    def check(self, preset: Preset, rig: Rig, frame: SensorFrame) -> None:
        """Check a preset on a frame, on another thread."""
        self.sentence.setText(_CHECKING)
        choice: ImageChoice = "color" if frame.tactile_color is not None else "depth"
        self.image.set_image(picture(frame, rig, "tactile", choice, stretch=True).pixels)
        self._job.start(lambda _: recheck(preset, rig, frame))

    def closeEvent(self, event: QCloseEvent | None) -> None:
        """Stop what is under way."""
        self._job.stop()
        super().closeEvent(event)

    def _show(self, drift: Drift) -> None:
        self.drift = drift
        self.sentence.setText(drift.sentence)
        stored = f"{drift.found} of {drift.stored}" if drift.stored else "none stored in the preset"
        self._show_numbers(
            ("Drift, median", f"{drift.drift_px:.2f} px, {drift.drift_mm:.2f} mm"),
            ("95 % of the places within", f"{drift.worst_px:.2f} px"),
            ("Clicked points found again", stored),
            ("Places compared", str(len(drift.tactile))),
        )
        self.image.set_marks(
            [
                Mark(
                    number,
                    float(place[0]),
                    float(place[1]),
                    kind=MarkKind.WORST if length > _WORST_SHARE * drift.worst_px else MarkKind.POINT,
                    arrow=(float(offset[0]), float(offset[1])),
                )
                for number, (place, offset, length) in enumerate(
                    zip(drift.tactile, drift.offsets_px, (drift.offsets_px**2).sum(axis=1) ** 0.5, strict=True)
                )
            ]
        )

    def _fail(self, sentence: str) -> None:
        self.drift = None
        self.sentence.setText(sentence[:1].upper() + sentence[1:])
        self.image.set_marks([])
        self._show_numbers()

    def _show_numbers(self, *rows: tuple[str, str]) -> None:
        while (item := self.numbers.takeAt(0)) is not None:
            widget = item.widget()
            if widget is not None:
                widget.deleteLater()
        for number, (title, value) in enumerate(rows):
            shown = QLabel(value)
            shown.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            self.numbers.addWidget(QLabel(title), number // 2, 2 * (number % 2))
            self.numbers.addWidget(shown, number // 2, 2 * (number % 2) + 1)
        self.numbers.setColumnStretch(1, 1)
        self.numbers.setColumnStretch(3, 1)


def _push(text: str, tip: str) -> QPushButton:
    button = QPushButton(text)
    button.setToolTip(tip)
    button.setAutoDefault(False)
    return button
