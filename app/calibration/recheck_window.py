"""Re-check of the preset's calibration on the current frame, shown with arrows and in words."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QCloseEvent
from PyQt6.QtWidgets import QComboBox, QDialog, QGridLayout, QLabel, QWidget

from ...core.calibration.recheck import Drift, recheck
from ...core.errors import TactuneError, minus
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import Preset
from ...core.rig.drift import DepthChange, MembraneDrift, compare_with_untouched
from ...core.rig.untouched import load_untouched
from ...widgets.basics.controls import push_button, wrapped_label
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.images.marks import Mark, MarkKind
from ...widgets.images.point_image import PointImage
from ..worker.jobs import Job
from .pictures import picture
from .session import ImageChoice

_FACTORS = {"Arrows ×1": 1.0, "Arrows ×10": 10.0, "Arrows ×30": 30.0}
_CHECKING = "Searching the points in the current frame…"
_WORST_SHARE = 0.95
_NO_UNTOUCHED = (
    "The inflation was not checked: this preset has no untouched frame. Capture one while nothing touches the "
    "membrane, with Analysis > Capture untouched frame…"
)
_LOST = "The inflation was not checked: the preset's untouched frame cannot be found; capture it again."


@dataclass(frozen=True)
class Rechecked:
    """Result of a check: drift of the alignment and of the membrane, or for each the reason why it was not checked."""

    alignment: Drift | str
    membrane: MembraneDrift | str


def recheck_all(preset: Preset, preset_path: Path | None, rig: Rig, frame: SensorFrame) -> Rechecked:
    """Check the alignment, and compare the membrane with the preset's untouched frame if there is one."""
    alignment: Drift | str
    membrane: MembraneDrift | str = _NO_UNTOUCHED if preset.untouched is None else _LOST
    try:
        alignment = recheck(preset, rig, frame)
    except TactuneError as error:
        alignment = _sentence(error)
    if preset.untouched is not None and preset_path is not None:
        try:
            untouched = load_untouched(preset.untouched, preset_path)
            membrane = compare_with_untouched(preset, rig, frame, untouched)
        except TactuneError as error:
            membrane = f"The inflation was not checked: {error}."
    return Rechecked(alignment, membrane)


class RecheckWindow(QDialog):
    """Checks a frame and shows the drift in pixels and millimetres, and whether to calibrate again."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Re-check calibration – Tactune")
        self.drift: Drift | None = None
        self.membrane_drift: MembraneDrift | None = None
        self._job = Job(self)
        self.sentence = wrapped_label(_CHECKING, verdict=True)
        self.membrane = wrapped_label(verdict=True)
        self.membrane.setToolTip(
            "Change of the membrane's tactile and proximity depth since the preset's untouched frame"
        )
        self.image = PointImage("Tactile camera: offset of each point from where the calibration expects it")
        self.image.set_loupe_wanted(False)
        self.numbers = QGridLayout()
        self.factor = QComboBox()
        self.factor.addItems(list(_FACTORS))
        self.factor.setCurrentIndex(1)
        self.factor.setAccessibleName("Arrows")
        self.factor.setToolTip("Enlargement of the arrows, which show offsets in proximity pixels")
        self.again = push_button("Check again", "Check on the newest frame (Ctrl+R)")
        self.again.setShortcut("Ctrl+R")
        self.calibrate = push_button("Calibrate…", "Open the calibration wizard")
        self.leave = push_button("Close", "Close this window")
        row = hbox(self.factor, STRETCH, self.again, self.calibrate, self.leave)
        vbox(self.sentence, self.membrane, self.numbers, (self.image, 1), row, within=self)
        self.resize(760, 720)
        self.factor.currentTextChanged.connect(lambda text: self.image.layer.set_arrow_factor(_FACTORS[text]))
        self.image.layer.set_arrow_factor(_FACTORS[self.factor.currentText()])
        self.leave.clicked.connect(self.close)
        self._job.done.connect(self._show)
        self._job.failed.connect(self._fail)

    def check(self, preset: Preset, rig: Rig, frame: SensorFrame, preset_path: Path | None = None) -> None:
        """Check a preset on a frame, on another thread; its untouched frame lies beside ``preset_path``."""
        self.sentence.setText(_CHECKING)
        self.membrane.setText("")
        choice: ImageChoice = "color" if frame.tactile_color is not None else "depth"
        self.image.set_image(picture(frame, rig, "tactile", choice, stretch=True).pixels)
        self._job.start(lambda _: recheck_all(preset, preset_path, rig, frame))

    def closeEvent(self, event: QCloseEvent | None) -> None:
        """Cancel running jobs."""
        self._job.stop()
        super().closeEvent(event)

    def _show(self, found: Rechecked) -> None:
        self.drift = found.alignment if isinstance(found.alignment, Drift) else None
        self.membrane_drift = found.membrane if isinstance(found.membrane, MembraneDrift) else None
        self.sentence.setText(found.alignment if isinstance(found.alignment, str) else found.alignment.sentence)
        self.membrane.setText(found.membrane if isinstance(found.membrane, str) else found.membrane.sentence)
        self._show_numbers(*_alignment_rows(self.drift), *_membrane_rows(self.membrane_drift))
        self.image.set_marks([] if self.drift is None else _marks(self.drift))

    def _fail(self, sentence: str) -> None:
        self._show(Rechecked(sentence, ""))

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


def _alignment_rows(drift: Drift | None) -> list[tuple[str, str]]:
    if drift is None:
        return []
    return [
        ("Drift, median", f"{drift.drift_px:.2f} px, {drift.drift_mm:.2f} mm"),
        ("95 % of the points within", f"{drift.worst_px:.2f} px"),
        (
            "Clicked points found again",
            f"{drift.found} of {drift.stored}" if drift.stored else "none stored in the preset",
        ),
        ("Points compared", str(len(drift.tactile))),
    ]


def _membrane_rows(drift: MembraneDrift | None) -> list[tuple[str, str]]:
    if drift is None:
        return []
    return [
        ("Tactile depth changed by", _change(drift.tactile)),
        ("Proximity depth changed by", _change(drift.proximity)),
    ]


def _change(change: DepthChange | None) -> str:
    if change is None:
        return "not seen"
    return minus(f"{1e3 * change.median_m:+.2f} mm, spread {1e3 * change.spread_m:.2f} mm")


def _marks(drift: Drift) -> list[Mark]:
    lengths = (drift.offsets_px**2).sum(axis=1) ** 0.5
    return [
        Mark(
            str(number),
            float(place[0]),
            float(place[1]),
            kind=MarkKind.WORST if length > _WORST_SHARE * drift.worst_px else MarkKind.POINT,
            arrow=(float(offset[0]), float(offset[1])),
        )
        for number, (place, offset, length) in enumerate(zip(drift.tactile, drift.offsets_px, lengths, strict=True))
    ]


def _sentence(error: TactuneError) -> str:
    text = str(error)
    return text[:1].upper() + text[1:]
