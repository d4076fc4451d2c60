"""Lenses as files and messages of other programs state them, brought to the pinhole cameras of `Intrinsics`.

Plumb bob is librealsense's Brown-Conrady model. Images of lenses beyond it (rational, thin prism, fisheye) are
rectified when they are read: each becomes the image of a lens without distortion and with the same camera matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from pydantic import ValidationError

from ..errors import SourceError, foreign
from ..model.arrays import AnyArray, Float32Array, Float64Array
from ..model.intrinsics import Distortion, Intrinsics

#: Names of lens models, as ROS, image_pipeline, Kalibr, OpenCV and camera makers write them.
_PINHOLE = (
    "plumb_bob",
    "radtan",
    "brown_conrady",
    "pinhole",
    "opencv",
    "rational_polynomial",
    "rational",
    "thin_prism",
)
_THIN_PRISM = ("rational_thin_prism", "thin_prism_tilt", "tilted")
_FISHEYE = ("equidistant", "fisheye", "equi", "kannala_brandt", "kannala_brandt4", "opencv_fisheye", "theta")
_NO_DISTORTION = ("", "none", "no", "null", "perfect", "rectified", "ideal")
#: OpenCV's numbers of coefficients of a pinhole lens.
_COUNTS = (4, 5, 8, 12, 14)


@dataclass(frozen=True, eq=False)
class Lens:
    """A lens without or with Brown-Conrady's distortion; ``table`` (H, W, 2) of column, row rectifies other models."""

    intrinsics: Intrinsics
    table: Float32Array | None = None

    def rectify(self, image: AnyArray) -> AnyArray:
        """Return an image without the distortion that `intrinsics` lacks; depth keeps its values, 0 outside."""
        if self.table is None:
            return image
        how = cv2.INTER_NEAREST if image.ndim == 2 else cv2.INTER_LINEAR
        return np.asarray(cv2.remap(image, self.table[..., 0], self.table[..., 1], how))


def make_lens(model: str, coefficients: Sequence[float], camera_matrix: Sequence[float], size: tuple[int, int]) -> Lens:
    """Return a lens of K row by row (9 numbers) and a size (width, height), pixels.

    ``model`` is a distortion model as ROS, Kalibr or OpenCV spell it; ``coefficients`` are in OpenCV's order: k1,
    k2, p1, p2, k3 to k6, s1 to s4, tx, ty, or k1 to k4 of a fisheye. `SourceError` is a clause for a sentence's end.
    """
    name = model.strip().lower().replace("-", "_").replace(" ", "_")
    d = np.array(coefficients, np.float64)
    k = np.array(camera_matrix, np.float64)
    if k.size != 9 or not np.isfinite(k).all() or not np.isfinite(d).all():
        raise SourceError(f"its lens has numbers that are missing or not finite ({foreign(model, 40)})")
    k = k.reshape(3, 3)
    if abs(k[0, 1]) > 1e-6 * abs(k[0, 0]):
        raise SourceError(f"its K has a skew of {k[0, 1]:g}, which no lens here has")
    pinhole = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2], "width": size[0], "height": size[1]}
    if name in _FISHEYE:
        if d.size > 4:
            raise SourceError(f"its lens model {name!r} has {d.size} coefficients; 4 are needed")
        d = np.pad(d, (0, 4 - d.size))
        maps = cv2.fisheye.initUndistortRectifyMap(k, d, np.eye(3), k, size, cv2.CV_32FC1)
        return Lens(_intrinsics(pinhole), np.stack(maps, axis=-1))
    if name in _NO_DISTORTION or not d.any():
        if d.any():
            raise SourceError(f"its lens has coefficients, but its model is {model!r}; name the model")
        return Lens(_intrinsics(pinhole))
    if name not in (*_PINHOLE, *_THIN_PRISM) or d.size not in _COUNTS:
        known = ", ".join(("none", "plumb_bob", "rational_polynomial", "thin_prism", "equidistant"))
        raise SourceError(
            f"its lens model {foreign(model, 40)!r} with {d.size} coefficients is unknown; known are {known}"
        )
    if not d[5:].any():
        brown = tuple(np.pad(d, (0, 5))[:5].tolist())
        return Lens(_intrinsics({**pinhole, "distortion": Distortion.BROWN_CONRADY, "coefficients": brown}))
    maps = cv2.initUndistortRectifyMap(k, d, None, k, size, cv2.CV_32FC1)
    return Lens(_intrinsics(pinhole), np.stack(maps, axis=-1))


def _intrinsics(values: dict[str, Any]) -> Intrinsics:
    try:
        return Intrinsics(**values)
    except ValidationError as error:
        first = error.errors()[0]
        raise SourceError(f"its lens cannot be used: {first['loc'][0]} is {float(first['input']):g}") from error


def camera_info_lens(message: Any, size: tuple[int, int] | None = None, *, is_rectified: bool = False) -> Lens | None:
    """Return the lens of a ``CameraInfo`` for images of a size, cropped and binned; None if it is not filled in yet.

    K and D describe raw images; those that image_pipeline has rectified have the lens P, and no distortion.
    """
    k, p = _field(message, "k"), np.array(_field(message, "p"), np.float64)
    if not k[0] or not k[4]:  # focal lengths
        return None
    by_p = is_rectified and p.size == 12 and p[0] > 0
    matrix: Float64Array = p.reshape(3, 4)[:, :3].copy() if by_p else np.array(k, np.float64).reshape(3, 3)
    roi, binning = message.roi, (max(1, message.binning_x), max(1, message.binning_y))
    width, height = roi.width or message.width, roi.height or message.height
    stated = width // binning[0], height // binning[1]
    if size is not None and stated != size:
        raise SourceError(
            f"its images have {size[0]} x {size[1]} pixels, but its camera_info describes {stated[0]} x {stated[1]}"
        )
    matrix[0, 2] -= roi.x_offset
    matrix[1, 2] -= roi.y_offset
    matrix[0] /= binning[0]
    matrix[1] /= binning[1]
    model, d = ("none", ()) if by_p else (message.distortion_model, _field(message, "d"))
    return make_lens(model, d, matrix.ravel().tolist(), stated)


def _field(message: Any, name: str) -> Any:
    """Return a field whose name ROS 1 writes with a capital letter."""
    return getattr(message, name) if hasattr(message, name) else getattr(message, name.upper())
