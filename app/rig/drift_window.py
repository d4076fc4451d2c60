"""The check of the rig on the current frame, shown with arrows and in words."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from PyQt6.QtGui import QCloseEvent
from PyQt6.QtWidgets import QDialog, QWidget

from ...core.calibration.check import Drift
from ...core.errors import as_sentence
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import Preset
from ...core.rig.drift import RigCheck, check_rig
from ...widgets.basics.controls import push_button, wrapped_label
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.images.marks import ARROW_FACTOR, Mark
from ...widgets.images.point_image import PointImage
from ..calibration.pictures import picture
from ..worker.jobs import Job

_CHECKING = "Searching the points in the current frame…"


class DriftWindow(QDialog):
    """Checks a frame and shows the drift in pixels and millimetres, and what mends it."""

    def __init__(self, parent: QWidget, calibrate: Callable[[], None], capture: Callable[[], None]) -> None:
        super().__init__(parent)
        self.setWindowTitle("Check for drift")
        self.found: RigCheck | None = None
        self._job = Job(self)
        self.sentence, self.unchecked = wrapped_label(_CHECKING, verdict=True), wrapped_label()
        self.sentence.setMinimumHeight(3 * self.sentence.fontMetrics().lineSpacing())
        self.image = PointImage(
            f"Tactile camera: offset of each point from where the calibration expects it, ×{ARROW_FACTOR:.0f}"
        )
        self.image.set_loupe_wanted(False)
        self.again = push_button("Check &again", "Check on the newest frame (Ctrl+R)", "Ctrl+R")
        self.calibrate = push_button("Ca&librate…", "Open the calibration wizard")
        self.capture = push_button(
            "Capture &untouched frame…", "Average frames of the membrane while nothing touches it"
        )
        leave = push_button("&Close", "Close this window (Esc)")
        row = hbox(STRETCH, self.again, self.calibrate, self.capture, leave)
        vbox(self.sentence, self.unchecked, (self.image, 1), row, within=self)
        self.resize(760, 720)
        self.calibrate.clicked.connect(calibrate)
        self.capture.clicked.connect(capture)
        leave.clicked.connect(self.close)
        self._job.done.connect(self._show)
        self._job.failed.connect(lambda sentence: self.sentence.setText(as_sentence(sentence)))

    def check(self, preset: Preset, preset_path: Path | None, rig: Rig, frame: SensorFrame) -> None:
        """Check a preset on a frame, on another thread; its untouched frame lies beside ``preset_path``."""
        self.sentence.setText(_CHECKING)
        self.unchecked.clear()
        self.calibrate.setVisible(rig.has_proximity)
        self.image.set_marks([])
        self.image.set_image(picture(frame, rig, "tactile", "color").pixels)
        self._job.start(lambda _: check_rig(preset, preset_path, rig, frame))

    def closeEvent(self, event: QCloseEvent | None) -> None:
        self._job.stop()
        super().closeEvent(event)

    def _show(self, found: RigCheck) -> None:
        self.found = found
        self.sentence.setText(as_sentence(found.sentence))
        self.unchecked.setText("" if found.state == "unknown" else " ".join(map(as_sentence, found.unchecked)))
        self.image.set_marks(_marks(found.alignment) if isinstance(found.alignment, Drift) else [])


def _marks(drift: Drift) -> list[Mark]:
    return [
        Mark(str(number), float(place[0]), float(place[1]), arrow=(float(offset[0]), float(offset[1])))
        for number, (place, offset) in enumerate(zip(drift.tactile, drift.offsets_px, strict=True))
    ]
