"""Draws a point cloud with OpenGL 2.1: uploads the raw depth image and deprojects it in the vertex shader."""

from __future__ import annotations

from ctypes import POINTER, c_float
from dataclasses import dataclass
from functools import cache

import numpy as np
from PyQt6.QtCore import pyqtSignal
from PyQt6.QtGui import QOffscreenSurface, QOpenGLContext, QPainter, QPaintEvent
from PyQt6.QtOpenGL import QOpenGLPaintDevice
from PyQt6.QtOpenGLWidgets import QOpenGLWidget
from PyQt6.QtWidgets import QWidget

from ...core.model.arrays import AnyArray, Float64Array
from ..basics.colormaps import over_background
from . import gl_functions as gl
from .cloud_data import DepthCloud
from .cloud_scene import CloudScene, paint_overlay
from .gl_functions import GLError, GLFunctions
from .view_camera import ViewCamera

_ERRORS = {gl.OUT_OF_MEMORY: "out of graphics memory", gl.CONTEXT_LOST: "the graphics driver was reset"}

#: Renderer names of emulated OpenGL.
_EMULATORS = ("llvmpipe", "softpipe", "swrast", "software rasterizer", "swiftshader", "gdi generic", "basic render")

_VERTEX_SHADER = """#version 120
attribute float counts;
attribute vec2 ray;
attribute float index;
uniform mat4 clip_from_camera;
uniform vec2 metres;
uniform vec2 index_from_depth;
uniform bool indexed;
uniform sampler2D lut;
varying vec4 color;

void main() {
    // The driver hands integers over as fractions of their largest value.
    float raw = floor(counts * 65535.0 + 0.5);
    float z = raw * metres.x + metres.y;
    float row = indexed ? index : clamp(z * index_from_depth.x + index_from_depth.y, 0.0, 1.0);
    row = floor(row * 255.0 + 0.5);
    color = texture2DLod(lut, vec2((row + 0.5) / 256.0, 0.5), 0.0);
    bool hidden = raw < 0.5 || raw > 65534.5 || z <= 0.0 || color.a < 0.5;
    gl_Position = hidden ? vec4(2.0, 2.0, 2.0, 1.0) : clip_from_camera * vec4(ray * z, z, 1.0);
}
"""
_FRAGMENT_SHADER = """#version 120
varying vec4 color;

void main() {
    gl_FragColor = color;
}
"""


@dataclass(frozen=True)
class GLProbe:
    """OpenGL on this display. ``reason`` says why it should not be used; empty if it is fine."""

    usable: bool
    emulated: bool
    renderer: str
    reason: str


@cache
def probe_opengl() -> GLProbe:
    """Create an offscreen context and read its renderer, once per process. Needs a QGuiApplication."""
    context, surface = QOpenGLContext(), QOffscreenSurface()
    surface.create()
    if not context.create() or not context.makeCurrent(surface):
        return GLProbe(False, False, "", "no OpenGL on this display")
    try:
        renderer = str(GLFunctions(context).glGetString(gl.RENDERER).decode(errors="replace"))
    except GLError as error:
        return GLProbe(False, False, "", str(error))
    finally:
        context.doneCurrent()
    if any(name in renderer.lower() for name in _EMULATORS):
        return GLProbe(True, True, renderer, f"OpenGL is emulated ({renderer.partition(' (')[0]})")
    return GLProbe(True, False, renderer, "")


@dataclass
class _VertexImage:
    """One image as a vertex attribute; uploaded when another array arrives."""

    location: int
    kind: int
    components: int
    usage: int
    buffer: int = 0
    array: AnyArray | None = None

    def attach(self, functions: GLFunctions, array: AnyArray) -> None:
        if not self.buffer:
            self.buffer = functions.new_name("glGenBuffers")
        functions.glBindBuffer(gl.ARRAY_BUFFER, self.buffer)
        if array is not self.array:
            functions.glBufferData(gl.ARRAY_BUFFER, array.nbytes, array.ctypes.data, self.usage)
            self.array = array
        functions.glEnableVertexAttribArray(self.location)
        functions.glVertexAttribPointer(self.location, self.components, self.kind, True, 0, None)
        functions.glBindBuffer(gl.ARRAY_BUFFER, 0)

    def detach(self, functions: GLFunctions) -> None:
        functions.glDisableVertexAttribArray(self.location)


