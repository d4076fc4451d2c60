"""The print on the membrane, as a texture of the flat sheet.

Channel 0 is dark dye that infrared passes: droplets at random, which give the stereo camera its texture, or a grid of
dots for measuring strain. Channel 1 is the opaque print, which reflects infrared.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

from ...model.arrays import Float64Array, Uint8Array

Print = Literal["droplets", "dots"]

TEXEL_M: Final = 0.0004
#: Distance between the dots of the grid, and their radius, metres.
DOT_SPACING_M: Final = 0.010
DOT_RADIUS_M: Final = 0.0014
_DROPLET_SPACING_M: Final = 0.0105
#: Centres of the patches that reflect infrared, metres.
_OPAQUE_PLACES: Final = ((-0.128, -0.046), (-0.112, 0.058), (0.116, -0.060), (0.134, 0.030), (0.020, 0.084))


def paint_sheet(width_m: float, height_m: float, kind: Print) -> Uint8Array:
    """Paint the sheet, (rows, columns, 2). A grid of dots has no other print, so no dot is hidden."""
    rng = np.random.default_rng([0, 1])
    sheet = np.zeros((round(height_m / TEXEL_M) + 1, round(width_m / TEXEL_M) + 1, 2), dtype=np.uint8)
    if kind == "dots":
        for x, y in dot_grid(width_m, height_m):
            _paint_spot(sheet, x, y, DOT_RADIUS_M, 0.0, 0.0)
        return sheet
    for j in range(-10, 11):
        for i in range(-17, 18):
            x, y = (np.array([i + 0.5 * (j % 2), j]) + rng.uniform(-0.27, 0.27, 2)) * _DROPLET_SPACING_M
            _paint_spot(sheet, x, y, rng.uniform(0.0013, 0.0025), rng.uniform(0.0, 0.15), rng.uniform(0.0, 2 * np.pi))
    for place in _OPAQUE_PLACES:
        _paint_opaque(sheet, place, rng)
    return sheet


def dot_grid(width_m: float, height_m: float) -> Float64Array:
    """Return the places of the grid's dots on the flat sheet, row by row, (N, 2)."""
    columns, rows = dot_counts(width_m, height_m)
    i, j = np.meshgrid(np.arange(columns) - (columns - 1) / 2, np.arange(rows) - (rows - 1) / 2)
    return np.stack([i.ravel(), j.ravel()], axis=1) * DOT_SPACING_M


def dot_counts(width_m: float, height_m: float) -> tuple[int, int]:
    """Return how many dots the grid has along the length and the width; the rim keeps half a spacing free."""
    columns, rows = (int((size - DOT_SPACING_M) / DOT_SPACING_M) // 2 * 2 + 1 for size in (width_m, height_m))
    return columns, rows


def _paint_spot(sheet: Uint8Array, x_m: float, y_m: float, radius: float, wobble: float, phase: float) -> None:
    rows, columns = sheet.shape[:2]
    near = (slice(*_span(y_m, radius, rows)), slice(*_span(x_m, radius, columns)))
    y, x = (grid[near] for grid in _places(rows, columns))
    rim = radius * (1 + wobble * np.cos(2 * np.arctan2(y - y_m, x - x_m) + phase))
    cover = np.clip((rim - np.hypot(x - x_m, y - y_m)) / TEXEL_M + 0.5, 0, 1)
    sheet[(*near, 0)] = np.maximum(sheet[(*near, 0)], np.round(255 * cover).astype(np.uint8))


def _paint_opaque(sheet: Uint8Array, place: tuple[float, float], rng: np.random.Generator) -> None:
    px, py = place + rng.uniform(-0.005, 0.005, 2)
    a, b, turn = rng.uniform(0.008, 0.014), rng.uniform(0.006, 0.009), rng.uniform(0, np.pi)
    y, x = _places(*sheet.shape[:2])
    s, t = np.cos(turn) * (x - px) + np.sin(turn) * (y - py), np.cos(turn) * (y - py) - np.sin(turn) * (x - px)
    around = np.arctan2(t, s)
    rim = 1 + 0.12 * np.cos(2 * around + turn) + 0.10 * np.cos(3 * around) + 0.05 * np.cos(7 * around - turn)
    sheet[np.hypot(s / a, t / b) < rim, 1] = 255


def _places(rows: int, columns: int) -> tuple[Float64Array, Float64Array]:
    """Return y and x of every texel, as views that take no memory."""
    y, x = ((np.arange(count) - (count - 1) / 2) * TEXEL_M for count in (rows, columns))
    return np.broadcast_to(y[:, None], (rows, columns)), np.broadcast_to(x[None, :], (rows, columns))


def _span(centre: float, radius: float, texels: int) -> tuple[int, int]:
    texel = centre / TEXEL_M + 0.5 * (texels - 1)
    reach = 1.3 * radius / TEXEL_M + 2
    return max(int(texel - reach), 0), max(min(int(texel + reach) + 1, texels), 0)
