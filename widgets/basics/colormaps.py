"""The colours of depth, of the relative difference and of provenance, and their legends.

Depth and relative difference use perceptually uniform maps. All are told apart with any colour vision.
Contact has one fixed colour everywhere.
"""

from __future__ import annotations

from collections.abc import Container
from functools import cache, lru_cache
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import pyqtgraph as pg
from PyQt6.QtGui import QColor

from ...core.model.arrays import BoolArray, Float32Array, Float64Array, Uint8Array, Uint16Array
from ...core.model.patch import Provenance
from .theme import ThemeName

Legend = list[tuple[str, QColor]]

#: Contact, in every view and image of both themes.
CONTACT_RGB: Final = (232, 70, 22)
CONTACT_COLOR: Final = QColor(*CONTACT_RGB)

#: What the mask covers, in every view, image and legend of both themes.
MASKED_RGB: Final = (98, 70, 234)

#: Relative difference at both ends of the colour scale.
DIFFERENCE_LIMIT: Final = 0.10

#: Rows of the tables: undefined difference; contact in a patch.
UNDEFINED_ROW: Final = 0
CONTACT_ROW: Final = 255

_DEPTH_MAP, _DEPTH_PART = "viridis", (0.96, 0.14)
_PRESSURE_MAP, _PRESSURE_PART, _PRESSURE_ROWS = "magma", (0.22, 0.97), 127
#: Blue, white, ochre: made for colour-blind people (P. Kovesi, CET perceptually uniform colour maps).
_DIFFERENCE_MAP = "CET-CBD1"
#: Colour map outside the tolerance band; the pale centre of the map would vanish on a light background.
_DIFFERENCE_STARTS, _DIFFERENCE_ENDS = 0.3, 0.85
_CANDIDATE_RGB = (245, 158, 120)
#: Opacity of what lies behind the range of the depth colours, such as a wall behind the object.
_BEHIND_ALPHA = 56
_UNDEFINED_RGBA = (128, 128, 128, 70)


class _Shown(NamedTuple):
    """How a verdict on a pixel is called and coloured."""

    name: str
    rgb: tuple[int, int, int]
    dark_rgb: tuple[int, int, int] | None = None  # in the dark theme, where it is another one


#: The most important first. The colours from contact to no tactile depth were found by a search for the largest
#: distance in CIE L*a*b* between any two, with any colour vision.
_VERDICTS: Final = {
    Provenance.CONTACT: _Shown("contact", CONTACT_RGB),
    Provenance.RIM: _Shown("rim", (147, 53, 32)),
    Provenance.OUTSIDE_TOLERANCE: _Shown("not touching", (200, 200, 198), (82, 82, 80)),
    Provenance.MASKED: _Shown("masked", MASKED_RGB),
    Provenance.OUTLIER: _Shown("outlier", (219, 198, 0)),
    Provenance.SMALL_CLUSTER: _Shown("small contact", (15, 147, 98)),
    Provenance.NO_TACTILE_DEPTH: _Shown("no tactile depth", (68, 198, 252)),
    Provenance.OUTSIDE_RANGE: _Shown("out of range", (196, 204, 222), (58, 66, 88)),
    Provenance.OUTSIDE_REGION: _Shown("out of region", (226, 226, 230), (50, 50, 54)),
    Provenance.NO_PROXIMITY_DEPTH: _Shown("no depth", (242, 242, 242), (26, 26, 26)),
}
#: Verdicts on points that agreed in distance; later steps decided.
LATE_VERDICTS: Final = tuple(Provenance)[Provenance.MASKED :]
#: Near and far end of the relief around a patch.
_RELIEF_GRAY: dict[str, tuple[int, int]] = {"light": (226, 168), "dark": (116, 58)}


@cache
def depth_lut() -> Uint8Array:
    """Return the depth colours, near (bright) to far: uint8 (256, 4)."""
    return _frozen(_sample(_DEPTH_MAP, np.linspace(*_DEPTH_PART, 256)))


