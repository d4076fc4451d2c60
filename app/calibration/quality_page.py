"""The page that shows how good the calibration is, where, and what to do next, and where the model is chosen."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QShowEvent
from PyQt6.QtWidgets import QComboBox, QFormLayout, QWidget

from ...core.calibration.geometry import proximity_pixels
from ...core.calibration.report import CalibrationReport, grade, millimetres_per_pixel
from ...core.model.arrays import Uint8Array
from ...core.model.frames import SensorFrame
from ...widgets.basics.colormaps import ends_legend
from ...widgets.basics.controls import wrapped_label
from ...widgets.basics.layouts import STRETCH, hbox, holding, scrolling, vbox
from ...widgets.basics.theme import text_font
from ...widgets.images.point_image import PointImage
from ...widgets.images.strip_render import color_pane
from ..worker.jobs import Job
from .fitting import Outcome, image_marks
from .pictures import membrane_grid, picture
from .session import Session, SessionState

_STEP_PX = 8
_COARSE = 4
_OPACITY = 0.62
#: Upper end of the colours: a percentile, so that a corner far from all points does not flatten the rest.
_PERCENTILE = 97.0
_MODELS = {"Recommended": "auto", "Rigid pose": "rigid", "Homography": "homography"}


@cache
def uncertainty_lut() -> Uint8Array:
    """Return the colour map from certain (dark) to uncertain (bright): uint8 (256, 4)."""
    colors = pg.colormap.get("inferno").map(np.linspace(0.15, 0.98, 256), mode="byte")
    return np.ascontiguousarray(colors)


def uncertainty_picture(report: CalibrationReport, frame: SensorFrame) -> tuple[Uint8Array, float, float]:
    """Colour the proximity colour image by the expected alignment error; return the millimetres at the scale's ends."""
    from scipy.interpolate import LinearNDInterpolator  # slow to import

    quality, rig = report.chosen, report.rig
    shown = picture(frame, rig, "proximity", "color")
    height, width = shown.gray.shape
    places = membrane_grid(frame, rig, _STEP_PX)
    with np.errstate(all="ignore"):
        sigma_px = np.sqrt((quality.agreement.sensitivity(places) ** 2).sum(axis=(1, 2)))
        pixels = quality.fit.predict(places)
        rays = rig.proximity.intrinsics.normalise(pixels)
        points = np.column_stack([rays * places[:, 2:], places[:, 2]])
        where = pixels if rig.proximity_color is None else proximity_pixels(rig, points, True)
    known = np.isfinite(where).all(axis=1) & np.isfinite(sigma_px)  # a strongly bending lens has places without a ray
    places, where = places[known], where[known]
    if len(places) < 4:
        return shown.pixels, 0.0, 1.0
    sigma_mm = sigma_px[known] * millimetres_per_pixel(places[:, 2], rig)
    v, u = np.mgrid[0:height:_COARSE, 0:width:_COARSE]
    coarse = LinearNDInterpolator(where, sigma_mm)(u, v)
    high = float(np.percentile(sigma_mm, _PERCENTILE))
    low = min(float(sigma_mm.min()), 0.999 * high)
    rows = np.clip((np.nan_to_num(coarse) - low) * (255 / (high - low)), 0, 255).astype(np.uint8)
    colors = cv2.resize(uncertainty_lut()[rows][:, :, :3], (width, height), interpolation=cv2.INTER_LINEAR)
    covered = cv2.resize(np.isfinite(coarse).astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    gray = cv2.cvtColor(shown.gray, cv2.COLOR_GRAY2RGB).astype(np.float32)
    weight = (_OPACITY * covered)[:, :, None]
    blended = gray * (1 - weight) + colors * weight
    return color_pane(blended.astype(np.uint8), None), low, high


class QualityPage(QWidget):
    """The uncertainty map, the verdict, the choice of the model and the numbers."""

    def __init__(self, session: Session) -> None:
        super().__init__()
        self._session = session
        self._outcome = Outcome()
        self._drawn: tuple[object, ...] = ()
        self.job = Job(self, self._show_map, self._show_no_map)
        self.map = PointImage("Expected alignment error, one standard deviation", magnifies=False)
        self.grade, self.why, self.step = wrapped_label(verdict=True), wrapped_label(), wrapped_label()
        self.step.setFont(text_font("body", bold=True))
        self.model = QComboBox()
        self.model.setToolTip(
            "The rigid pose is exact at every depth, a homography for one plane only. Recommended: the model with the "
            "smaller cross-validated residual"
        )
        for title, value in _MODELS.items():
            self.model.addItem(title, value)
        self.reason, self.offset, self.residual, self.warnings = (wrapped_label() for _ in range(4))
        self.warnings.setTextFormat(Qt.TextFormat.PlainText)
        choice = QFormLayout()
        choice.addRow("&Model", self.model)
        verdict = (self.grade, self.why, self.step, 8, choice, self.reason, self.offset)
        side = holding(vbox(*verdict, 8, self.residual, self.warnings, STRETCH))
        hbox((self.map, 3), (scrolling(side), 2), within=self, margins=(8, 8, 8, 4))
        self.model.activated.connect(
            lambda _: session.choose(f"Model: {self.model.currentText()}", model=self.model.currentData())
        )
        session.changed.connect(self._show_state)
        session.selectionChanged.connect(lambda _: self._show_marks())
        self.map.pressed.connect(lambda name, _: session.select([name]))
        self.setFocusProxy(self.map)
        self._show_state(session.state)
        self.show_outcome(Outcome())

    def show_outcome(self, outcome: Outcome) -> None:
        self._outcome = outcome
        report = outcome.report
        if report is None:
            self.grade.setText("No calibration yet")
            self.step.setText(outcome.problem or "Click at least four pairs, preferably eight, on the page Points.")
            for label in (self.why, self.reason, self.offset, self.residual, self.warnings):
                label.setText("")
        else:
            quality, judged = report.chosen, grade(report.chosen)
            word, _, why = judged.partition(": ")
            self.grade.setText(word)
            self.why.setText(why[:1].upper() + why[1:])
            self.step.setText(f"Next: {report.verdict.removeprefix(judged).strip()}")
            self.reason.setText(report.reason)
            self.offset.setText("" if report.depth_offset is None else report.depth_offset.words())
            exact = "exact fit, not informative"
            self.residual.setText(f"Residual, RMS: {exact if quality.rms_px is None else f'{quality.rms_px:.2f} px'}")
            self.warnings.setText("\n".join(f"Note: {words}" for words in report.warnings))
        for label in (self.why, self.reason, self.offset, self.residual, self.warnings):
            label.setVisible(bool(label.text()))
        self._draw()

    def showEvent(self, event: QShowEvent | None) -> None:
        super().showEvent(event)
        self._draw()

    def _show_state(self, state: SessionState) -> None:
        self.model.setCurrentIndex(self.model.findData(state.choices.model))
        self._draw()

    def _draw(self) -> None:
        report, snapshot = self._outcome.report, self._session.state.snapshot
        self._show_marks()
        if not self.isVisible():
            return
        if report is None or snapshot is None:
            self._show_no_map("Take a snapshot to draw the map" if report is not None else "No calibration yet")
        elif (report, snapshot.digest) != self._drawn:
            if not self._drawn:
                self.map.set_image(None, "Drawing the map…")
            self._drawn = (report, snapshot.digest)
            self.job.start(lambda _: uncertainty_picture(report, snapshot.frame))

    def _show_map(self, drawn: tuple[Uint8Array, float, float]) -> None:
        pixels, low, high = drawn
        self.map.set_image(pixels)
        self.map.set_legend(ends_legend(f"{low:.2f} mm", f"{high:.2f} mm", uncertainty_lut()))
        self._show_marks()

    def _show_no_map(self, why: str) -> None:
        self._drawn = ()
        self.map.set_image(None, why)
        self.map.set_legend([])
        self._show_marks()

    def _show_marks(self) -> None:
        """Mark the points on the map; without a map they would cover the message."""
        session = self._session
        state = session.state.with_choices(image="color")
        marks = image_marks(state, self._outcome, "proximity", session.rig, session.selected, everywhere=True)
        self.map.layer.set_marks(marks if self._drawn else [])
