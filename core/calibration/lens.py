"""A camera's lens from pictures of a chessboard, or the nominal one of its model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from ..errors import CalibrationError
from ..model.arrays import AnyArray
from ..model.intrinsics import Distortion, Intrinsics
from ..model.loading import decode_image, read_file
from .detect import detect_chessboard

#: Files that count as pictures.
PICTURE_ENDINGS: Final = (".png", ".jpg", ".jpeg", ".bmp")

_MIN_PICTURES: Final = 4
#: No corner is found more exactly than this, one direction, pixels.
_CORNER_PX: Final = 0.05
#: Largest RMS distance of corners from where the fitted lens expects them, pixels.
_MAX_RMS_PX: Final = 1.5
#: Largest standard deviation of a focal length, as a share of it.
_MAX_FOCAL_SHARE: Final = 0.02
#: Views that depth cameras have: angle over the image's width or height, degrees.
_VIEW_DEG: Final = (10.0, 150.0)


@dataclass(frozen=True)
class CameraModel:
    """What the maker states: length of a count, nearest depth, and fields of view (horizontal, vertical)."""

    depth_unit_m: float
    near_m: float
    views_deg: Mapping[str, tuple[float, float]]


#: Intel's data sheets of the L500 and D400 families.
MODELS: Final = {
    "L515": CameraModel(0.00025, 0.2, {"depth": (70.0, 55.0), "colour": (70.0, 43.0)}),
    "D405": CameraModel(0.0001, 0.06, {"depth": (84.0, 58.0), "colour": (84.0, 58.0)}),
    "D435": CameraModel(0.001, 0.1, {"depth": (87.0, 58.0), "colour": (69.0, 42.0)}),
}


def nominal_lens(width: int, height: int, view_deg: tuple[float, float]) -> Intrinsics:
    """Return the lens that a field of view means: centred, square pixels, no distortion.

    The image is the sensor's, scaled, and cropped on two sides if its shape differs; so the larger of the two focal
    lengths holds.
    """
    across, down = (math.tan(math.radians(angle) / 2) for angle in view_deg)
    focal = max(width / 2 / across, height / 2 / down)
    return Intrinsics(width=width, height=height, fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2)


def check_lens(lens: Intrinsics, camera: str) -> None:
    """Raise `CalibrationError` if no depth camera has such a lens; ``camera`` names it in the message."""
    low, high = _VIEW_DEG
    for axis, focal, extent in (("fx", lens.fx, lens.width), ("fy", lens.fy, lens.height)):
        view = 2 * math.degrees(math.atan(extent / 2 / focal))
        if not low <= view <= high:
            raise CalibrationError(
                f"{camera}: {axis} is {focal:.6g} px, a view of {view:.0f} degrees over {extent} px, "
                f"but depth cameras have {low:.0f} to {high:.0f}; correct it"
            )


@dataclass(frozen=True)
class LensFit:
    """A lens fitted to pictures of a chessboard, with Brown-Conrady distortion.

    ``rms_px`` is the RMS distance of the corners from where the lens expects them, ``focal_sd_px`` the larger standard
    deviation of fx and fy, ``used`` the number of pictures with a whole board; ``refused`` says by file name why others
    were rejected.
    """

    intrinsics: Intrinsics
    rms_px: float
    focal_sd_px: float
    used: int
    refused: Mapping[str, str]


def fit_lens(folder: Path, columns: int, rows: int, size: tuple[int, int] | None = None) -> LensFit:
    """Fit a lens to the pictures of a chessboard in a folder (Zhang's method, OpenCV's ``calibrateCamera``).

    The board has ``columns`` x ``rows`` inner corners, is whole and at different tilts; the size of its squares does
    not matter. ``size`` is the width and height that the pictures must have. k3 is left at 0: few pictures do not
    determine it.
    """
    try:
        paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURE_ENDINGS)
    except OSError as error:
        raise CalibrationError(f"cannot list {folder}: {error.strerror or error}; choose another folder") from error
    found: list[AnyArray] = []
    refused: dict[str, str] = {}
    for path in paths:
        try:
            picture = decode_image(read_file(path), gray=True)
            height, width = picture.shape[:2]
            size = size or (width, height)
            if (width, height) != size:
                raise CalibrationError(f"it has {width} x {height} pixels, but {size[0]} x {size[1]} are needed")
            found.append(detect_chessboard(picture, columns, rows).astype(np.float32))
        except (OSError, ValueError, CalibrationError) as error:
            refused[path.name] = str(error)
    if len(found) < _MIN_PICTURES or size is None:
        why = "".join(f" ({name}: {sentence})" for name, sentence in list(refused.items())[:1])
        raise CalibrationError(
            f"{folder}: a whole chessboard of {columns} x {rows} inner corners is in {len(found)} of {len(paths)} "
            f"pictures, but {_MIN_PICTURES} are needed{why}"
        )
    board = np.zeros((columns * rows, 3), np.float32)
    board[:, :2] = np.mgrid[:columns, :rows].T.reshape(-1, 2)
    guess = np.array([[size[0], 0, (size[0] - 1) / 2], [0, size[0], (size[1] - 1) / 2], [0, 0, 1]], np.float64)
    rms, K, distortion, turns, shifts = cv2.calibrateCamera(
        [board] * len(found), found, size, guess, np.zeros(5), flags=cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS
    )
    fx, fy, cx, cy = (float(K[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    jacobians = [cv2.projectPoints(board, *pose, K, distortion)[1] for pose in zip(turns, shifts, strict=True)]
    focal_sd_px = _focal_sd(jacobians, max(rms / math.sqrt(2), _CORNER_PX))
    if not (rms <= _MAX_RMS_PX and fx > 0 and fy > 0):
        raise CalibrationError(
            f"{folder}: the corners miss the fitted lens by {rms:.1f} px (RMS); check that the board is flat and that "
            "one camera took all pictures"
        )
    uncertain = min(focal_sd_px / min(fx, fy), 1.0)
    if not uncertain <= _MAX_FOCAL_SHARE:
        raise CalibrationError(
            f"{folder}: these boards do not tell focal length from distance: fx is uncertain by {uncertain:.0%}; "
            "tilt the board by 20 degrees or more, in another direction in each picture"
        )
    lens = Intrinsics(
        width=size[0],
        height=size[1],
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        distortion=Distortion.BROWN_CONRADY,
        coefficients=tuple(np.ravel(distortion)[:5].tolist()),
    )
    check_lens(lens, str(folder))
    return LensFit(lens, float(rms), focal_sd_px, len(found), refused)


def _focal_sd(jacobians: Sequence[AnyArray], noise_px: float) -> float:
    """Return the larger standard deviation of fx and fy, pixels.

    It is the noise over the length of that part of a column which no other parameter explains. OpenCV's own deviations
    are small where parameters cannot be told apart, since it inverts without those directions.

    Parameters
    ----------
    jacobians : sequence of float64, shape (2 N, 15)
        Of the corners of each picture by turn, shift, fx, fy, cx, cy, k1, k2, p1, p2 and k3, which is fixed.
    noise_px : float
        Standard deviation of a corner, one direction.
    """
    rows = []
    for jacobian in jacobians:
        pose, lens = np.linalg.qr(jacobian[:, :6])[0], jacobian[:, 6:14]
        rows.append(lens - pose @ (pose.T @ lens))
    columns = np.concatenate(rows)
    lengths = []
    for focal in range(2):
        others = np.linalg.qr(np.delete(columns, focal, axis=1))[0]
        lengths.append(float(np.linalg.norm(columns[:, focal] - others @ (others.T @ columns[:, focal]))))
    return float(noise_px / max(min(lengths), 1e-12))
