"""The tab Tilt: the patch with its plane, roll and pitch with their standard deviations, and both over time."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QColor

from ...core.errors import minus
from ...core.estimation.tilt import MAX_SIGMA_RAD, Tilt, TiltEstimator
from ...core.model.arrays import Float32Array, Float64Array
from ...widgets.basics.colormaps import CONTACT_COLOR, CONTACT_ROW, patch_lut
from ...widgets.basics.controls import named, wrapped_label
from ...widgets.basics.layouts import holding, splitter, vbox
from ...widgets.basics.theme import THEME
from ...widgets.clouds.cloud_data import free_cloud
from ...widgets.clouds.cloud_view import CloudView
from ...widgets.plots.plot import Plot
from ..context import Context
from ..worker.jobs import Work
from ..worker.results import Result
from .tab import LiveTab, Row

_NOT_DETERMINED = f"no tilt, as of a line or a dot (standard deviation above {math.degrees(MAX_SIGMA_RAD):.0f}°)"
_ROLL_RGB, _PITCH_RGB = (235, 60, 40), (40, 150, 255)
_PLANE_ROW: Final = CONTACT_ROW - 1
#: Lines of the plane in each direction, and points on each; length of the normal, metres.
_LINES, _ON_LINE, _NORMAL_M = 9, 160, 0.03
#: The newest frames that the plot shows.
_PLOTTED: Final = 1800
_ANGLES: Final = [f"{angle}{sigma}_rad" for angle in ("roll", "pitch", "axis") for sigma in ("", "_sigma")]


class TiltTab(LiveTab):
    """Estimates the tilt of each frame that the main window shows."""

    COLUMNS = (
        *("frame", "time_s", "points"),
        *(name.replace("rad", "deg") for name in _ANGLES),
    )
    EXPORT = "tilt"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        #: The frame and the tilt on the screen; None before the first frame with a patch.
        self.shown: tuple[Result, Tilt] | None = None
        self.cloud = CloudView("Patch and plane")
        self.roll, self.pitch = (wrapped_label(verdict=True, selectable=True) for _ in range(2))
        self.axis = wrapped_label(selectable=True)
        self.roll.setToolTip("Angle about the camera's x axis: positive where the image's lower edge is farther")
        self.pitch.setToolTip("Angle about the camera's y axis: positive where the image's right edge is nearer")
        self.axis.setToolTip("Direction of the long axis in the image: 0° right, 90° down; none for a round patch")
        self.plot = named(
            Plot("Time, s", "Angle, degrees", movable=True),
            "Roll and pitch over time",
            "Roll and pitch over the seconds since the first frame shown, with a band of one standard deviation. "
            "Drag to move, wheel to zoom; press A to show all again",
        )
        self.plot.getPlotItem().showGrid(x=True, y=True, alpha=0.2)
        self.plot.add_legend(2)
        self._curves = [self._curve("roll", _ROLL_RGB), self._curve("pitch", _PITCH_RGB)]
        self.plot.follow_theme()
        side = holding(vbox(self.roll, self.pitch, self.axis, (self.plot, 1), margins=0))
        self.column.addWidget(splitter(Qt.Orientation.Horizontal, self.cloud, side, sizes=(480, 480)))
        self.cloud.set_message(self.status.text())

    def _curve(self, name: str, rgb: tuple[int, int, int]) -> tuple[pg.PlotDataItem, list[pg.PlotCurveItem]]:
        """Return a curve of the plot and the lower and upper end of its band."""
        ends = [pg.PlotCurveItem(connect="finite", pen=None) for _ in range(2)]
        for item in (*ends, pg.FillBetweenItem(*ends, brush=pg.mkBrush(*rgb, 60))):
            self.plot.addItem(item)
        return self.plot.plot(name=name, pen=pg.mkPen(rgb, width=1.5), connect="finite"), ends

    # Frames

    def begin(self, result: Result) -> None:
        self._show_none()

    def work(self, result: Result) -> Work:
        patch, rig = result.patch, result.source.rig
        return lambda _: None if patch is None else TiltEstimator(result.preset, rig).estimate(patch)

    def show_found(self, result: Result, found: Any) -> Row | None:
        if found is None or result.patch is None:
            self._show_none()
            self.cloud.set_message(result.problem)
            self.status.setText(result.problem)
            return None
        self.shown, points, tilt = (result, found), result.patch.points, found
        lines = plane_lines(points, tilt)
        colors = np.concatenate([np.full(len(points), CONTACT_ROW), np.full(len(lines), _PLANE_ROW)]).astype(np.uint8)
        lut = patch_lut(THEME.name).copy()
        lut[_PLANE_ROW] = (*_PITCH_RGB, 255)
        self.cloud.set_message("No contact yet: press the object into the membrane, or play to a frame with contact")
        both = np.concatenate([points, lines])
        self.cloud.set_cloud(free_cloud(both, colors, lut, count=len(points)) if len(points) else None)
        plane = [("fitted plane", QColor(*_PITCH_RGB))] if len(lines) else []
        self.cloud.header.set_entries([("patch", CONTACT_COLOR), *plane])
        self.roll.setText(f"Roll {degrees_text(tilt.roll_rad, tilt.roll_sigma_rad)}")
        self.pitch.setText(f"Pitch {degrees_text(tilt.pitch_rad, tilt.pitch_sigma_rad)}")
        self.axis.setText(f"Long axis {degrees_text(tilt.axis_rad, tilt.axis_sigma_rad)}")
        hints = [f"Frame {result.frame_number} of {result.source.name}"]
        hints += [_NOT_DETERMINED] if len(points) and not len(lines) else []
        if result.preset.noise is None:
            hints.append("usual noise assumed: measure it (F6)")
        self.status.setText(" · ".join(hints))
        angles = [getattr(tilt, name) for name in _ANGLES]
        degrees = [None if angle is None else round(math.degrees(angle), 4) for angle in angles]
        return (result.frame.sequence, round(result.frame.proximity_time_s, 6), len(points), *degrees)

    def _show_none(self) -> None:
        """Show no tilt: those of other frames would be taken for this one's."""
        self.shown = None
        self.cloud.set_cloud(None)
        for label in (self.roll, self.pitch, self.axis):
            label.setText("")

    def rows_changed(self) -> None:
        rows = sorted(list(self.rows.values())[-_PLOTTED:], key=lambda row: float(row[1]))
        times = np.array([row[1] - rows[0][1] for row in rows])  # live time stamps have ten digits
        first = self.COLUMNS.index("roll_deg")
        for place, (curve, ends) in enumerate(self._curves):
            at = first + 2 * place
            angle, sigma = np.array([row[at : at + 2] for row in rows], np.float64).reshape(-1, 2).T  # None: nan
            curve.setData(times, angle)
            for end, sign in zip(ends, (-1, 1), strict=True):
                end.setData(times, angle + sign * sigma)


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
