"""Views of the tilt tab: the patch with its plane, a dial for each angle, and the angles over time."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import QPointF, QRectF, QSize, Qt
from PyQt6.QtGui import QColor, QFontMetrics, QPainter, QPaintEvent, QPen
from PyQt6.QtWidgets import QSizePolicy, QVBoxLayout, QWidget

from ...core.errors import minus
from ...core.estimation.tilt import Tilt
from ...core.model.arrays import Float32Array, Float64Array
from ...widgets.basics.colormaps import CONTACT_ROW, Theme, patch_lut
from ...widgets.basics.controls import wrapped_label
from ...widgets.basics.theme import text_font, theme_colors
from ...widgets.clouds.cloud_data import DepthCloud, free_cloud
from ...widgets.plots.plot import Plot

#: Colours of roll, pitch and the fitted plane, in both themes.
ROLL_RGB: Final = (235, 60, 40)
PITCH_RGB: Final = (40, 150, 255)
PLANE_COLOR: Final = QColor(*PITCH_RGB)
_PLANE_ROW = CONTACT_ROW - 1
#: Lines of the plane in each direction, and points on each; length of the normal, metres.
_LINES, _ON_LINE, _NORMAL_M = 9, 160, 0.03
#: Frames in the CSV, and the newest ones that the plot shows.
MAX_ROWS, PLOTTED = 20_000, 1800
#: Ends of a dial's scale, degrees; the first that holds the angle.
_SCALES = (10, 30, 90)
_SWEEP_DEG = 75.0


def patch_with_plane(points: Float32Array, tilt: Tilt, theme: Theme) -> DepthCloud:
    """Return the patch, with the fitted plane as a grid and its normal where both angles are determined."""
    lines = plane_lines(points, tilt)
    rows = np.concatenate([np.full(len(points), CONTACT_ROW), np.full(len(lines), _PLANE_ROW)])
    lut = patch_lut(theme).copy()
    lut[_PLANE_ROW] = (*PITCH_RGB, 255)
    return free_cloud(np.concatenate([points, lines]), rows.astype(np.uint8), lut, count=len(points))


def plane_lines(points: Float32Array, tilt: Tilt) -> Float64Array:
    """Return points on a grid in the plane around the patch and on its normal towards the camera, shape (N, 3)."""
    if tilt.roll_rad is None or tilt.pitch_rad is None or tilt.centroid_m is None:
        return np.empty((0, 3))
    roll, pitch, centre = tilt.roll_rad, tilt.pitch_rad, np.array(tilt.centroid_m)
    normal = np.array([math.sin(pitch) * math.cos(roll), -math.sin(roll), math.cos(pitch) * math.cos(roll)])
    away = points - centre
    across = np.array([math.cos(pitch), 0.0, -math.sin(pitch)])
    down = np.cross(normal, across)
    (u0, u1), (v0, v1) = ((float(part.min()), float(part.max())) for part in (away @ across, away @ down))
    step, fine = np.linspace(0, 1, _LINES), np.linspace(0, 1, _ON_LINE)
    along = [(s, t) for s in step for t in fine] + [(t, s) for s in step for t in fine]
    s, t = np.array(along).T
    grid = centre + np.outer(u0 + s * (u1 - u0), across) + np.outer(v0 + t * (v1 - v0), down)
    return np.concatenate([grid, centre - np.outer(fine * _NORMAL_M, normal)])


def degrees_text(angle_rad: float | None, sigma_rad: float | None) -> str:
    """Return an angle with its standard deviation in degrees, or that it is not determined."""
    if angle_rad is None or sigma_rad is None:
        return "not determined"
    return minus(f"{math.degrees(angle_rad):z.2f}° ± {math.degrees(sigma_rad):.2f}°")


class AngleDial(QWidget):
    """An angle as a needle on a scale, its standard deviation as a wedge, and both as text."""

    def __init__(self, title: str, tip: str, rgb: tuple[int, int, int]) -> None:
        super().__init__()
        self._title, self._color = title, QColor(*rgb)
        self._angle_rad: float | None = None
        self._sigma_rad: float | None = None
        self.setToolTip(tip)
        self.setAccessibleName(title)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setValue(None, None)

    def value(self) -> tuple[float | None, float | None]:
        """Return angle and standard deviation, radians; None where not determined."""
        return self._angle_rad, self._sigma_rad

    def text(self) -> str:
        """Return the text under the needle."""
        return f"{self._title} {degrees_text(self._angle_rad, self._sigma_rad)}"

    def setValue(self, angle_rad: float | None, sigma_rad: float | None) -> None:
        """Show an angle and its standard deviation, radians; None where not determined."""
        self._angle_rad, self._sigma_rad = angle_rad, sigma_rad
        self.setAccessibleDescription(self.text())
        self.update()

    def sizeHint(self) -> QSize:
        """Return room for the scale and the text."""
        text = QFontMetrics(text_font("body", bold=True)).horizontalAdvance(f"{self._title} not determined") + 16
        return QSize(max(text, 180), 140)

    def minimumSizeHint(self) -> QSize:
        """Return the size below which the text would be cut off."""
        return self.sizeHint()

    def paintEvent(self, _: QPaintEvent | None) -> None:
        """Draw scale, wedge, needle and text."""
        painter, colors = QPainter(self), theme_colors()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        metrics = QFontMetrics(text_font("body", bold=True))
        below, numbers = metrics.height() + 6, QFontMetrics(text_font("caption"))
        above, beside = numbers.height() + 4, numbers.horizontalAdvance(f"−{_SCALES[-1]}°") + 8
        radius = min(self.height() - below - above - 4.0, self.width() / 2 - beside)
        centre = QPointF(self.width() / 2, above + radius)
        angle = None if self._angle_rad is None else math.degrees(self._angle_rad)
        scale = next((end for end in _SCALES if angle is None or abs(angle) <= end), _SCALES[-1])
        self._draw_scale(painter, centre, radius, scale)
        if angle is not None and self._sigma_rad is not None:
            half = max(math.degrees(self._sigma_rad) / scale * _SWEEP_DEG, 0.5)
            middle, box = angle / scale * _SWEEP_DEG, QRectF(-radius, -radius, 2 * radius, 2 * radius)
            wedge = QColor(self._color)
            wedge.setAlpha(90)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(wedge)
            painter.drawPie(box.translated(centre), round(16 * (90 - middle - half)), round(16 * 2 * half))
            painter.setPen(QPen(self._color, 2.5))
            painter.drawLine(centre, _on_circle(centre, radius, middle))
        painter.setPen(QColor(colors.text if angle is not None else colors.muted))
        painter.setFont(text_font("body", bold=True))
        painter.drawText(
            QRectF(0, self.height() - below, self.width(), below), Qt.AlignmentFlag.AlignCenter, self.text()
        )

    def _draw_scale(self, painter: QPainter, centre: QPointF, radius: float, scale: int) -> None:
        colors = theme_colors()
        painter.setFont(text_font("caption"))
        metrics = QFontMetrics(painter.font())
        for part in range(-10, 11):
            at, long = part / 10 * _SWEEP_DEG, part % 5 == 0
            painter.setPen(QPen(QColor(colors.muted), 1.5 if long else 1.0))
            painter.drawLine(_on_circle(centre, radius, at), _on_circle(centre, radius - (9 if long else 5), at))
            if abs(part) == 10 or part == 0:
                text = minus(f"{part * scale // 10}°")
                wide, high = metrics.horizontalAdvance(text), metrics.height()
                place = _on_circle(centre, radius + 4, at)  # outside the scale, away from the needle
                left = place.x() - wide * (1 - part / 10) / 2
                top = place.y() - (high if part == 0 else high / 2)
                painter.drawText(QRectF(left, top, wide, high), Qt.AlignmentFlag.AlignCenter, text)


def _on_circle(centre: QPointF, radius: float, from_top_deg: float) -> QPointF:
    turn = math.radians(from_top_deg)
    return centre + radius * QPointF(math.sin(turn), -math.cos(turn))


@dataclass(frozen=True)
class TiltRow:
    """The tilt of one frame, from the frame alone and filtered over time."""

    raw: Tilt
    filtered: Tilt


_ANGLES = ("roll", "pitch", "axis")
_COLUMNS = [
    "frame",
    "time_s",
    "method",
    "points",
    *(f"{angle}{sigma}_deg" for angle in _ANGLES for sigma in ("", "_sigma")),
    *(f"filtered_{angle}{sigma}_deg" for angle in _ANGLES[:2] for sigma in ("", "_sigma")),
    *(f"filtered_{angle}_rate{sigma}_deg_s" for angle in _ANGLES[:2] for sigma in ("", "_sigma")),
]


def rows_as_csv(rows: Iterable[TiltRow]) -> str:
    """Return one line for each frame, degrees; empty where not determined. Frames count from 0."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for row in rows:
        raw, filtered = row.raw.record(), row.filtered.record()
        values = [raw[f"{angle}{sigma}_rad"] for angle in _ANGLES for sigma in ("", "_sigma")]
        values += [filtered[f"{angle}{sigma}_rad"] for angle in _ANGLES[:2] for sigma in ("", "_sigma")]
        values += [filtered.get(f"{angle}_rate{sigma}_rad_s") for angle in _ANGLES[:2] for sigma in ("", "_sigma")]
        degrees = [None if value is None else round(math.degrees(value), 4) for value in values]
        writer.writerow([row.raw.sequence, round(row.raw.time_s, 6), row.raw.method, row.raw.points, *degrees])
    return text.getvalue()


