"""Depth quality of both cameras in a region, live."""

from __future__ import annotations

import time
from collections import deque
from html import escape

import pyqtgraph as pg
from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import (
    QDoubleSpinBox,
    QGridLayout,
    QLabel,
    QWidget,
)

from ...core.errors import as_sentence
from ...core.model.arrays import Uint8Array
from ...core.model.frames import Rig, SensorFrame
from ...core.rig.quality import NOISE_FRAMES, Quality, Reading, Rectangle, Verdict, measure_quality
from ...core.sources.base import CameraRole
from ...widgets.basics.controls import copy_text, push_button, wrapped_label
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.basics.theme import ACCENT, theme_colors
from ...widgets.images.image_pane import ImagePane
from ...widgets.images.marks import RegionItem
from ..calibration.pictures import picture
from ..document.document import Document
from ..worker.jobs import Job, Progress
from ..worker.results import Result, SourceInfo


class Outline:
    """A rectangle over an image that cannot be dragged."""

    def __init__(self, pane: ImagePane) -> None:
        self._curve = pg.PlotCurveItem(pen=pg.mkPen(ACCENT, width=2))
        self._curve.setZValue(10)
        pane.box.addItem(self._curve, ignoreBounds=True)

    def set_rectangle(self, rectangle: Rectangle) -> None:
        """Show (left, top, width, height) in whole pixels."""
        left, top, width, height = rectangle
        near, far = left - 0.5, left + width - 0.5
        upper, lower = top - 0.5, top + height - 0.5
        self._curve.setData([near, far, far, near, near], [upper, upper, lower, lower, upper])


#: Interval between measurements, seconds: short enough to follow, long enough to read.
_INTERVAL_S = 0.4
#: Share of the image's width and height, as in librealsense's depth quality tool.
_START_SHARE = 0.4
_WAITING = "Waiting for a frame: open a source in the main window, and let it play."
_INTRO = (
    "Point both cameras at a flat target and drag the rectangle onto it; "
    "fill rate and temporal noise are valid on any scene at rest."
)
_MARKS = {Verdict.GOOD: "●", Verdict.FAIR: "▲", Verdict.POOR: "■", Verdict.UNKNOWN: "○"}


