"""The quality report of a calibration as one HTML file with its pictures inside."""

from __future__ import annotations

import base64
import platform
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.metadata import version
from pathlib import Path
from string import Template

import cv2
import numpy as np

from ..errors import CalibrationError, minus
from ..model.arrays import Uint8Array
from ..model.files import atomic_path
from ..model.frames import Rig, SensorFrame
from .report import NUMBERS, CalibrationReport, PairQuality, shown

#: Residual arrows are drawn this much longer than they are.
ARROW_FACTOR = 10
USED_RGB, _REJECTED_RGB, _ARROW_RGB = (64, 196, 255), (255, 92, 80), (255, 255, 255)
_BLANK = 40
_CELL_PX = 80
_PAGE = Template("""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>$title</title><style>
body { font: 15px/1.45 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #1b2026;
       background: #fff }
table { border-collapse: collapse; margin: .5rem 0 }
th, td { border: 1px solid #b4bac2; padding: .15rem .6rem; text-align: right }
th:first-child, td:first-child { text-align: left }
img { max-width: 100% } figure { margin: 1rem 0 } .verdict { font-size: 1.2rem; font-weight: 600 }
</style></head><body>
<h1>$title</h1>
<p class="verdict">$verdict</p>
<ul>$notes</ul>
<h2>Numbers</h2>
$numbers
<h2>Pictures</h2>
$pictures
<h2>Made with</h2>
$made_with
<h2>Pairs, largest residual first</h2>
$pairs
</body></html>
""")


def write_html(
    path: Path | str,
    report: CalibrationReport,
    preset_name: str,
    frame: SensorFrame | None = None,
    pictures: Mapping[str, Uint8Array] | None = None,
) -> None:
    """Write the report with verdict, numbers, pictures, versions and rig into one file, atomically.

    Parameters
    ----------
    path : path-like
    report : CalibrationReport
    preset_name : str
        The preset that the calibration is for.
    frame : SensorFrame, optional
        The residuals are drawn over its colour images; None draws them over a blank image.
    pictures : mapping of title to uint8 (H, W, 3), RGB, optional
        Further pictures.

    Raises
    ------
    ExportError
        The file cannot be written.
    CalibrationError
        A picture cannot be encoded.
    """
    images = residual_pictures(report, frame) | {"Points per cell of the proximity image": coverage_picture(report)}
    notes = [report.reason, report.depth_advice.reason, *(f"Warning: {words}" for words in report.warnings)]
    notes += [f"Not fitted, {name}: {reason}" for name, reason in report.refused.items()]
    names = list(report.quality)
    rows = [
        [f"{title.strip()} ({unit})" if unit else title.strip()]
        + [shown(value(report.quality[name]), 0, 2 if unit else 4) for name in names]
        for title, unit, value in NUMBERS
    ]
    by_size = sorted(report.chosen.pairs, key=lambda pair: -np.nan_to_num(pair.residual_px))
    text = _PAGE.substitute(
        title=escape(f"Calibration quality: {preset_name}"),
        verdict=escape(report.verdict),
        notes="".join(f"<li>{escape(note)}</li>" for note in notes),
        numbers=_table(["", *(f"{name}, used" if name == report.model else name for name in names)], rows),
        pictures="".join(_figure(title, image) for title, image in (images | dict(pictures or {})).items()),
        made_with=_table(["", ""], _made_with(report, preset_name)),
        pairs=_table(
            ["Pair", "dX px", "dY px", "Residual px", "mm", "Cross-validated px", "Used"], map(_pair_row, by_size)
        ),
    )
    with atomic_path(path) as temporary:
        temporary.write_text(text, "utf-8")


