"""Draw a point cloud on the CPU, with compiled loops, and the canvas of a view that shows it.

Every pixel of the picture is one 32-bit number while it is drawn: its distance in the upper 24 bits, the
row of the colour table in the lower 8. So *the nearest point wins* is a single minimum. A point is drawn
as one such pixel first; a moving minimum over the whole picture then widens the points to squares.

Distances are positive floating-point numbers, whose bits sort like the numbers. Counted from the bits of
the nearest distance and without the last three, they fit into 24 bits as long as the farthest distance is
less than 65,000 times the nearest, and still tell a millionth of a distance apart.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit, types
from PyQt6.QtCore import QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QImage, QPainter, QPaintEvent, QPalette, QPen, QPolygonF, QResizeEvent
from PyQt6.QtWidgets import QWidget

from ...core.model.arrays import Float32Array, Float64Array, Uint8Array
from ..basics.colormaps import over_background
from ..basics.overlays import Reading, WipeGrip, paint_readings, paint_wipe
from ..basics.theme import CASING, THEME, ThemeName, text_font
from .cloud_data import HIGHEST_COUNT, DepthCloud
from .view_camera import FAR, NEAR, Place, ViewCamera

#: A pixel that no point covers.
_EMPTY = np.uint32(0xFFFFFFFF)


def _read_only(dtype: types.Type, dimensions: int) -> types.Array:
    return types.Array(dtype, dimensions, "C", readonly=True)


# Compiled when imported, for these signatures only, so that no repaint ever waits for the compiler.
_SCATTER: Any = types.void(
    _read_only(types.uint16, 2),
    _read_only(types.float32, 3),
    _read_only(types.uint8, 2),
    _read_only(types.uint32, 1),
    _read_only(types.float32, 2),
    _read_only(types.float32, 1),
    _read_only(types.float32, 1),
    types.int64,
    types.int64,
    types.Array(types.uint32, 2, "C"),
)
_SQUARES: Any = types.void(
    _read_only(types.uint32, 2),
    types.int64,
    _read_only(types.uint32, 1),
    types.uint32,
    types.Array(types.uint32, 2, "C"),
)


@njit(_SCATTER, nogil=True, cache=True, error_model="numpy")
def scatter(
    depth: Any, rays: Any, index: Any, colors: Any, matrix: Any, depths: Any, limits: Any, step: Any, size: Any,
    pixels: Any
) -> None:  # fmt: skip
    """Clear ``pixels`` and put every point into them, at the lower right pixel of its square.

    Parameters
    ----------
    depth, index
        As in `DepthCloud`; an empty ``index`` means that depth chooses the colour.
    rays : float32, shape (2, rows, columns)
        x / z and y / z of every ``step``-th row and column; last axis contiguous, so that the compiler vectorises.
    colors : uint32, shape (256,)
        ARGB; 0 hides.
    matrix : float32, shape (3, 4)
        From the camera to ``(u w, v w, w)``.
    depths : float32, shape (4,)
        Metres per count, offset; slope and intercept of the colour scale.
    limits : float32, shape (2,)
        Smallest and largest distance drawn, metres.
    step : int
        Only every ``step``-th row and column is drawn. A pixel without depth takes that of its diagonal neighbour,
        which would cover its place if all were drawn.
    size : int
        Edge length of the squares.
    pixels : uint32, shape (height + 2 size, width + 2 size)
        A margin of ``size`` on every side saves asking for the edges.
    """
    metres_per_count, offset, slope, intercept = depths
    (m00, m01, m02, m03), (m10, m11, m12, m13), (m20, m21, m22, m23) = matrix[0], matrix[1], matrix[2]
    near, far = limits
    nearest = limits.view(np.int32)[0]
    stride = np.int32(pixels.shape[1])
    right, bottom = np.float32(pixels.shape[1] - 2 * size), np.float32(pixels.shape[0] - 2 * size)
    # A square covers the pixels whose centres lie inside it, as OpenGL's points do.
    last = np.float32(size) + np.float32(0.5) * np.float32(size) - np.float32(0.5)
    flat = pixels.reshape(-1)
    flat[:] = _EMPTY
    (height, width), (_, rows, columns) = depth.shape, rays.shape
    count, shade = np.empty(columns, np.uint16), np.empty(columns, np.uint8)
    place, distance = np.empty(columns, np.int32), np.empty(columns, np.float32)
    bits = distance.view(np.int32)
    indexed = index.shape[0] > 0
    zero, one = np.float32(0), np.float32(1)
    for row in range(rows):
        # First what is drawn of a row …
        i = row * step
        line, below = depth[i], depth[min(i + 1, height - 1)]
        for column in range(columns):
            count[column] = line[column * step]
        if indexed:
            for column in range(columns):
                shade[column] = index[i, column * step]
        if step > 1 and i + 1 < height:
            for column in range(min(columns, (width - 2) // step + 1)):
                if count[column] == 0 or count[column] > HIGHEST_COUNT:
                    count[column] = below[column * step + 1]
                    if indexed:
                        shade[column] = index[i + 1, column * step + 1]
        # … then the arithmetic without branches, which the compiler vectorises …
        across, down = rays[0, row], rays[1, row]
        for column in range(columns):
            counts = np.float32(count[column])
            z = counts * metres_per_count + offset
            x, y = across[column], down[column]
            w = z * (m20 * x + m21 * y + m22) + m23
            inverse = one / w
            u = (z * (m00 * x + m01 * y + m02) + m03) * inverse
            v = (z * (m10 * x + m11 * y + m12) + m13) * inverse
            has_depth = (counts > zero) & (counts < np.float32(65535)) & (z > zero)
            inside = (w >= near) & (w <= far) & (u >= zero) & (u < right) & (v >= zero) & (v < bottom)
            shown = has_depth & inside
            j = np.int32(u + last) if shown else np.int32(0)
            i = np.int32(v + last) if shown else np.int32(0)
            place[column] = i * stride + j if shown else np.int32(-1)
            distance[column] = w
            share = min(max(z * slope + intercept, zero), one)
            if not indexed:
                shade[column] = np.uint8(share * np.float32(255) + np.float32(0.5))
        # … and at last the writes, which depend on each other.
        for column in range(columns):
            where, color = place[column], shade[column]
            if where < 0 or colors[color] == 0:
                continue
            pixel = np.uint32(np.uint32((bits[column] - nearest) >> np.int32(3)) << np.uint32(8)) | np.uint32(color)
            flat[where] = min(flat[where], pixel)


@njit(_SQUARES, nogil=True, cache=True)
def squares(pixels: Any, size: Any, colors: Any, background: Any, image: Any) -> None:
    """Widen the points to squares and write their colours into ``image``.

    Parameters
    ----------
    pixels : uint32, shape (height + 2 size, width + 2 size)
        As `scatter` leaves them.
    colors : uint32, shape (256,)
    background : uint32
    image : uint32, shape (height, width)
        All three ARGB.
    """
    height, width = image.shape
    nearest = np.empty(pixels.shape[1], np.uint32)
    widened = np.empty(width, np.uint32)
    for i in range(height):
        # Assigning rows as a whole would take 3 s longer to compile. With one row, the first is the last.
        first, last, out, seen = pixels[i + size], pixels[i + 2 * size - 1], image[i], _EMPTY
        for j in range(nearest.shape[0]):
            nearest[j] = min(first[j], last[j])
            seen = min(seen, nearest[j])
        for below in range(1, size - 1):
            row = pixels[i + size + below]
            for j in range(nearest.shape[0]):
                nearest[j] = min(nearest[j], row[j])
                seen = min(seen, nearest[j])
        if seen == _EMPTY:
            for j in range(width):
                out[j] = background
            continue
        left, right = nearest[size:], nearest[2 * size - 1 :]  # indices without a sum, so that they are vectorised
        for j in range(width):
            widened[j] = min(left[j], right[j])
        for beside in range(1, size - 1):
            between = nearest[size + beside :]
            for j in range(width):
                widened[j] = min(widened[j], between[j])
        for j in range(width):
            pixel = widened[j]
            out[j] = background if pixel == _EMPTY else colors[pixel & np.uint32(255)]


_NO_INDEX = np.zeros((0, 0), np.uint8)
#: Largest distance between drawn points as a share of their size: they overlap.
_APART = 0.75
#: In views so far zoomed in that points grow by this factor they grow by it again, for surfaces seen at a slant.
_SLANTED = 1.5
#: Edge length in pixels up to which points grow to close gaps, as in a view zoomed to the patch.
_MAX_CLOSING = 16
#: Largest view in physical pixels that is drawn sharp; a larger one, as on 4K screens, at half its resolution.
_MAX_SHARP = 1_200_000


class Look(NamedTuple):
    """How a cloud is seen; sizes in pixels of the picture."""

    camera: ViewCamera
    size: tuple[int, int]  # Width and height
    point_size: int  # Edge length of a point, more where that closes the gaps between them
    background: tuple[int, int, int]
    running: bool  # Frames follow each other, so points that would hide each other are left out


class SoftwareRenderer:
    """Keeps the buffers and the last picture of one view."""

    def __init__(self) -> None:
        self._buffer = np.empty((0, 0), np.uint32)
        self._pixels = np.empty((0, 0), np.uint32)
        self._lut: Uint8Array | None = None
        self._background, self._colors = (0, 0, 0), np.empty(0, np.uint32)
        self._rays_of: Float32Array | None = None
        self._look: Look | None = None
        self._step, self._point_size, self._rays = 1, 1, np.empty((2, 0, 0), np.float32)
        self._drawn: tuple[DepthCloud | None, Look] | None = None
        self._picture = QImage()

    def picture(self, cloud: DepthCloud | None, look: Look) -> QImage:
        """Return the picture of a cloud, drawn again only if anything has changed."""
        if (cloud, look) != self._drawn:
            self._drawn = cloud, look
            data: Any = self.render(cloud, look).data
            self._picture = QImage(data, *look.size, look.size[0] * 4, QImage.Format.Format_RGB32)
        return self._picture

    def render(self, cloud: DepthCloud | None, look: Look) -> npt.NDArray[np.uint32]:
        """Return the picture as 0xffRRGGBB, uint32 (height, width); the next call overwrites it."""
        width, height = look.size
        if self._buffer.shape != (height, width):
            self._buffer = np.empty((height, width), np.uint32)
        red, green, blue = look.background
        argb = 0xFF000000 | red << 16 | green << 8 | blue
        if cloud is None:
            self._buffer.fill(argb)
            return self._buffer
        step = self._step
        if self._rays_of is not cloud.rays or self._look != look:
            self._look, (step, self._point_size) = look, _step_and_size(cloud, look)
        if self._rays_of is not cloud.rays or self._step != step:
            self._rays_of, self._step = cloud.rays, step
            self._rays = np.ascontiguousarray(np.moveaxis(cloud.rays[::step, ::step], 2, 0))
        if self._lut is not cloud.lut or self._background != look.background:
            self._lut, self._background = cloud.lut, look.background
            over = over_background(cloud.lut, look.background).astype(np.uint32).T
            self._colors = np.where(over[3] > 0, over[3] << 24 | over[0] << 16 | over[1] << 8 | over[2], np.uint32(0))
        camera, size, margin = look.camera, self._point_size, 2 * self._point_size
        if self._pixels.shape != (height + margin, width + margin):
            self._pixels = np.empty((height + margin, width + margin), np.uint32)
        scatter(
            cloud.depth,
            self._rays,
            _NO_INDEX if cloud.index is None else cloud.index,
            self._colors,
            (camera.pixel_matrix(width, height) @ cloud.pose).astype(np.float32),
            np.array([cloud.metres_per_count, cloud.depth_offset_m, *cloud.index_from_depth], np.float32),
            np.array([NEAR * camera.distance, FAR * camera.distance], np.float32),
            step,
            size,
            self._pixels,
        )
        squares(self._pixels, size, self._colors, argb, self._buffer)
        return self._buffer


def _step_and_size(cloud: DepthCloud, look: Look) -> tuple[int, int]:
    """Return the step between the rows and columns that are drawn, and the edge length of their points.

    Points grow until they overlap in the centre of the view, at the depth of the camera's target and at the far end of
    the colours. While frames follow each other, every other row and column is left out if the rest overlaps.
    """
    height, width = cloud.depth.shape
    if min(height, width) < 2:  # free points, in no order
        return 1, look.point_size
    v, u = height // 2 - 1, width // 2 - 1
    rays = np.array([(*cloud.rays[v + down, u + right], 1.0) for down, right in ((0, 0), (0, 1), (1, 0))])
    target_m = float(cloud.pose[:3, 2] @ (look.camera.target - cloud.pose[:3, 3]))
    needed = 1.0
    for depth_m in (target_m, cloud.depth_range_m[1]):
        places = depth_m * rays @ cloud.pose[:3, :3].T + cloud.pose[:3, 3]
        seen = look.camera.project(places, *look.size)
        if (seen[:, 2] > 0).all():
            needed = max(needed, float(np.linalg.norm(seen[1:, :2] - seen[0, :2], axis=1).max()) / _APART)
    if needed > _SLANTED * look.point_size:
        needed *= _SLANTED
    step = 2 if look.running and 2 * needed <= look.point_size + 1 else 1
    return step, max(look.point_size, min(math.ceil(step * needed), _MAX_CLOSING))


class CloudCanvas(QWidget):
    """Shows a cloud, or two at a wipe, with axes and a mark, as its view sets them; redraws only what changed."""

    resized = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.cloud: DepthCloud | None = None
        self.right: DepthCloud | None = None  # drawn right of the wipe, if there is one
        self.grip = WipeGrip(self)
        self.camera = ViewCamera()
        self.point_size = 2.0  # device-independent pixels
        self.running = False  # frames follow each other
        self.shows_axes = True
        self.mark: Place | None = None
        self.arrow: Float64Array | None = None  # (2, 3): from and to
        self.readings: tuple[Reading, ...] = ()
        self._renderers = SoftwareRenderer(), SoftwareRenderer()
        self.setAttribute(Qt.WidgetAttribute.WA_OpaquePaintEvent)  # what lies below need not be painted

    def resizeEvent(self, event: QResizeEvent | None) -> None:
        super().resizeEvent(event)
        self.resized.emit()

    def paintEvent(self, _event: QPaintEvent | None) -> None:
        ratio = self.devicePixelRatioF()
        if self.width() * self.height() * ratio**2 > _MAX_SHARP:
            ratio /= 2
        width, height = max(1, round(self.width() * ratio)), max(1, round(self.height() * ratio))
        red, green, blue, _ = self.palette().color(QPalette.ColorRole.Base).getRgb()
        point_size = max(1, round(self.point_size * ratio))
        look = Look(self.camera, (width, height), point_size, (red or 0, green or 0, blue or 0), self.running)
        wipe = self.grip.wipe
        # one cloud that both sides share is drawn whole
        column = width if wipe is None or self.right is self.cloud else wipe.column(width)
        painter = QPainter(self)
        sides = ((self.cloud, 0, column), (self.right, column, width))
        for renderer, (cloud, start, stop) in zip(self._renderers, sides, strict=True):
            if start < stop:
                part = QRectF(start, 0, stop - start, height)
                target = QRectF(start / ratio, 0, part.width() / ratio, height / ratio)
                painter.drawImage(target, renderer.picture(cloud, look), part)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self.shows_axes and self.height() > 4 * _AXIS_MARGIN:  # else they would cover the cloud
            axes = _axes_image(self.camera.azimuth, self.camera.elevation, THEME.name, self.devicePixelRatioF())
            painter.drawImage(QPointF(0.0, self.height() - 2 * _AXIS_MARGIN), axes)
        if self.arrow is not None:
            self._paint_arrow(painter, self.arrow)
        if self.mark is not None:
            self._paint_mark(painter, self.mark)
        if wipe is not None:
            paint_wipe(painter, QRectF(self.rect()), wipe)
        elif self.readings:
            paint_readings(painter, self.size(), self.readings)
        painter.end()

    def _paint_arrow(self, painter: QPainter, arrow: Float64Array) -> None:
        seen = self.camera.project(arrow, max(1, self.width()), max(1, self.height()))
        if (seen[:, 2] <= 0).any():
            return
        tail, tip = (QPointF(u, v) for u, v in seen[:, :2])
        back = tail - tip
        back *= _ARROW_HEAD / max(math.hypot(back.x(), back.y()), _ARROW_HEAD)
        across = QPointF(-back.y(), back.x()) * 0.5
        for role, width in ((QPalette.ColorRole.Base, 6.0), (QPalette.ColorRole.Text, 3.0)):
            painter.setPen(QPen(self.palette().color(role), width, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
            painter.drawLine(tail, tip)
            painter.drawPolyline(QPolygonF([tip + back + across, tip, tip + back - across]))

    def _paint_mark(self, painter: QPainter, mark: Place) -> None:
        u, v, away = self.camera.project([mark], max(1, self.width()), max(1, self.height()))[0]
        if away > 0:
            for color, width in ((CASING, 4.0), (QColor("white"), 2.0)):
                painter.setPen(QPen(color, width))
                painter.drawEllipse(QPointF(u, v), _MARK_RADIUS, _MARK_RADIUS)


_MARK_RADIUS, _ARROW_HEAD = 6.0, 12.0
_AXIS_COLORS = {
    "light": (QColor(200, 40, 40), QColor(25, 135, 60), QColor(40, 90, 210)),
    "dark": (QColor(255, 115, 110), QColor(100, 210, 130), QColor(125, 165, 255)),
}
_AXIS_LENGTH, _AXIS_MARGIN = 22.0, 34.0
#: Cosine to the viewing direction above which an axis gets no letter: it appears as a dot.
_FACING = 0.97


@lru_cache(maxsize=4)
def _axes_image(azimuth: float, elevation: float, theme: ThemeName, ratio: float) -> QImage:
    """Return x, y, z as the camera sees them on a transparent ground, the farthest first; drawn only when it turns."""
    side = round(2 * _AXIS_MARGIN * ratio)
    image = QImage(side, side, QImage.Format.Format_ARGB32_Premultiplied)
    image.setDevicePixelRatio(ratio)
    image.fill(Qt.GlobalColor.transparent)
    painter = QPainter(image)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.setFont(text_font("caption", bold=True))
    origin = QPointF(_AXIS_MARGIN, _AXIS_MARGIN)
    right, up, back = ViewCamera(azimuth=azimuth, elevation=elevation).axes()
    for axis in sorted(range(3), key=lambda axis: float(back[axis])):
        direction = QPointF(float(right[axis]), -float(up[axis]))
        painter.setPen(QPen(_AXIS_COLORS[theme][axis], 2.0, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
        painter.drawLine(origin, origin + direction * _AXIS_LENGTH)
        if abs(float(back[axis])) <= _FACING:
            label = QRectF(-8.0, -8.0, 16.0, 16.0).translated(origin + direction * (_AXIS_LENGTH + 7.0))
            painter.drawText(label, Qt.AlignmentFlag.AlignCenter, "xyz"[axis])
    painter.end()
    return image
