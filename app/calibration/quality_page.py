"""The page that shows how good the calibration is, where, and what to do next, with a map of the uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QShowEvent
from PyQt6.QtWidgets import QButtonGroup, QGridLayout, QHBoxLayout, QLabel, QScrollArea, QVBoxLayout, QWidget
from scipy.interpolate import LinearNDInterpolator

from ...core.calibration import CalibrationReport
from ...core.calibration.html_report import write_html
from ...core.calibration.quality import millimetres_per_pixel
from ...core.calibration.report import grade
from ...core.model.arrays import BoolArray, Float64Array, Uint8Array
from ...core.model.frames import Rig, SensorFrame
from ...widgets.basics.controls import AccentButton, push_button, wrapped_label
from ...widgets.basics.layouts import hbox, vbox
from ...widgets.basics.theme import TextSize, text_font
from ...widgets.images.image_pane import ColorBar
from ...widgets.images.point_image import PointImage
from ...widgets.plots.calibration_plots import CoverageGrid
from ..worker.jobs import Job
from .fitting import Outcome, image_marks
from .overlay import OverlayMode, make_overlay
from .pictures import membrane_grid, pack_rgb, picture
from .prediction import Alignment, project_into
from .session import Session, Snapshot

_STEP_PX = 8
_COARSE = 4
_OPACITY = 0.62
#: Upper end of the colours: a percentile, so that a corner far from all points does not flatten the rest.
_PERCENTILE = 97.0


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
    """Colour the proximity colour image by the expected alignment error.

    Parameters
    ----------
    unit : {"px", "mm"}
        Proximity pixels, or millimetres across the line of sight.
    """
    fit, rig = report.chosen.agreement, report.rig
    shown = picture(frame, rig, "proximity", "color", stretch=True)
    height, width = shown.gray.shape
    places = membrane_grid(frame, rig, _STEP_PX)
    places = places[_has_ray(places[:, :2], rig)]
    if len(places) < 4:
        return UncertaintyPicture(shown.pixels, 0.0, 1.0)
    sigma = np.sqrt((fit.sensitivity(places) ** 2).sum(axis=(1, 2)))
    if unit == "mm":
        sigma = sigma * millimetres_per_pixel(places[:, 2], rig)
    where = color_pixels(fit.predict(places), places[:, 2], rig)
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


def _has_ray(pixels: Float64Array, rig: Rig) -> BoolArray:
    """Whether tactile pixels (N, 2) have a ray; those beyond the fold of a strongly distorting lens have none."""
    lens = rig.tactile.intrinsics
    with np.errstate(all="ignore"):
        rays = lens.normalise(pixels)
        again = lens.project(np.column_stack([rays, np.ones(len(rays))]))
    return np.asarray((np.abs(again - pixels) < 1.0).all(axis=1))


def color_pixels(depth_pixels: Float64Array, depth_m: Float64Array, rig: Rig) -> Float64Array:
    """Map proximity depth pixels (N, 2) at distances (N,), metres, to pixels of the proximity colour image."""
    if rig.proximity_color is None:
        return depth_pixels
    rays = rig.proximity.intrinsics.normalise(depth_pixels)
    return project_into(np.column_stack([rays * depth_m[:, None], depth_m]), rig, "color")


_UNITS = {"px": "proximity pixels", "mm": "millimetres across the line of sight"}
_ESTIMATE, _REMOVE = "Estimate lens distortion", "Remove lens distortion"
_ESTIMATE_TIP = (
    "Estimate radial lens distortion (k1, no unit) from the pairs, for lenses for which the rig states none. "
    "Saving stores it with the preset's rig; undo removes it"
)
_REMOVE_TIP = "Fit without the estimated lens distortion again; undo restores it"
_MAP_TITLE = "Expected alignment error over the membrane"


def write_report(
    path: Path, report: CalibrationReport, alignment: Alignment, preset_name: str, snapshot: Snapshot | None
) -> Path:
    """Write the report with overlay and uncertainty over a snapshot, if there is one; return its path.

    Raises
    ------
    ExportError
        The file cannot be written.
    """
    pictures: dict[str, Uint8Array] = {}
    if snapshot is not None:
        frame = snapshot.frame
        drawn = uncertainty_picture(report, frame, "px")
        title = f"Expected alignment error over the membrane, {drawn.low:.2f} px (dark) to {drawn.high:.2f} px (bright)"
        pictures[title] = _rgb(drawn.pixels)
        if frame.tactile_color is not None:
            overlay = make_overlay(alignment, report.rig, frame, "color")
            pictures["Checkerboard of both images: lines continue across the borders"] = _rgb(
                overlay.composed(OverlayMode.CHECKER, 0.5)
            )
    write_html(path, report, preset_name, None if snapshot is None else snapshot.frame, pictures)
    return path


def _rgb(pixels: Uint8Array) -> Uint8Array:
    """Convert pixels in the layout of ``QImage.Format_RGB32`` to RGB."""
    return pixels[:, :, 2::-1].copy()


class QualityPage(QWidget):
    """The uncertainty map, the verdict, the numbers and the coverage."""

    def __init__(self, session: Session) -> None:
        super().__init__()
        self._session = session
        self._outcome = Outcome()
        self._drawn: tuple[object, ...] = ()
        self._mapped = False
        self._job = Job(self)
        self.map = PointImage(_MAP_TITLE)
        self.map.set_loupe_wanted(False)
        self.units = QButtonGroup(self)
        self.grade = _words("title", bold=True)
        self.why = _words()
        self.step = _words(bold=True)
        self.estimated = _words()
        self.distortion = push_button(_ESTIMATE, _ESTIMATE_TIP)
        self.numbers = QGridLayout()
        self.numbers.setVerticalSpacing(4)
        self.numbers.setHorizontalSpacing(16)
        self.warnings = _words()
        self.coverage = CoverageGrid()
        hbox((self._map_column(), 3), (self._words_column(), 2), within=self, margins=(8, 8, 8, 4))
        self.units.idClicked.connect(lambda _: self._draw())
        self.distortion.clicked.connect(self._toggle_distortion)
        self._job.done.connect(self._show_map)
        self._job.failed.connect(self._show_no_map)
        session.changed.connect(lambda _: self._draw())
        session.selectionChanged.connect(lambda _: self._show_marks())
        self.map.pressed.connect(lambda key, _: session.select([key]))
        self.setFocusProxy(self.map)
        self.show_outcome(Outcome())

    def _map_column(self) -> QVBoxLayout:
        units = QHBoxLayout()
        units.addWidget(QLabel("Show the map in"))
        for number, (unit, words) in enumerate(_UNITS.items()):
            button = AccentButton(unit, f"Expected alignment error in {words}, one standard deviation")
            button.setFixedWidth(56)
            button.setChecked(number == 0)
            self.units.addButton(button, number)
            units.addWidget(button)
        units.addStretch(1)
        return vbox((self.map, 1), units)

    def _words_column(self) -> QScrollArea:
        side = QWidget()
        column = QVBoxLayout(side)
        for label in (self.grade, self.why, self.step):
            column.addWidget(label)
        column.addWidget(self.distortion, 0, Qt.AlignmentFlag.AlignLeft)
        column.addWidget(self.estimated)
        column.addSpacing(8)
        column.addLayout(self.numbers)
        column.addWidget(self.warnings)
        column.addSpacing(8)
        column.addWidget(QLabel("Points over the proximity image"))
        column.addWidget(self.coverage, 1)
        scroll = QScrollArea()
        scroll.setWidgetResizable(True)
        scroll.setFrameShape(QScrollArea.Shape.NoFrame)
        scroll.setWidget(side)
        return scroll

    def show_outcome(self, outcome: Outcome) -> None:
        """Show a new fit."""
        self._outcome = outcome
        report = outcome.report
        self._show_distortion(outcome)
        while (item := self.numbers.takeAt(0)) is not None:
            widget = item.widget()
            if widget is not None:
                widget.deleteLater()
        if report is None:
            self.grade.setText("No calibration yet")
            self.why.setText("")
            self.step.setText(outcome.sentence or "Click at least four pairs, preferably eight, on the page Points.")
            self.coverage.set_coverage([], [])
            self.warnings.setText("")
        else:
            self._show_report(report)
        self._draw()

    def close_jobs(self) -> None:
        """Cancel running jobs."""
        self._job.stop()

    def showEvent(self, event: QShowEvent | None) -> None:
        """Redraw what changed while the page was hidden."""
        super().showEvent(event)
        self._draw()

    def _show_report(self, report: CalibrationReport) -> None:
        quality = report.chosen
        judged = grade(quality)
        word, _, why = judged.partition(": ")
        self.grade.setText(word)
        self.why.setText(why[:1].upper() + why[1:])
        self.step.setText(f"Next: {report.verdict.removeprefix(judged).strip()}")
        rows = [
            ("Model", report.model),
            ("Smallest t (tolerance test)", f"{100 * quality.effect.supported_tolerance:.2f} %"),
            ("Patch boundary off by", f"{quality.effect.boundary_mm:.2f} mm"),
            ("Depth difference at contact", f"{quality.effect.depth_mm:.2f} mm"),
            ("Alignment error, 95 % bound", f"{quality.alignment_bound_95_px:.2f} px"),
            ("Residual, RMS", "exact fit, not informative" if quality.rms_px is None else f"{quality.rms_px:.2f} px"),
            (
                "Cross-validated residual",
                "needs more pairs" if quality.cross_validated_px is None else f"{quality.cross_validated_px:.2f} px",
            ),
            ("Condition number", f"{quality.condition:.1f}"),
        ]
        if quality.worst_px is not None and quality.worst_id is not None:
            rows.insert(6, ("Worst residual", f"{quality.worst_px:.2f} px (pair {quality.worst_id})"))
        for number, (title, value) in enumerate(rows):
            self.numbers.addWidget(QLabel(title), number, 0)
            self.numbers.addWidget(QLabel(f"<b>{value}</b>"), number, 1)
        self.numbers.setColumnStretch(1, 1)
        self.warnings.setTextFormat(Qt.TextFormat.PlainText)
        self.warnings.setText("\n".join(f"Note: {words}" for words in report.warnings))
        self.warnings.setVisible(bool(report.warnings))
        depths = [
            1e3 * pair.tactile_depth_m
            for pair in self._outcome.pairs
            if pair.enabled and pair.tactile_depth_m is not None
        ]
        self.coverage.set_coverage(report.coverage.cells, depths)

    def _show_distortion(self, outcome: Outcome) -> None:
        """Offer to estimate lens distortion, or to remove the estimate."""
        chosen = self._session.state.choices.estimate_distortion
        used = outcome.report is not None and outcome.report.distortion_used
        self.distortion.setText(_REMOVE if chosen else _ESTIMATE)
        self.distortion.setToolTip(_REMOVE_TIP if chosen else _ESTIMATE_TIP)
        self.distortion.setVisible(chosen or outcome.distortion.rig is not None)
        self.estimated.setText(outcome.distortion.result if used else "")
        self.estimated.setVisible(used)

    def _toggle_distortion(self) -> None:
        asked = self.distortion.text()
        self._session.choose(asked, estimate_distortion=asked == _ESTIMATE)

    def _unit(self) -> str:
        return list(_UNITS)[self.units.checkedId()]

    def _draw(self) -> None:
        """Draw the map if it is visible and out of date."""
        report, snapshot = self._outcome.report, self._session.state.snapshot
        self._show_marks()
        if not self.isVisible():
            return
        if report is None or snapshot is None:
            self._drawn = ()
            why = "Take a snapshot to draw the map" if report is not None else "No calibration yet"
            self._show_no_map(why)
            return
        unit = self._unit()
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
        unit = self._unit()
        self.map.header.set_legend(ColorBar(f"{drawn.low:.2f} {unit}", f"{drawn.high:.2f} {unit}", uncertainty_lut()))

    def _show_no_map(self, why: str) -> None:
        self.map.set_image(None, why)
        self.map.header.set_legend(None)
        self._mapped = False
        self._show_marks()

    def _show_marks(self) -> None:
        """Mark the points on the map; without a map they would cover the message."""
        if not self._mapped:
            self.map.set_marks([])
            return
        state = self._session.state.with_choices(proximity_image="color")
        marks = image_marks(
            state, self._outcome, "proximity", self._session.rig, self._session.selected, everywhere=True
        )
        self.map.set_marks(marks)


def _words(size: TextSize = "body", bold: bool = False) -> QLabel:
    label = wrapped_label()
    label.setFont(text_font(size, bold=bold))
    return label