def residual_pictures(report: CalibrationReport, frame: SensorFrame | None) -> dict[str, Uint8Array]:
    """Return the pairs over both images, RGB; in the proximity image with arrows from each click to where it is fitted.

    The proximity image is the one in which most pairs were clicked, colour or depth; pairs of the other are left out.
    """
    rig, fits = report.rig, {pair.id: pair for pair in report.chosen.pairs}
    pairs = [pair for pair in report.pairs if pair.id in fits]
    kinds = [pair.proximity_image for pair in pairs]
    kind = max(sorted(set(kinds)), key=kinds.count)
    left = _blank(rig.proximity_color_shape if kind == "color" else rig.proximity.intrinsics.shape)
    right = _blank(rig.tactile.intrinsics.shape)
    if frame is not None and kind == "color":
        left = frame.proximity_color.copy()
    if frame is not None and frame.tactile_color is not None and frame.tactile_color.shape == right.shape:
        right = frame.tactile_color.copy()
    for pair in pairs:
        fit = fits[pair.id]
        color = USED_RGB if fit.used else _REJECTED_RGB
        _ring(right, pair.tactile, color)
        if pair.proximity_image == kind:
            _ring(left, pair.proximity, color)
            end = pair.proximity[0] - ARROW_FACTOR * fit.residual_u, pair.proximity[1] - ARROW_FACTOR * fit.residual_v
            if np.isfinite(end).all():
                cv2.line(left, _pixel(pair.proximity), _pixel(end), _ARROW_RGB, 1, cv2.LINE_AA)
    return {
        f"Proximity camera, residuals enlarged {ARROW_FACTOR} times (red: rejected)": left,
        "Tactile camera (red: rejected)": right,
    }


def coverage_picture(report: CalibrationReport) -> Uint8Array:
    """Return the number of points in each cell of the proximity image, the fuller the darker, RGB."""
    cells = np.array(report.coverage.cells)
    shade = (255 - 150 * cells / max(cells.max(), 1)).astype(np.uint8).repeat(_CELL_PX, 0).repeat(_CELL_PX, 1)
    image = np.dstack([shade, shade, np.full_like(shade, 255)])
    for (row, column), count in np.ndenumerate(cells):
        place = _CELL_PX * column + 24, _CELL_PX * row + 48
        cv2.putText(image, str(count), place, cv2.FONT_HERSHEY_SIMPLEX, 0.7, (0, 0, 0), 1, cv2.LINE_AA)
    return np.asarray(image, np.uint8)


def _blank(shape: tuple[int, int]) -> Uint8Array:
    return np.full((*shape, 3), _BLANK, np.uint8)


def _pixel(place: tuple[float, float]) -> tuple[int, int]:
    u, v = np.clip(np.rint(place), -10_000, 10_000)
    return int(u), int(v)


def _ring(image: Uint8Array, place: tuple[float, float], color: tuple[int, int, int]) -> None:
    cv2.circle(image, _pixel(place), 4, color, 1, cv2.LINE_AA)


def _figure(title: str, image: Uint8Array) -> str:
    """Return a picture (RGB) as a PNG in a data URI, with its title."""
    done, data = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    if not done:
        raise CalibrationError(f"the picture {title!r} could not be encoded; its shape is {image.shape}")
    words = escape(title)
    uri = base64.b64encode(data.tobytes()).decode()
    return f'<figure><figcaption>{words}</figcaption><img alt="{words}" src="data:image/png;base64,{uri}"></figure>\n'


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>\n" for row in rows)
    return f"<table><tr>{''.join(f'<th>{escape(title)}</th>' for title in header)}</tr>\n{lines}</table>"


def _made_with(report: CalibrationReport, preset_name: str) -> list[list[str]]:
    rig: Rig = report.rig
    pose = report.rigid
    rows = [
        ["Preset", preset_name],
        ["Date", report.date.isoformat(timespec="seconds")],
        ["Proximity camera", f"{rig.proximity.model}, serial {rig.proximity.serial}"],
        ["Tactile camera", f"{rig.tactile.model}, serial {rig.tactile.serial}"],
        ["Model", report.model],
        ["Correction of the tactile depth", report.depth_fit],
        ["Tactune", version("tactune")],
        ["Python, NumPy, OpenCV", f"{platform.python_version()}, {np.__version__}, {cv2.__version__}"],
    ]
    if pose is not None:
        numbers = "; ".join(" ".join(f"{value:.6f}" for value in row) for row in pose.T_proximity_tactile[:3])
        rows.append(["T_proximity_tactile (rows; metres)", numbers])
        rows.append(["Tactile depth", minus(f"{pose.pose.scale:.5f} x raw {1e3 * pose.pose.offset_m:+.2f} mm")])
    if report.homography is not None:
        numbers = "; ".join(" ".join(f"{value:.6g}" for value in row) for row in report.homography.H_p_t)
        rows.append(["H_p_t (rows)", numbers])
    return rows


def _pair_row(pair: PairQuality) -> list[str]:
    values = (pair.residual_u, pair.residual_v, pair.residual_px, pair.residual_mm, pair.left_out_px)
    return [pair.id, *(shown(value, 0) for value in values), "yes" if pair.used else "rejected"]