class TiltCurve(QWidget):
    """Roll and pitch over time with bands of one standard deviation; gaps where they are not determined."""

    def __init__(self) -> None:
        super().__init__()
        self.plot = Plot("Time, s", "Angle, degrees", movable=True)
        self.plot.getViewBox().setLimits(minXRange=0.2, minYRange=0.5)
        self.plot.getPlotItem().showGrid(x=True, y=True, alpha=0.2)
        self.plot.setToolTip(
            "Roll and pitch over the time stamps of the frames, with a band of one standard deviation. "
            "Drag to move, wheel to zoom; press A to show all again"
        )
        self.plot.setAccessibleName("Roll and pitch over time")
        self.plot.add_legend(2)
        self._parts = []
        for name, rgb in (("roll", ROLL_RGB), ("pitch", PITCH_RGB)):
            ends = [pg.PlotCurveItem(connect="finite", pen=None) for _ in range(2)]
            band = pg.FillBetweenItem(*ends, brush=pg.mkBrush(*rgb, 60))
            for item in (*ends, band):
                self.plot.addItem(item)
            self._parts.append((name, self.plot.plot(name=name, pen=pg.mkPen(rgb, width=1.5), connect="finite"), ends))
        #: Shown instead of axes without a curve.
        self.empty = wrapped_label("No curve yet: play, or step to the next frames with contact")
        self.empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.empty, 1)
        layout.addWidget(self.plot, 1)
        self.plot.follow_theme()
        self.show_tilts([])

    def show_tilts(self, tilts: list[Tilt]) -> None:
        """Draw tilts in the order of time."""
        known = sum(tilt.roll_rad is not None or tilt.pitch_rad is not None for tilt in tilts) > 1  # one is no curve
        self.plot.setVisible(known)
        self.empty.setVisible(not known)
        times = np.array([tilt.time_s for tilt in tilts])
        for name, curve, ends in self._parts:
            pairs = [(getattr(tilt, f"{name}_rad"), getattr(tilt, f"{name}_sigma_rad")) for tilt in tilts]
            angle, sigma = np.degrees(np.array(pairs, np.float64).reshape(-1, 2).T)  # None becomes nan
            curve.setData(times, angle)
            for end, sign in zip(ends, (-1, 1), strict=True):
                end.setData(times, angle + sign * sigma)
