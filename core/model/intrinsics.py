"""Pinhole cameras with the lens models of librealsense, in float64."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from .arrays import Float32Array, Float64Array

_PixelCount = Annotated[int, Field(ge=1, le=16384)]
_FocalLength = Annotated[float, Field(ge=0.1, le=1e6)]
_Centre = Annotated[float, Field(ge=-1e6, le=1e6)]
_Coefficient = Annotated[float, Field(ge=-1e3, le=1e3)]

#: Number of fixed-point steps in which librealsense removes distortion.
_UNDISTORT_STEPS = 10
#: A ray that leads back to a place farther from its pixel than this is beyond the fold of the lens model.
_FOLDED_PX = 1.0


class Distortion(StrEnum):
    """Lens distortion models, with the names of librealsense."""

    NONE = "none"
    BROWN_CONRADY = "brown_conrady"
    MODIFIED_BROWN_CONRADY = "modified_brown_conrady"
    INVERSE_BROWN_CONRADY = "inverse_brown_conrady"


class Frozen(BaseModel):
    """A model without other fields, whose values never change and are finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Intrinsics(Frozen):
    """Image size, focal lengths and principal point in pixels, and librealsense's k1, k2, p1, p2, k3."""

    width: _PixelCount
    height: _PixelCount
    fx: _FocalLength
    fy: _FocalLength
    cx: _Centre
    cy: _Centre
    distortion: Distortion = Distortion.NONE
    coefficients: tuple[_Coefficient, _Coefficient, _Coefficient, _Coefficient, _Coefficient] = (0.0,) * 5

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels, the shape of an image array."""
        return self.height, self.width

    @property
    def has_distortion(self) -> bool:
        """Whether the lens model changes any pixel."""
        return self.distortion is not Distortion.NONE and any(self.coefficients)

    def camera_matrix(self) -> Float64Array:
        """Return the 3 x 3 matrix K, in pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: npt.ArrayLike) -> Float64Array:
        """Project points (N, 3), metres in the camera's frame with z > 0, to pixels ``(u, v)`` (N, 2)."""
        points = np.asarray(points, dtype=np.float64)
        x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
        if self.has_distortion:
            x, y = self._distort(x, y)
        return np.stack([x * self.fx + self.cx, y * self.fy + self.cy], axis=1)

    def normalise(self, pixels: npt.ArrayLike) -> Float64Array:
        """Return ``(x / z, y / z)`` (N, 2) of pixels ``(u, v)`` (N, 2), with lens distortion removed.

        Follows librealsense's ``rs2_deproject_pixel_to_point`` step by step, including its ten fixed-point steps, so
        that both agree to single precision. Like librealsense, it does not remove the distortion of the modified
        Brown-Conrady model; the point clouds of the driver ignore it, too.
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        x, y = (pixels[:, 0] - self.cx) / self.fx, (pixels[:, 1] - self.cy) / self.fy
        if self.has_distortion and self.distortion is not Distortion.MODIFIED_BROWN_CONRADY:
            x, y = self._undistort(x, y)
        return np.stack([x, y], axis=1)

    def rays(self) -> Float32Array:
        """Return ``(x / z, y / z)`` of every pixel: float32, (H, W, 2); nan beyond the fold of the lens model."""
        v, u = np.mgrid[: self.height, : self.width]
        pixels = np.stack([u.ravel(), v.ravel()], axis=1)
        with np.errstate(all="ignore"):
            table = self.normalise(pixels)
            if self.has_distortion and self.distortion is not Distortion.MODIFIED_BROWN_CONRADY:
                again = self.project(np.column_stack([table, np.ones(len(table))]))
                table[~(np.abs(again - pixels).max(axis=1) <= _FOLDED_PX)] = np.nan
        return table.reshape(self.height, self.width, 2).astype(np.float32)

    def _radial(self, r2: Any) -> Any:
        k1, k2, _, _, k3 = self.coefficients
        return 1.0 + ((k3 * r2 + k2) * r2 + k1) * r2

    def _tangential(self, x: Any, y: Any, r2: Any) -> tuple[Any, Any]:
        _, _, p1, p2, _ = self.coefficients
        return 2 * p1 * x * y + p2 * (r2 + 2 * x * x), 2 * p2 * x * y + p1 * (r2 + 2 * y * y)

    def _distort(self, x: Float64Array, y: Float64Array) -> tuple[Float64Array, Float64Array]:
        r2 = x * x + y * y
        radial = self._radial(r2)
        if self.distortion is not Distortion.BROWN_CONRADY:  # the tangential part follows the radial one
            x, y, radial = x * radial, y * radial, 1.0
        dx, dy = self._tangential(x, y, r2)
        return x * radial + dx, y * radial + dy

    @np.errstate(all="ignore")  # it diverges where a lens folds
    def _undistort(self, x0: Float64Array, y0: Float64Array) -> tuple[Float64Array, Float64Array]:
        x, y = x0, y0
        for _ in range(_UNDISTORT_STEPS):
            r2 = x * x + y * y
            radial = self._radial(r2)
            scale = radial if self.distortion is Distortion.INVERSE_BROWN_CONRADY else 1.0
            dx, dy = self._tangential(x * scale, y * scale, r2)
            x, y = (x0 - dx) / radial, (y0 - dy) / radial
        return x, y
