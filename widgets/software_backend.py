"""Draws a point cloud with the processor: one compiled pass with a depth buffer."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
from numba import types
from PyQt6.QtGui import QImage, QPainter, QPaintEvent
from PyQt6.QtWidgets import QWidget

from .cloud_data import DepthCloud
from .cloud_scene import CloudScene, paint_overlay
from .colormaps import over_background
from .view_camera import NEAR, ViewCamera

_NO_INDEX = np.zeros((0, 0), np.uint8)


def _read_only(dtype: types.Type, dimensions: int) -> types.Array:
    return types.Array(dtype, dimensions, "C", readonly=True)


@numba.njit(
    types.void(
        _read_only(types.uint16, 2),
        _read_only(types.float32, 3),
        _read_only(types.uint8, 2),
        _read_only(types.uint32, 1),
        _read_only(types.float32, 2),
        types.UniTuple(types.float32, 2),
        types.UniTuple(types.float32, 2),
        types.float32,
        types.int64,
        types.Array(types.uint32, 2, "C"),
        types.Array(types.float32, 2, "C"),
    ),
    nogil=True,
    cache=True,
    error_model="numpy",
)
def _splat(depth, rays, index, colors, matrix, metres, index_from_depth, near, size, image, nearest):  # type: ignore[no-untyped-def]
    """Draw every point as a square; the nearest one wins. ``colors`` is ARGB, 0 hides."""
    height, width = image.shape
    indexed = index.shape[0] > 0
    half = np.float32(size) * np.float32(0.5) + np.float32(0.5)
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            counts = depth[row, column]
            if counts in (0, 65535):
                continue
            z = np.float32(counts) * metres[0] + metres[1]
            if z <= 0:
                continue
            if indexed:
                color = colors[index[row, column]]
            else:
                share = min(max(z * index_from_depth[0] + index_from_depth[1], np.float32(0)), np.float32(1))
                color = colors[int(share * np.float32(255) + np.float32(0.5))]
            if color == 0:
                continue
            x, y = rays[row, column, 0], rays[row, column, 1]
            w = z * (matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]) + matrix[2, 3]
            if w < near:
                continue
            u = (z * (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) + matrix[0, 3]) / w
            v = (z * (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) + matrix[1, 3]) / w
            if not (0 <= u < width and 0 <= v < height):
                continue
            # A pixel belongs to the square when its centre does; this is OpenGL's rule.
            left, top = int(np.ceil(u - half)), int(np.ceil(v - half))
            for i in range(max(top, 0), min(top + size, height)):
                for j in range(max(left, 0), min(left + size, width)):
                    if w < nearest[i, j]:
                        nearest[i, j] = w
                        image[i, j] = color


class SoftwareRenderer:
    """Keeps the buffers of one view and fills them with a cloud seen by a camera."""

    def __init__(self) -> None:
        self._image = np.empty((0, 0), np.uint32)
        self._nearest = np.empty((0, 0), np.float32)

    def render(
        self,
        cloud: DepthCloud | None,
        camera: ViewCamera,
        size: tuple[int, int],
        point_size: int,
        background: tuple[int, int, int],
    ) -> npt.NDArray[np.uint32]:
        """Return the picture as 0xffRRGGBB, uint32 (height, width); it is overwritten by the next call.

        Parameters
        ----------
        size : tuple of int
            Width and height in physical pixels.
        point_size : int
            Edge length of a point in physical pixels.
        """
        width, height = size
        if self._image.shape != (height, width):
            self._image = np.empty((height, width), np.uint32)
            self._nearest = np.empty((height, width), np.float32)
        red, green, blue = background
        self._image.fill(0xFF000000 | red << 16 | green << 8 | blue)
        if cloud is None:
            return self._image
        self._nearest.fill(np.inf)
        table = over_background(cloud.lut, background).astype(np.uint32)
        colors = table[:, 3] << 24 | table[:, 0] << 16 | table[:, 1] << 8 | table[:, 2]
        colors[table[:, 3] == 0] = 0
        pose = camera.pixel_matrix(width, height) @ cloud.pose
        _splat(
            cloud.depth,
            cloud.rays,
            _NO_INDEX if cloud.index is None else cloud.index,
            colors,
            pose.astype(np.float32),
            (cloud.metres_per_count, cloud.depth_offset_m),
            cloud.index_from_depth,
            NEAR * camera.distance,
            point_size,
            self._image,
            self._nearest,
        )
        return self._image


class SoftwareCanvas(QWidget):
    """Shows a scene with `SoftwareRenderer`, redrawing only what changed."""

    def __init__(self, scene: CloudScene, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._scene = scene
        self._renderer = SoftwareRenderer()
        self._picture = QImage()
        self._drawn: tuple[object, ...] = ()

    def paintEvent(self, _event: QPaintEvent | None) -> None:
        """Draw the cloud, then title-free overlays: axes and message."""
        ratio = self.devicePixelRatioF()
        size = max(1, round(self.width() * ratio)), max(1, round(self.height() * ratio))
        background = self._scene.background(self)
        points = max(1, round(self._scene.point_size * ratio))
        wanted = (self._scene.cloud, self._scene.camera, size, points, background)
        if wanted != self._drawn:
            pixels = self._renderer.render(self._scene.cloud, self._scene.camera, size, points, background)
            self._picture = QImage(pixels.data, *size, size[0] * 4, QImage.Format.Format_RGB32)
            self._picture.setDevicePixelRatio(ratio)
            self._drawn = wanted
        painter = QPainter(self)
        painter.drawImage(0, 0, self._picture)
        paint_overlay(painter, self, self._scene)
        painter.end()
