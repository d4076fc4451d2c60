"""Depth quality of both cameras in a region, live."""

from __future__ import annotations

import time
from collections.abc import Sequence
from html import escape

import pyqtgraph as pg
from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QGraphicsRectItem, QGridLayout, QWidget

from ...core.errors import as_sentence
from ...core.model.arrays import Uint8Array
from ...core.rig.quality import CameraQuality, Reading, Rectangle, Verdict, measure_quality
from ...core.sources.base import CameraRole
from ...widgets.basics.controls import wrapped_label
from ...widgets.basics.layouts import vbox
from ...widgets.basics.theme import ACCENT, theme_colors
from ...widgets.images.image_pane import ImagePane
from ...widgets.images.marks import RegionItem
from ..calibration.pictures import picture
from ..document.document import Document
from ..worker.jobs import Job, Progress
from ..worker.results import Result

#: Interval between measurements, seconds: short enough to follow, long enough to read.
_INTERVAL_S = 0.4
#: Share of the image's width and height, as in librealsense's depth quality tool.
_START_SHARE = 0.4
_WAITING = "Waiting for a frame: open a source in the main window, and let it play."
_INTRO = "Point {} at a flat target and drag the rectangle onto it; the fill rate is valid on any scene at rest."
_MARKS = {Verdict.GOOD: "●", Verdict.FAIR: "▲", Verdict.POOR: "■", Verdict.UNKNOWN: "○"}


class QualityTab(QWidget):
    """Measures while it is visible, and ignores frames otherwise."""

    def __init__(self, document: Document) -> None:
        super().__init__()
        self._document = document
        self._result: Result | None = None
        self._last_s = 0.0
        self._newer = False
        self._unfitted = True
        #: Of the proximity and of the tactile camera; None before the first measurement.
        self.quality: tuple[CameraQuality, CameraQuality] | None = None
        self._job = Job(self)
        self._job.done.connect(self._show)
        self._job.failed.connect(self._fail)
        self.panes: dict[CameraRole, ImagePane] = {
            "proximity": ImagePane("Proximity depth"),
            "tactile": ImagePane("Tactile depth"),
        }
        self.region_item = RegionItem(self.panes["proximity"])
        self._tactile_region = QGraphicsRectItem()
        self._tactile_region.setPen(pg.mkPen(ACCENT, width=2))
        self._tactile_region.setZValue(10)
        self.panes["tactile"].box.addItem(self._tactile_region, ignoreBounds=True)
        self.lines = {name: wrapped_label(selectable=True) for name in self.panes}
        self.region: Rectangle = (0, 0, 2, 2)
        self.status = wrapped_label(_WAITING)
        self.intro = wrapped_label(_INTRO.format("both cameras"))
        grid = QGridLayout()
        for column, (name, pane) in enumerate(self.panes.items()):
            self.lines[name].setTextFormat(Qt.TextFormat.RichText)
            grid.addWidget(pane, 0, column)
            grid.addWidget(self.lines[name], 1, column, Qt.AlignmentFlag.AlignTop)
            grid.setColumnStretch(column, 1)
            pane.resized.connect(self._fit)
            pane.doubleClicked.connect(self._fit)
        grid.setRowStretch(0, 1)
        vbox(self.intro, (grid, 1), self.status, within=self)
        self.region_item.edited.connect(lambda region, _: self.set_region(region))

    def show_result(self, result: Result) -> None:
        """Take a frame of the main window."""
        if not self.isVisible():
            return
        before, self._result = self._result, result
        if before is None or result.source is not before.source:
            self._begin(result)
        if before is None or result.frame is not before.frame:
            self._newer = True
            self._measure_soon()

    def set_region(self, region: Rectangle) -> None:
        """Measure in another rectangle: left, top, width and height in proximity pixels."""
        self.region = region
        self.region_item.set_rectangle(region)
        self._newer, self._last_s = True, 0.0
        self._measure_soon()

    def stop(self) -> None:
        """Discard the frame and cancel the job."""
        self._job.stop()
        self._result = None

    def _begin(self, result: Result) -> None:
        """Start over with another source, whose first frame is measured at once."""
        self._job.stop()
        self.quality, self._unfitted = None, True
        for pane in self.panes.values():
            pane.set_pixels(None, (0, 0), 1)
        for line in self.lines.values():
            line.clear()
        self.status.clear()
        two = result.source.rig.has_proximity
        self.intro.setText(_INTRO.format("both cameras" if two else "the camera"))
        for part in (self.panes["tactile"], self.lines["tactile"]):  # one camera: the first pane is the tactile's
            part.setVisible(two)
        self.panes["proximity"].title.setText("Proximity depth" if two else "Tactile depth")
        size = result.source.rig.proximity.intrinsics
        width, height = round(_START_SHARE * size.width), round(_START_SHARE * size.height)
        self.set_region(((size.width - width) // 2, (size.height - height) // 2, width, height))

    def _measure_soon(self) -> None:
        """Measure, unless a measurement is running or has just finished."""
        if self._result is None or self._job.busy or time.monotonic() - self._last_s < _INTERVAL_S:
            return
        self._newer, self._last_s = False, time.monotonic()
        frame, rig = self._result.frame, self._result.source.rig
        preset, region = self._document.preset, self.region

        def measure(_: Progress) -> tuple[tuple[CameraQuality, CameraQuality], list[Uint8Array]]:
            quality = measure_quality(frame, rig, preset, region)
            return quality, [picture(frame, rig, side, "depth").pixels for side in self.panes]

        self._job.start(measure)

    def _show(self, measured: tuple[tuple[CameraQuality, CameraQuality], list[Uint8Array]]) -> None:
        """Show a measurement and its frame, as pixels of ``QImage.Format_RGB32``."""
        self.quality, images = measured
        for pane, pixels in zip(self.panes.values(), images, strict=True):
            pane.set_pixels(pixels, (pixels.shape[1], pixels.shape[0]), 1)
            pane.set_message("")
        if self._unfitted:
            self._unfitted = False
            self._fit()
        shown = self.quality[1:] if self.panes["tactile"].isHidden() else self.quality
        for camera, line in zip(shown, self.lines.values(), strict=False):
            line.setText(_table(camera.readings()))
        left, top, width, height = self.quality[1].region
        self._tactile_region.setRect(left - 0.5, top - 0.5, width, height)
        self.status.clear()
        if self._newer:
            self._measure_soon()

    def _fit(self) -> None:
        """Fit both images into view."""
        for pane in self.panes.values():
            pane.show_rect(pane.image_rect())

    def _fail(self, sentence: str) -> None:
        if sentence:
            self.status.setText(as_sentence(sentence))


def _table(readings: Sequence[Reading]) -> str:
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
