"""Detection of points in an image: the feature nearest to a click, and whole chessboards."""

from __future__ import annotations

from typing import Literal, NamedTuple

import cv2
import numpy as np

from ..errors import CalibrationError
from ..model.arrays import BoolArray, Float64Array, Uint8Array, spread

#: Half side of the window for corner refinement, pixels.
_CORNER_WINDOW = 5
_CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
#: Minimum contrast of a feature: grey levels between the 10 % and 90 % quantiles.
_MIN_CONTRAST = 12.0
#: Minimum response of a corner, as a share of the strongest in the window.
_STRONG_SHARE = 0.2
_MIN_BLOB_AREA, _MIN_ROUNDNESS = 6, 0.55
#: Minimum contrast of a blob, standard deviations of the noise from pixel to pixel.
_MIN_BLOB_SIGMAS = 5.0
#: Radii of the circles on which a crossing alternates between dark and bright, pixels, and number of samples.
_CIRCLES_PX, _SAMPLES = (3.0, 4.5), 48
#: Minimum correlation of a circle with itself turned by half, and share of its dark part where two edges cross.
_MIN_SYMMETRY, _DARK_SHARE = 0.7, (0.25, 0.75)


class Snapped(NamedTuple):
    """A feature near a click: a blob, the centre of a spot, or a crossing of two edges or lines."""

    u: float
    v: float
    kind: Literal["crossing", "blob"]


def snap_to_feature(image: Uint8Array, u: float, v: float, radius: float = 6.0) -> Snapped | None:
    """Return the blob centre or crossing nearest to a click.

    A closed dark or bright spot whose centre is within reach, or that was clicked, is a blob; its contrast-weighted
    centroid is returned. Otherwise the nearest crossing of two edges or lines is refined (Foerstner's gradient
    condition, as in OpenCV's ``cornerSubPix``). Other corners, such as places on the rim of a spot, are no features.

    None if there is no feature within ``radius`` pixels.
    """
    height, width = image.shape[:2]
    if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
        return None
    reach = int(4 * radius) + 16
    left, top = max(round(u) - reach, 0), max(round(v) - reach, 0)
    gray = to_gray(image[top : round(v) + reach + 1, left : round(u) + reach + 1])
    u, v = u - left, v - top
    near = int(np.ceil(2 * radius)) + 2
    found = (
        _blob_near(gray, u, v, radius, near)
        or _crossing_near(gray, u, v, radius)
        or _blob_near(gray, u, v, radius, 2 * near)
    )
    return None if found is None else Snapped(found.u + left, found.v + top, found.kind)


def to_gray(image: Uint8Array) -> Uint8Array:
    """Return a grey image of grey or RGB."""
    return np.ascontiguousarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image, np.uint8)


