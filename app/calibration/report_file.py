"""The quality report of a session: the pictures that the wizard shows, with the numbers of the core's report."""

from __future__ import annotations

from pathlib import Path

from ...core.calibration import CalibrationReport
from ...core.calibration.html_report import write_html
from ...core.model.arrays import Uint8Array
from .overlay import OverlayMode, make_overlay
from .prediction import Alignment
from .quality_page import uncertainty_picture
from .session import Snapshot


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