@cache
def depth_lut_faint_behind() -> Uint8Array:
    """Return the depth colours of a view, faint behind the far end: uint8 (256, 4)."""
    lut = depth_lut().copy()
    lut[255, 3] = _BEHIND_ALPHA
    return _frozen(lut)


@cache
def behind_legend() -> Legend:
    """Return the legend of the last row of `depth_lut_faint_behind`."""
    return [("behind", QColor(*map(int, depth_lut_faint_behind()[255])))]


def ends_legend(low: str, high: str, lut: Uint8Array) -> Legend:
    """Return the legend of a scale whose ends are rows 1 and 255 of a table of colours."""
    return [(low, _color(lut, 1)), (high, _color(lut, 255))]


@lru_cache(maxsize=8)
def depth_legend(near_m: float, far_m: float) -> Legend:
    span_mm = 1e3 * (far_m - near_m)
    return [(f"{1e3 * near_m + share * span_mm:.0f} mm", _color(depth_lut(), 255 * share)) for share in (0.0, 0.5, 1.0)]


@cache
def pressure_lut(theme: ThemeName) -> Uint8Array:
    """Return the colours of contact pressure: uint8 (256, 4), row 0 where it is not known, 1 for none, then more."""
    lut = np.zeros((256, 4), np.uint8)
    lut[1 : _PRESSURE_ROWS + 1] = _sample(_PRESSURE_MAP, np.linspace(*_PRESSURE_PART, _PRESSURE_ROWS))
    lut[UNDEFINED_ROW] = provenance_lut(theme)[Provenance.OUTSIDE_RANGE]
    return _frozen(lut)


def pressure_index(relative: Float32Array, top: float) -> Uint8Array:
    """Return rows of `pressure_lut` for shares of the inflation, float32; from ``top`` on it is the last row."""
    last = np.float32(_PRESSURE_ROWS - 1)
    rows = np.clip(relative * (last / np.float32(top)), np.float32(0.0), last) + np.float32(1.5)
    return np.asarray(np.nan_to_num(rows, nan=UNDEFINED_ROW, copy=False), np.uint8)


def pressure_legend(theme: ThemeName, top: float, inflation_pa: float) -> Legend:
    """Return the legend of pressures up to a share of the inflation: in kPa, or relative to one that is not known."""
    lut, unit = pressure_lut(theme), "kPa" if inflation_pa > 0 else "× inflation"
    highest = top * (1e-3 * inflation_pa or 1.0)
    names = "0", f"{highest / 2:.3g}", f"{highest:.3g} {unit}", "not known"
    rows = 1, (1 + _PRESSURE_ROWS) / 2, _PRESSURE_ROWS, UNDEFINED_ROW
    return [(name, _color(lut, row)) for name, row in zip(names, rows, strict=True)]


def scale_index(values: Float32Array, low: float, high: float) -> Uint8Array:
    """Return rows of a table of colours for float32 (H, W): 1 to 255 from ``low`` to ``high``, 0 for nan."""
    per_row = 254.0 / (high - low)
    rows = values * np.float32(per_row)
    rows += np.float32(1.5 - low * per_row)
    np.clip(rows, np.float32(1.0), np.float32(255.0), out=rows)
    np.fmax(rows, np.float32(UNDEFINED_ROW), out=rows)  # takes the place of nan
    return rows.astype(np.uint8)


@cache
def difference_lut(t: float = 0.03, limit: float = DIFFERENCE_LIMIT) -> Uint8Array:
    """Return the colours of relative differences: one pale tint within ``t``, ochre where tactile is smaller."""
    relative = (np.arange(256) - 128.0) * (limit / 127.0)
    beyond = np.clip((np.abs(relative) - t) / max(limit - t, 1e-9), 0.0, 1.0)
    away = _DIFFERENCE_STARTS + (_DIFFERENCE_ENDS - _DIFFERENCE_STARTS) * beyond
    lut = _sample(_DIFFERENCE_MAP, 0.5 + 0.5 * np.sign(relative) * away)
    lut[np.abs(relative) <= t] = (*_CANDIDATE_RGB, 255)
    lut[UNDEFINED_ROW] = _UNDEFINED_RGBA
    return _frozen(lut)