def _blob_near(gray: Uint8Array, u: float, v: float, radius: float, reach: int) -> Snapped | None:
    """Return the nearest spot of a window of half side ``reach``."""
    left, top = max(round(u) - reach, 0), max(round(v) - reach, 0)
    window = gray[top : round(v) + reach + 1, left : round(u) + reach + 1]
    threshold, _ = cv2.threshold(window, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    if np.ptp(window) < _MIN_CONTRAST:
        return None
    best: tuple[float, Snapped] | None = None
    clicked = round(v) - top, round(u) - left
    for inverted in (True, False):
        inside = (window <= threshold) if inverted else (window > threshold)
        for center, spot in _round_components(window, inside, threshold):
            place = Snapped(center[0] + left, center[1] + top, "blob")
            gap = float(np.hypot(place.u - u, place.v - v))
            if (gap <= radius or spot[clicked]) and (best is None or gap < best[0]):
                best = (gap, place)
    return best[1] if best else None


def _round_components(window: Uint8Array, inside: BoolArray, threshold: float) -> list[tuple[Float64Array, BoolArray]]:
    """Return weighted centroid and pixels of each round region that does not touch the window's border."""
    flat = cv2.medianBlur(window, 5)
    noise = spread(window.astype(np.float64) - flat)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(inside.astype(np.uint8), connectivity=4)
    height, width = window.shape
    centers = []
    for label in range(1, count):
        x, y, w, h, area = stats[label]
        touches = x == 0 or y == 0 or x + w == width or y + h == height
        if touches or area < _MIN_BLOB_AREA or area < _MIN_ROUNDNESS * w * h or min(w, h) < 0.4 * max(w, h):
            continue
        box = np.s_[max(y - 2, 0) : y + h + 2, max(x - 2, 0) : x + w + 2]
        region = cv2.dilate((labels[box] == label).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        values = window[box].astype(np.float64)
        outside = np.median(values[~region]) if (~region).any() else float(threshold)
        spot = labels == label
        if abs(np.median(window[spot]) - outside) < max(_MIN_CONTRAST, _MIN_BLOB_SIGMAS * noise):
            continue
        weights = np.where(region, np.abs(values - outside), 0.0)
        rows, columns = np.indices(weights.shape)
        total = weights.sum()
        center = (columns * weights).sum() / total + box[1].start, (rows * weights).sum() / total + box[0].start
        centers.append((np.array(center), spot))
    return centers


def _crossing_near(gray: Uint8Array, u: float, v: float, radius: float) -> Snapped | None:
    reach = int(np.ceil(radius)) + _CORNER_WINDOW + 6
    left, top = max(round(u) - reach, 0), max(round(v) - reach, 0)
    window = np.ascontiguousarray(gray[top : round(v) + reach + 1, left : round(u) + reach + 1])
    low, high = np.percentile(window, [10, 90])
    if high - low < _MIN_CONTRAST or min(window.shape) < 2 * _CORNER_WINDOW + 5:
        return None
    strength = cv2.cornerMinEigenVal(window, 5, ksize=3)
    rows, columns = np.indices(strength.shape)
    gaps = np.hypot(columns + left - u, rows + top - v)
    peaks = (strength == cv2.dilate(strength, np.ones((5, 5), np.uint8))) & (gaps <= radius + _CORNER_WINDOW)
    peaks &= strength >= _STRONG_SHARE * strength.max()
    found = []
    for row, column in np.argwhere(peaks):
        seed = np.array([[[column, row]]], np.float32)
        refined = cv2.cornerSubPix(window, seed, (_CORNER_WINDOW, _CORNER_WINDOW), (-1, -1), _CRITERIA)[0, 0]
        place = float(refined[0]) + left, float(refined[1]) + top
        gap = float(np.hypot(place[0] - u, place[1] - v))
        moved = float(np.hypot(refined[0] - column, refined[1] - row))
        if gap <= radius + 0.5 and moved <= _CORNER_WINDOW and _is_crossing(window, refined[0], refined[1]):
            found.append((gap, place))
    if not found:
        return None
    _, (x, y) = min(found)
    return Snapped(x, y, "crossing")


def _is_crossing(gray: Uint8Array, u: float, v: float) -> bool:
    """Tell whether two edges or lines cross: circles alternate, and look the same turned by half."""
    angles = 2 * np.pi * np.arange(_SAMPLES) / _SAMPLES
    radii = np.array([[0.0], *([radius] for radius in _CIRCLES_PX)])
    columns, rows = u + radii * np.cos(angles), v + radii * np.sin(angles)
    smooth = cv2.GaussianBlur(gray, (0, 0), 0.8)
    samples = cv2.remap(smooth, columns.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR).astype(
        np.float64
    )
    for circle in samples[:0:-1]:
        low, high = np.percentile(circle, [10, 90])
        contrast, mean = high - low, (high + low) / 2
        if contrast < _MIN_CONTRAST or np.corrcoef(circle, np.roll(circle, _SAMPLES // 2))[0, 1] < _MIN_SYMMETRY:
            return False
        dark = circle < mean
        changes = int((dark != np.roll(dark, 1)).sum())
        if changes == 8:  # on smaller circles the lines merge
            return True
        if changes != 4 or not _DARK_SHARE[0] < dark.mean() < _DARK_SHARE[1]:
            return False
        if abs(samples[0, 0] - mean) > 0.4 * contrast:
            return False
    return True


def detect_chessboard(image: Uint8Array, columns: int, rows: int) -> Float64Array:
    """Return the inner corners of a chessboard (columns x rows, 2), in rows from the upper left."""
    if min(columns, rows) < 3:
        raise CalibrationError(f"a chessboard of {columns} x {rows} is too small; give at least 3 x 3 inner corners")
    gray = to_gray(image)
    found, corners = cv2.findChessboardCorners(
        gray, (columns, rows), flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if not found:
        raise CalibrationError(
            f"no chessboard of {columns} x {rows} inner corners is seen; check its size, show it whole, evenly lit and "
            "in focus, or click the points by hand"
        )
    corners = corners.reshape(-1, 1, 2).astype(np.float32)
    refined = cv2.cornerSubPix(gray, corners, (_CORNER_WINDOW, _CORNER_WINDOW), (-1, -1), _CRITERIA)
    pixels = np.asarray(refined, np.float64).reshape(-1, 2)
    # a board looks alike after half a turn; both cameras stand upright
    return pixels if pixels[0].sum() <= pixels[-1].sum() else pixels[::-1]