class QualityTab(QWidget):
    """Measures while it is visible, and ignores frames otherwise."""

    def __init__(self, document: Document) -> None:
        super().__init__()
        self._document = document
        self._frames: deque[SensorFrame] = deque(maxlen=NOISE_FRAMES)
        self._rig: Rig | None = None
        self._source: SourceInfo | None = None
        self._last_s = 0.0
        self._newer = False
        self._unfitted = True
        self.quality: Quality | None = None
        self._job = Job(self)
        self._job.done.connect(self._show)
        self._job.failed.connect(self._fail)
        self.panes: dict[CameraRole, ImagePane] = {
            "proximity": ImagePane("Proximity depth"),
            "tactile": ImagePane("Tactile depth"),
        }
        self.region_item = RegionItem(self.panes["proximity"])
        self._tactile_outline = Outline(self.panes["tactile"])
        self.lines = {name: _text() for name in ("proximity", "tactile", "bias")}
        self.region: Rectangle = (0, 0, 2, 2)
        self.true_distance = QDoubleSpinBox()
        self.copy = push_button("Copy numbers", "Copy all values as text (Ctrl+Shift+C)", "Ctrl+Shift+C")
        self.centre = push_button("Region to the centre", "Move the region to the centre of the image")
        self.status = wrapped_label(_WAITING)
        self._lay_out()
        self._connect()

    def show_result(self, result: Result) -> None:
        """Take a frame of the main window."""
        if not self.isVisible():
            return
        if result.source is not self._source:  # one that is opened again has a new state
            self._begin(result)
        if self._frames and result.frame is self._frames[-1]:
            return
        self._frames.append(result.frame)
        self._newer = True
        self._measure_soon()

    def set_region(self, region: Rectangle) -> None:
        """Measure in another rectangle: left, top, width and height in proximity pixels."""
        self.region = region
        self.region_item.set_rectangle(region)
        self._measure_again()

    def stop(self) -> None:
        """Discard the frames and cancel the job."""
        self._job.stop()
        self._frames.clear()
        self._source = None

    def text(self) -> str:
        """Return all readings as text."""
        quality = self.quality
        if quality is None:
            return ""
        parts = []
        for camera in (quality.proximity, quality.tactile):
            parts.append(f"{camera.role.capitalize()} camera ({camera.model}), region {camera.region}")
            parts += [reading.line for reading in camera.readings()]
        return "\n".join([*parts, quality.bias_reading(self._document.preset).line])

    def _lay_out(self) -> None:
        intro = wrapped_label(_INTRO)
        grid = QGridLayout()
        for column, (name, pane) in enumerate(self.panes.items()):
            grid.addWidget(pane, 0, column)
            grid.addWidget(self.lines[name], 1, column, Qt.AlignmentFlag.AlignTop)
            grid.setColumnStretch(column, 1)
        grid.addWidget(self.lines["bias"], 2, 0, 1, 2)
        grid.setRowStretch(0, 1)
        self.true_distance.setRange(0.0, 10_000.0)
        self.true_distance.setSuffix(" mm")
        self.true_distance.setSpecialValueText("not measured")
        self.true_distance.setAccessibleName("True distance")
        self.true_distance.setToolTip(
            "True distance from the cameras' front glass to the target along the optical axis, in mm, measured "
            "independently; the accuracy of the distance is shown if it is set"
        )
        row = hbox(self.centre, 12, QLabel("True distance"), self.true_distance, STRETCH, self.copy)
        vbox(intro, (grid, 1), self.status, row, within=self)
        self.copy.setEnabled(False)

    def _connect(self) -> None:
        for pane in self.panes.values():
            pane.resized.connect(self._fit)
            pane.doubleClicked.connect(self._fit)
        self.region_item.edited.connect(lambda region, _: self.set_region(region))
        self.true_distance.valueChanged.connect(self._measure_again)
        self.centre.clicked.connect(self._to_centre)
        self.copy.clicked.connect(self._copy)

    def _begin(self, result: Result) -> None:
        """Start over with another source."""
        size = result.source.rig.proximity.intrinsics
        same_size = self._rig is not None and self._rig.proximity.intrinsics.shape == size.shape
        self._rig, self._source = result.source.rig, result.source
        self._forget()
        if same_size:
            return
        self._to_centre()

    def _forget(self) -> None:
        """Remove all that is known of the earlier source; the first frame of the new one is measured at once."""
        self._job.stop()
        self._frames.clear()
        self.quality, self._last_s, self._unfitted = None, 0.0, True
        for pane in self.panes.values():
            pane.set_pixels(None, (0, 0), 1)
        for line in self.lines.values():
            line.clear()
        self.status.clear()
        self.copy.setEnabled(False)

    def _to_centre(self) -> None:
        if self._rig is None:
            return
        size = self._rig.proximity.intrinsics
        width, height = round(_START_SHARE * size.width), round(_START_SHARE * size.height)
        self.set_region(((size.width - width) // 2, (size.height - height) // 2, width, height))

    def _measure_again(self) -> None:
        self._newer, self._last_s = True, 0.0
        self._measure_soon()

    def _measure_soon(self) -> None:
        """Measure, unless a measurement is running or has just finished."""
        rig = self._rig
        if rig is None or not self._frames or self._job.busy or time.monotonic() - self._last_s < _INTERVAL_S:
            return
        self._newer, self._last_s = False, time.monotonic()
        true_m = 1e-3 * self.true_distance.value() or None
        frames, preset, region = tuple(self._frames), self._document.preset, self.region

        def measure(_: Progress) -> tuple[Quality, list[Uint8Array]]:
            quality = measure_quality(frames, rig, preset, region, true_m)
            return quality, [picture(frames[-1], rig, side, "depth", stretch=True).pixels for side in self.panes]

        self._job.start(measure)

    def _show(self, measured: tuple[Quality, list[Uint8Array]]) -> None:
        """Show a measurement and the newest frame, as pixels of ``QImage.Format_RGB32``."""
        quality, images = measured
        self.quality = quality
        for pane, pixels in zip(self.panes.values(), images, strict=True):
            pane.set_pixels(pixels, (pixels.shape[1], pixels.shape[0]), 1)
            pane.set_message("")
        if self._unfitted:
            self._unfitted = False
            self._fit()
        self._tactile_outline.set_rectangle(quality.tactile.region)
        self.lines["proximity"].setText(_table(quality.proximity.readings()))
        self.lines["tactile"].setText(_table(quality.tactile.readings()))
        self.lines["bias"].setText(_table((quality.bias_reading(self._document.preset),)))
        count = quality.proximity.frames
        waiting = f"{count} of {NOISE_FRAMES} frames for the temporal noise" if count < NOISE_FRAMES else ""
        self.status.setText(waiting)
        self.copy.setEnabled(True)
        if self._newer:
            self._measure_soon()

    def _fit(self) -> None:
        """Fit both images into view."""
        for pane in self.panes.values():
            pane.show_rect(pane.image_rect())

    def _fail(self, sentence: str) -> None:
        if sentence:
            self.status.setText(as_sentence(sentence))

    def _copy(self) -> None:
        copy_text(self.text())
        self.status.setText("The numbers were copied to the clipboard.")


def _table(readings: tuple[Reading, ...]) -> str:
    """Format readings as lines. The verdict has a shape and a word, not only a colour."""
    colors = theme_colors()
    hues = {
        Verdict.GOOD: colors.accent_text,
        Verdict.FAIR: colors.text,
        Verdict.POOR: colors.error,
        Verdict.UNKNOWN: colors.muted,
    }
    rows = []
    for reading in readings:
        limit = f" <span style='color:{colors.muted}'>({escape(reading.limit_words)})</span>" if reading.limit else ""
        step = f"<br><span style='color:{colors.muted}'>{escape(reading.step)}</span>" if reading.step else ""
        hue = hues[reading.verdict]
        value = escape(reading.value)
        if value and reading.verdict is not Verdict.UNKNOWN:  # unreliable values are not emphasised
            value = f"<b>{value}</b>"
        title = f"{escape(reading.title)}:" if value else escape(reading.title)
        rows.append(
            f"<p style='margin:2px 0'><span style='color:{hue}'>{_MARKS[reading.verdict]}</span> "
            f"{title} {value} – "
            f"<span style='color:{hue}'>{reading.verdict}</span>{limit}{step}</p>"
        )
    return "".join(rows)


def _text() -> QLabel:
    label = wrapped_label(selectable=True)
    label.setTextFormat(Qt.TextFormat.RichText)
    return label