def difference_legend(t: float, limit: float = DIFFERENCE_LIMIT) -> Legend:
    low, high = ends_legend(f"−{100 * limit:.0f} %", f"+{100 * limit:.0f} %", difference_lut(t, limit))
    within = [(f"within ±{100 * t:.1f} %", QColor(*_CANDIDATE_RGB))] if t > 0 else []  # only some contact tests use it
    return [low, *within, high]


@cache
def provenance_lut(theme: ThemeName) -> Uint8Array:
    """Return one colour for every `Provenance`: uint8 (256, 4); rows without a meaning are hidden."""
    lut = np.zeros((256, 4), np.uint8)
    for verdict, shown in _VERDICTS.items():
        dark_rgb = shown.dark_rgb or shown.rgb
        lut[verdict] = (*(dark_rgb if theme == "dark" else shown.rgb), 255)
    return _frozen(lut)


def relief_index(depth: Uint16Array, near: float, far: float) -> Uint8Array:
    """Return rows of `patch_lut` for raw depth around a patch, shaded from near to far: uint8 (H, W)."""
    beyond: Any = cv2.subtract(depth, float(round(near)))  # type: ignore[call-overload]  # 0 where nearer
    rows = cv2.convertScaleAbs(beyond, alpha=(CONTACT_ROW - 1) / (far - near))  # several times faster than a table
    return np.asarray(cv2.min(rows, CONTACT_ROW - 1), np.uint8)  # type: ignore[call-overload]


@cache
def patch_lut(theme: ThemeName) -> Uint8Array:
    """Return the colours of `relief_index`, faint behind its range, and in the last row of contact: uint8 (256, 4)."""
    near, far = _RELIEF_GRAY[theme]
    lut = np.full((256, 4), 255, np.uint8)
    lut[:CONTACT_ROW, :3] = np.rint(np.linspace(near, far, CONTACT_ROW))[:, None]
    lut[CONTACT_ROW, :3] = CONTACT_RGB
    lut[CONTACT_ROW - 1, 3] = _BEHIND_ALPHA
    return _frozen(lut)


def provenance_legend(theme: ThemeName, occurring: Container[Provenance] = frozenset(Provenance)) -> Legend:
    """Return the name and colour of every `Provenance` that occurs, the most important first."""
    lut = provenance_lut(theme)
    return [(shown.name, _color(lut, verdict)) for verdict, shown in _VERDICTS.items() if verdict in occurring]


@cache
def patch_legend(theme: ThemeName) -> Legend:
    lut = patch_lut(theme)
    return [("contact", CONTACT_COLOR), ("not touching", _color(lut, CONTACT_ROW / 2))]


def over_background(lut: Uint8Array, background: tuple[int, int, int]) -> Uint8Array:
    """Mix a table's colours with a background by their alpha: uint8 (256, 4), alpha 255, or 0 if hidden."""
    alpha = lut[:, 3:].astype(np.float64) / 255
    mixed = np.empty_like(lut)
    mixed[:, :3] = np.rint(lut[:, :3] * alpha + np.array(background) * (1 - alpha))
    mixed[:, 3] = np.where(lut[:, 3] > 0, 255, 0)
    return mixed


def tint(pixels: Uint8Array, where: BoolArray, rgb: tuple[int, int, int], share: float) -> None:
    """Mix a colour by its share into some pixels of an image, uint8 (H, W, 4) as ``QImage.Format_RGB32``, in place."""
    tinted = cv2.add(cv2.convertScaleAbs(pixels, alpha=1.0 - share), share * np.array((*rgb[::-1], 255)))
    cv2.copyTo(tinted, np.ascontiguousarray(where).view(np.uint8), pixels)


def _sample(name: str, positions: Float64Array) -> Uint8Array:
    colors = pg.colormap.get(name).map(positions, mode="byte")
    return np.ascontiguousarray(colors, dtype=np.uint8)


def _frozen(lut: Uint8Array) -> Uint8Array:
    lut.flags.writeable = False
    return lut


def _color(lut: Uint8Array, row: float) -> QColor:
    return QColor(*(int(channel) for channel in lut[round(row), :3]))