class GLRenderer:
    """Shader, buffers and colour table of one view in one OpenGL context, which must be current."""

    def __init__(self, context: QOpenGLContext) -> None:
        self._gl = GLFunctions(context)
        # Attribute 0 must be in use, or old drivers draw nothing; the depth always is.
        self._program = self._gl.new_program(_VERTEX_SHADER, _FRAGMENT_SHADER, ("counts", "ray", "index"))
        self._depth = _VertexImage(0, gl.UNSIGNED_SHORT, 1, gl.STREAM_DRAW)
        self._rays = _VertexImage(1, gl.FLOAT, 2, gl.STATIC_DRAW)
        self._index = _VertexImage(2, gl.UNSIGNED_BYTE, 1, gl.STREAM_DRAW)
        self._texture = self._gl.new_name("glGenTextures")
        self._colors: tuple[object, tuple[int, int, int]] | None = None

    def render(
        self,
        cloud: DepthCloud | None,
        camera: ViewCamera,
        size: tuple[int, int],
        point_size: int,
        background: tuple[int, int, int],
        columns: tuple[int, int] | None = None,
    ) -> None:
        """Clear and draw into the current framebuffer; parameters as in `SoftwareRenderer.render`.

        Nothing is drawn outside ``columns``, the first column and the first one after it.

        Raises
        ------
        GLError
            The context was lost or has no memory left.
        """
        functions = self._gl
        functions.glViewport(0, 0, *size)
        if columns is not None:
            functions.glEnable(gl.SCISSOR_TEST)
            functions.glScissor(columns[0], 0, columns[1] - columns[0], size[1])
        functions.glClearColor(*(channel / 255 for channel in background), 1.0)
        functions.glDepthMask(True)
        functions.glClear(gl.COLOR_AND_DEPTH)
        if cloud is not None:
            functions.glEnable(gl.DEPTH_TEST)
            functions.glDepthFunc(gl.LESS)
            functions.glDisable(gl.BLEND)
            functions.glPointSize(float(point_size))
            self._draw(cloud, camera.clip_matrix(*size) @ cloud.pose, background)
            functions.glDisable(gl.DEPTH_TEST)
        functions.glDisable(gl.SCISSOR_TEST)
        error = functions.glGetError()
        if error:
            raise GLError(_ERRORS.get(error, f"OpenGL reported error 0x{error:04x}"))

    def _draw(self, cloud: DepthCloud, clip: Float64Array, background: tuple[int, int, int]) -> None:
        functions = self._gl
        functions.glUseProgram(self._program)
        functions.glActiveTexture(gl.TEXTURE0)
        self._bind_colors(cloud, background)
        matrix = np.ascontiguousarray(clip.T, np.float32)
        functions.glUniformMatrix4fv(
            self._uniform("clip_from_camera"), 1, False, matrix.ctypes.data_as(POINTER(c_float))
        )
        functions.glUniform2f(self._uniform("metres"), cloud.metres_per_count, cloud.depth_offset_m)
        functions.glUniform2f(self._uniform("index_from_depth"), *cloud.index_from_depth)
        functions.glUniform1i(self._uniform("indexed"), cloud.index is not None)
        functions.glUniform1i(self._uniform("lut"), 0)
        images: list[tuple[_VertexImage, AnyArray]] = [(self._depth, cloud.depth), (self._rays, cloud.rays)]
        if cloud.index is not None:
            images.append((self._index, cloud.index))
        for image, array in images:
            image.attach(functions, array)
        functions.glDrawArrays(gl.POINTS, 0, cloud.depth.size)
        for image, _ in images:
            image.detach(functions)
        functions.glBindTexture(gl.TEXTURE_2D, 0)
        functions.glUseProgram(0)

    def _uniform(self, name: str) -> int:
        return int(self._gl.glGetUniformLocation(self._program, name.encode()))

    def _bind_colors(self, cloud: DepthCloud, background: tuple[int, int, int]) -> None:
        functions = self._gl
        functions.glBindTexture(gl.TEXTURE_2D, self._texture)
        if self._colors is None or self._colors[0] is not cloud.lut or self._colors[1] != background:
            for name in (gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER):
                functions.glTexParameteri(gl.TEXTURE_2D, name, gl.NEAREST)
            table = over_background(cloud.lut, background)
            functions.glTexImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, table.ctypes.data)
            self._colors = cloud.lut, background

    def destroy(self) -> None:
        """Free graphics memory."""
        for image in (self._depth, self._rays, self._index):
            if image.buffer:
                self._gl.delete_name("glDeleteBuffers", image.buffer)
        self._gl.delete_name("glDeleteTextures", self._texture)
        self._gl.glDeleteProgram(self._program)


class GLCanvas(QOpenGLWidget):
    """Shows a scene with `GLRenderer`; emits a signal on failure."""

    #: OpenGL failed; carries the reason in words.
    failed = pyqtSignal(str)

    def __init__(self, scene: CloudScene, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._scene = scene
        self._renderer: GLRenderer | None = None

    def initializeGL(self) -> None:
        """Build all resources: Qt makes a new context when the view moves to another window."""
        context = self.context()
        if context is None:
            self.failed.emit("no OpenGL context")
            return
        try:
            self._renderer = GLRenderer(context)
        except GLError as error:
            self.failed.emit(str(error))
            return
        context.aboutToBeDestroyed.connect(self.release)

    def paintEvent(self, event: QPaintEvent | None) -> None:
        """Draw, or report that no context could be made."""
        super().paintEvent(event)
        if not self.isValid():
            self.failed.emit("no OpenGL context could be made for this window")

    def paintGL(self) -> None:
        """Draw the cloud and the overlays."""
        if self._renderer is None:
            return
        ratio = self.devicePixelRatioF()
        size = max(1, round(self.width() * ratio)), max(1, round(self.height() * ratio))
        points = max(1, round(self._scene.point_size * ratio))
        background = self._scene.background(self)
        try:
            for cloud, start, stop in self._scene.parts(size[0]):
                if start < stop:
                    self._renderer.render(cloud, self._scene.camera, size, points, background, (start, stop))
        except GLError as error:
            self.failed.emit(str(error))
            return
        # Not on the widget itself: while it is grabbed, painters on it end up elsewhere.
        device = QOpenGLPaintDevice(*size)
        device.setDevicePixelRatio(ratio)
        painter = QPainter(device)
        paint_overlay(painter, self, self._scene)
        painter.end()

    def release(self) -> None:
        """Free graphics memory; nothing is drawn until Qt makes another context."""
        if self._renderer is not None:
            self.makeCurrent()
            self._renderer.destroy()
            self.doneCurrent()
            self._renderer = None
