"""The page that shows how good the calibration is, where, and what to do next, and where the model is chosen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QShowEvent
from PyQt6.QtWidgets import QButtonGroup, QComboBox, QFormLayout, QLabel, QScrollArea, QVBoxLayout, QWidget
from scipy.interpolate import LinearNDInterpolator

from ...core.calibration import CalibrationReport
from ...core.calibration.geometry import proximity_pixels
from ...core.calibration.quality import millimetres_per_pixel
from ...core.calibration.report import grade
from ...core.model.arrays import Uint8Array
from ...core.model.frames import SensorFrame
from ...widgets.basics.colormaps import ends_legend
from ...widgets.basics.controls import AccentButton, wrapped_label
from ...widgets.basics.layouts import STRETCH, hbox, scrolling, vbox
from ...widgets.basics.theme import TextSize, text_font
from ...widgets.images.point_image import PointImage
from ...widgets.plots.calibration_plots import CoverageGrid
from ..worker.jobs import Job
from .fitting import Outcome, image_marks
from .pictures import membrane_grid, pack_rgb, picture
from .session import Session, SessionState

_STEP_PX = 8
_COARSE = 4
_OPACITY = 0.62
#: Upper end of the colours: a percentile, so that a corner far from all points does not flatten the rest.
_PERCENTILE = 97.0
_UNITS = {"px": "proximity pixels", "mm": "millimetres across the line of sight"}
_MODELS = (("Recommended", "auto"), ("Rigid pose", "rigid"), ("Homography", "homography"))
_OFFSETS = (("If it is certain", "auto"), ("Not corrected", "none"), ("Offset", "offset"))


@dataclass(frozen=True, eq=False)
class UncertaintyPicture:
    """Pixels for the screen, (H, W, 4), and the values at the ends of the colour scale."""

    pixels: Uint8Array
    low: float
    high: float


@cache
def uncertainty_lut() -> Uint8Array:
    """Return the colour map from certain (dark) to uncertain (bright): uint8 (256, 4)."""
    colors = pg.colormap.get("inferno").map(np.linspace(0.15, 0.98, 256), mode="byte")
    return np.ascontiguousarray(colors)


def uncertainty_picture(report: CalibrationReport, frame: SensorFrame, unit: str) -> UncertaintyPicture:
    """Colour the proximity colour image by the expected alignment error, in ``"px"`` or ``"mm"``."""
    quality, rig = report.chosen, report.rig
    shown = picture(frame, rig, "proximity", "color", stretch=True)
    height, width = shown.gray.shape
    places = membrane_grid(frame, rig, _STEP_PX)
    with np.errstate(all="ignore"):
        sigma = np.sqrt((quality.agreement.sensitivity(places) ** 2).sum(axis=(1, 2)))
        pixels = quality.fit.predict(places)
        rays = rig.proximity.intrinsics.normalise(pixels)
        points = np.column_stack([rays * places[:, 2:], places[:, 2]])
        where = pixels if rig.proximity_color is None else proximity_pixels(rig, points, True)
    known = np.isfinite(where).all(axis=1) & np.isfinite(sigma)  # a strongly bending lens has places without a ray
    places, sigma, where = places[known], sigma[known], where[known]
    if len(places) < 4:
        return UncertaintyPicture(shown.pixels, 0.0, 1.0)
    if unit == "mm":
        sigma = sigma * millimetres_per_pixel(places[:, 2], rig)
    v, u = np.mgrid[0:height:_COARSE, 0:width:_COARSE]
    coarse = LinearNDInterpolator(where, sigma)(u, v)
    high = float(np.percentile(sigma, _PERCENTILE))
    low = min(float(sigma.min()), 0.999 * high)
    rows = np.clip((np.nan_to_num(coarse) - low) * (255 / (high - low)), 0, 255).astype(np.uint8)
    colors = cv2.resize(uncertainty_lut()[rows][:, :, :3], (width, height), interpolation=cv2.INTER_LINEAR)
    covered = cv2.resize(np.isfinite(coarse).astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    gray = cv2.cvtColor(shown.gray, cv2.COLOR_GRAY2RGB).astype(np.float32)
    weight = (_OPACITY * covered)[:, :, None]
    blended = gray * (1 - weight) + colors * weight
    return UncertaintyPicture(pack_rgb(blended.astype(np.uint8)), low, high)


class QualityPage(QWidget):
    """The uncertainty map, the verdict, the choice of the model, the numbers and the coverage."""

    def __init__(self, session: Session) -> None:
        super().__init__()
        self._session = session
        self._outcome = Outcome()
        self._drawn: tuple[object, ...] = ()
        self._mapped = False
        self._job = Job(self)
        self.map = PointImage("Expected alignment error over the membrane")
        self.map.set_loupe_wanted(False)
        self.units = QButtonGroup(self)
        self.grade, self.why, self.step = _words("title", bold=True), _words(), _words(bold=True)
        self.model = _choice(
            "Model",
            "The rigid pose is exact at every depth, a homography for one plane only. Recommended: the model with the "
            "smaller cross-validated residual",
            _MODELS,
        )
        self.depth_fit = _choice(
            "Offset of the tactile depth",
            "Also fit an offset of the tactile depth, millimetres. Points that span depth determine it",
            _OFFSETS,
        )
        self.reason, self.offset = _words(), _words()
        self.numbers = QFormLayout()
        self.warnings = _words()
        self.warnings.setTextFormat(Qt.TextFormat.PlainText)
        self.coverage = CoverageGrid()
        hbox((self._map_column(), 3), (self._words_column(), 2), within=self, margins=(8, 8, 8, 4))
        self.units.idClicked.connect(lambda _: self._draw())
        self.model.activated.connect(
            lambda _: session.choose(f"Model: {self.model.currentText()}", model=self.model.currentData())
        )
        self.depth_fit.activated.connect(
            lambda _: session.choose(
                f"Offset of the depth: {self.depth_fit.currentText()}", depth_fit=self.depth_fit.currentData()
            )
        )
        self._job.done.connect(self._show_map)
        self._job.failed.connect(self._show_no_map)
        session.changed.connect(self._show_state)
        session.selectionChanged.connect(lambda _: self._show_marks())
        self.map.pressed.connect(lambda name, _: session.select([name]))
        self.setFocusProxy(self.map)
        self._show_state(session.state)
        self.show_outcome(Outcome())

    def _map_column(self) -> QVBoxLayout:
        buttons = []
        for number, (unit, words) in enumerate(_UNITS.items()):
            button = AccentButton(unit, f"Expected alignment error in {words}, one standard deviation")
            button.setFixedWidth(56)
            button.setChecked(number == 0)
            self.units.addButton(button, number)
            buttons.append(button)
        return vbox((self.map, 1), hbox(QLabel("Show the map in"), *buttons, STRETCH))

    def _words_column(self) -> QScrollArea:
        side = QWidget()
        choices = QFormLayout()
        choices.addRow("&Model", self.model)
        choices.addRow("Depth &offset", self.depth_fit)
        rest = (self.warnings, 8, QLabel("Points over the proximity image"), (self.coverage, 1))
        vbox(
            self.grade, self.why, self.step, 8, choices, self.reason, self.offset, 8, self.numbers, *rest,
            within=side,
        )  # fmt: skip
        return scrolling(side)

    def show_outcome(self, outcome: Outcome) -> None:
        """Show a new fit."""
        self._outcome = outcome
        report = outcome.report
        while self.numbers.rowCount():
            self.numbers.removeRow(0)
        if report is None:
            self.grade.setText("No calibration yet")
            self.step.setText(outcome.sentence or "Click at least four pairs, preferably eight, on the page Points.")
            for label in (self.why, self.reason, self.offset, self.warnings):
                label.setText("")
            self.coverage.set_coverage([], [])
        else:
            self._show_report(report)
        for label in (self.why, self.reason, self.offset, self.warnings):
            label.setVisible(bool(label.text()))
        self._draw()

    def close_jobs(self) -> None:
        """Cancel running jobs."""
        self._job.stop()

    def showEvent(self, event: QShowEvent | None) -> None:
        """Redraw what changed while the page was hidden."""
        super().showEvent(event)
        self._draw()

    def _show_state(self, state: SessionState) -> None:
        self.model.setCurrentIndex(self.model.findData(state.choices.model))
        self.depth_fit.setCurrentIndex(self.depth_fit.findData(state.choices.depth_fit))
        self._draw()

    def _show_report(self, report: CalibrationReport) -> None:
        quality = report.chosen
        judged = grade(quality)
        word, _, why = judged.partition(": ")
        self.grade.setText(word)
        self.why.setText(why[:1].upper() + why[1:])
        self.step.setText(f"Next: {report.verdict.removeprefix(judged).strip()}")
        self.reason.setText(report.reason)
        self.offset.setText("" if report.depth_offset is None else report.depth_offset.words())
        rows = [
            ("Smallest t (tolerance test)", f"{100 * quality.effect.supported_tolerance:.2f} %"),
            ("Patch boundary off by", f"{quality.effect.boundary_mm:.2f} mm"),
            ("Depth difference at contact", f"{quality.effect.depth_mm:.2f} mm"),
            ("Alignment error, 95 % bound", f"{quality.alignment_bound_95_px:.2f} px"),
        ]
        if quality.rms_px is None:
            rows.append(("Residual, RMS", "exact fit, not informative"))
        else:
            worst = quality.worst
            rows += [
                ("Residual, RMS", f"{quality.rms_px:.2f} px"),
                ("Worst residual", f"{worst.residual_px:.2f} px (pair {worst.id})"),
            ]
        for title, value in rows:
            self.numbers.addRow(title, QLabel(f"<b>{value}</b>"))
        self.warnings.setText("\n".join(f"Note: {words}" for words in report.warnings))
        depths = [
            1e3 * pair.tactile_depth_m
            for pair in self._outcome.pairs
            if pair.enabled and pair.tactile_depth_m is not None
        ]
        self.coverage.set_coverage(report.coverage.cells, depths)

    def _draw(self) -> None:
        """Draw the map if it is visible and out of date."""
        report, snapshot = self._outcome.report, self._session.state.snapshot
        self._show_marks()
        if not self.isVisible():
            return
        if report is None or snapshot is None:
            self._drawn = ()
            self._show_no_map("Take a snapshot to draw the map" if report is not None else "No calibration yet")
            return
        unit = list(_UNITS)[self.units.checkedId()]
        wanted = (report, snapshot.digest, unit)
        if wanted != self._drawn:
            if not self._drawn:
                self.map.set_image(None, "Drawing the map…")
            self._drawn = wanted
            self._job.start(lambda _: uncertainty_picture(report, snapshot.frame, unit))

    def _show_map(self, drawn: UncertaintyPicture) -> None:
        self.map.set_image(drawn.pixels)
        self._mapped = True
        self._show_marks()
        unit = list(_UNITS)[self.units.checkedId()]
        self.map.set_legend(ends_legend(f"{drawn.low:.2f} {unit}", f"{drawn.high:.2f} {unit}", uncertainty_lut()))

    def _show_no_map(self, why: str) -> None:
        self.map.set_image(None, why)
        self.map.set_legend([])
        self._mapped = False
        self._show_marks()

    def _show_marks(self) -> None:
        """Mark the points on the map; without a map they would cover the message."""
        session = self._session
        state = session.state.with_choices(proximity_image="color")
        marks = image_marks(state, self._outcome, "proximity", session.rig, session.selected, everywhere=True)
        self.map.set_marks(marks if self._mapped else [])


def _words(size: TextSize = "body", bold: bool = False) -> QLabel:
    label = wrapped_label()
    label.setFont(text_font(size, bold=bold))
    return label


def _choice(name: str, tip: str, choices: tuple[tuple[str, str], ...]) -> QComboBox:
    box = QComboBox()
    box.setAccessibleName(name)
    box.setToolTip(tip)
    for title, value in choices:
        box.addItem(title, value)
    return box
