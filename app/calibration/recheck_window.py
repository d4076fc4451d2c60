"""Re-check of the preset's calibration on the current frame, shown with arrows and in words."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtGui import QCloseEvent
from PyQt6.QtWidgets import QDialog, QWidget

from ...core.calibration.recheck import Drift, recheck
from ...core.errors import TactuneError
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import Preset
from ...core.rig.drift import MembraneDrift, compare_with_untouched
from ...core.rig.untouched import load_untouched
from ...widgets.basics.controls import push_button, wrapped_label
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.images.marks import ARROW_FACTOR, Mark
from ...widgets.images.point_image import PointImage
from ..worker.jobs import Job
from .pictures import picture

_CHECKING = "Searching the points in the current frame…"
_NO_UNTOUCHED = (
    "The inflation was not checked: this preset has no untouched frame. Capture one while nothing touches the "
    "membrane, with Analysis > Capture untouched frame…"
)
_LOST = "The inflation was not checked: the preset's untouched frame cannot be found; capture it again."


#: Result of a check: drift of the alignment and of the membrane, or for each the reason why it was not checked.
Rechecked = tuple[Drift | str, MembraneDrift | str]


def recheck_all(preset: Preset, preset_path: Path | None, rig: Rig, frame: SensorFrame) -> Rechecked:
    """Check the alignment, and compare the membrane with the preset's untouched frame if there is one."""
    alignment: Drift | str
    membrane: MembraneDrift | str = _NO_UNTOUCHED if preset.untouched is None else _LOST
    try:
        alignment = recheck(preset, rig, frame)
    except TactuneError as error:
        alignment = f"The alignment was not checked: {error}."
    if preset.untouched is not None and preset_path is not None:
        try:
            untouched = load_untouched(preset.untouched, preset_path)
            membrane = compare_with_untouched(preset, rig, frame, untouched)
        except TactuneError as error:
            membrane = f"The inflation was not checked: {error}."
    return alignment, membrane


class RecheckWindow(QDialog):
    """Checks a frame and shows the drift in pixels and millimetres, and whether to calibrate again."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Re-check calibration – Tactune")
        self.drift: Drift | None = None
        self._job = Job(self)
        self.sentence, self.membrane = wrapped_label(_CHECKING, verdict=True), wrapped_label(verdict=True)
        self.image = PointImage(
            f"Tactile camera: offset of each point from where the calibration expects it, ×{ARROW_FACTOR:.0f}"
        )
        self.image.set_loupe_wanted(False)
        self.again = push_button("Check again", "Check on the newest frame (Ctrl+R)", "Ctrl+R")
        self.calibrate = push_button("Calibrate…", "Open the calibration wizard")
        leave = push_button("Close", "Close this window")
        row = hbox(STRETCH, self.again, self.calibrate, leave)
        vbox(self.sentence, self.membrane, (self.image, 1), row, within=self)
        self.resize(760, 720)
        leave.clicked.connect(self.close)
        self._job.done.connect(self._show)
        self._job.failed.connect(lambda sentence: self._show((sentence, "")))

    def check(self, preset: Preset, rig: Rig, frame: SensorFrame, preset_path: Path | None = None) -> None:
        """Check a preset on a frame, on another thread; its untouched frame lies beside ``preset_path``."""
        self.sentence.setText(_CHECKING)
        self.membrane.setText("")
        self.image.set_image(picture(frame, rig, "tactile", "color").pixels)
        self._job.start(lambda _: recheck_all(preset, preset_path, rig, frame))

    def closeEvent(self, event: QCloseEvent | None) -> None:
        self._job.stop()
        super().closeEvent(event)

    def _show(self, found: Rechecked) -> None:
        alignment, membrane = found
        self.drift = alignment if isinstance(alignment, Drift) else None
        self.sentence.setText(alignment if isinstance(alignment, str) else alignment.sentence)
        self.membrane.setText(membrane if isinstance(membrane, str) else membrane.sentence)
        self.image.set_marks([] if self.drift is None else _marks(self.drift))


def _marks(drift: Drift) -> list[Mark]:
    return [
        Mark(str(number), float(place[0]), float(place[1]), arrow=(float(offset[0]), float(offset[1])))
        for number, (place, offset) in enumerate(zip(drift.tactile, drift.offsets_px, strict=True))
    ]
