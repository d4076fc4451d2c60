"""Draws a point cloud with the processor."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from PyQt6.QtGui import QImage, QPainter, QPaintEvent
from PyQt6.QtWidgets import QWidget

from ...core.model.arrays import Uint8Array
from ..basics.colormaps import over_background
from .cloud_data import DepthCloud
from .cloud_scene import CloudScene, paint_overlay
from .software_kernel import scatter, squares
from .view_camera import FAR, NEAR, ViewCamera

_NO_INDEX = np.zeros((0, 0), np.uint8)


class SoftwareRenderer:
    """Keeps the buffers of one view and fills them with a cloud seen by a camera."""

    def __init__(self) -> None:
        self._image = np.empty((0, 0), np.uint32)
        self._pixels = np.empty((0, 0), np.uint32)

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
        margin = 2 * point_size
        if self._pixels.shape != (height + margin, width + margin):
            self._pixels = np.empty((height + margin, width + margin), np.uint32)
        red, green, blue = background
        argb = 0xFF000000 | red << 16 | green << 8 | blue
        if cloud is None:
            self._image.fill(argb)
            return self._image
        colors = _packed(over_background(cloud.lut, background))
        scatter(
            cloud.depth,
            cloud.rays,
            _NO_INDEX if cloud.index is None else cloud.index,
            colors,
            (camera.pixel_matrix(width, height) @ cloud.pose).astype(np.float32),
            np.array([cloud.metres_per_count, cloud.depth_offset_m, *cloud.index_from_depth], np.float32),
            np.array([NEAR * camera.distance, FAR * camera.distance], np.float32),
            point_size,
            self._pixels,
        )
        squares(self._pixels, point_size, colors, argb, self._image)
        return self._image


def _packed(table: Uint8Array) -> npt.NDArray[np.uint32]:
    """Return an RGBA table as ARGB numbers, 0 where alpha is 0."""
    red, green, blue, alpha = table.astype(np.uint32).T
    return np.where(alpha > 0, alpha << 24 | red << 16 | green << 8 | blue, np.uint32(0))


class SoftwareCanvas(QWidget):
    """Shows a scene with `SoftwareRenderer`, redrawing only what changed."""

    def __init__(self, scene: CloudScene, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._scene = scene
        self._renderer = SoftwareRenderer()
        self._picture = QImage()
        self._drawn: tuple[object, ...] = ()

    def paintEvent(self, _event: QPaintEvent | None) -> None:
        """Draw the cloud and the overlays."""
        ratio = self.devicePixelRatioF()
        size = max(1, round(self.width() * ratio)), max(1, round(self.height() * ratio))
        background = self._scene.background(self)
        points = max(1, round(self._scene.point_size * ratio))
        wanted = (self._scene.cloud, self._scene.camera, size, points, background)
        if wanted != self._drawn:
            pixels = self._renderer.render(self._scene.cloud, self._scene.camera, size, points, background)
            buffer: Any = pixels.data
            self._picture = QImage(buffer, *size, size[0] * 4, QImage.Format.Format_RGB32)
            self._picture.setDevicePixelRatio(ratio)
            self._drawn = wanted
        painter = QPainter(self)
        painter.drawImage(0, 0, self._picture)
        paint_overlay(painter, self, self._scene)
        painter.end()
