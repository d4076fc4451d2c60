"""Draws a point cloud with OpenGL 2.1: the depth image goes up as it is, the vertex shader deprojects it.

Only Qt's own OpenGL functions are used, so the library that Qt loaded is the one that draws.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
from PyQt6.QtCore import pyqtSignal
from PyQt6.QtGui import QImage, QMatrix4x4, QOffscreenSurface, QOpenGLContext, QPainter, QPaintEvent, QVector2D
from PyQt6.QtOpenGL import (
    QOpenGLBuffer,
    QOpenGLFunctions_2_1,
    QOpenGLShader,
    QOpenGLShaderProgram,
    QOpenGLTexture,
    QOpenGLVersionFunctionsFactory,
    QOpenGLVersionProfile,
)
from PyQt6.QtOpenGLWidgets import QOpenGLWidget
from PyQt6.QtWidgets import QWidget
from PyQt6.sip import voidptr

from .cloud_data import DepthCloud
from .cloud_scene import CloudScene, paint_overlay
from .colormaps import over_background
from .view_camera import ViewCamera

_GL_POINTS = 0x0000
_GL_COLOR_AND_DEPTH = 0x4000 | 0x0100
_GL_DEPTH_TEST = 0x0B71
_GL_BLEND = 0x0BE2
_GL_LESS = 0x0201
_GL_UNSIGNED_BYTE, _GL_UNSIGNED_SHORT, _GL_FLOAT = 0x1401, 0x1403, 0x1406
_GL_RENDERER = 0x1F01
_GL_MAX_VERTEX_TEXTURE_IMAGE_UNITS = 0x8B4C
_GL_ERRORS = {0x0505: "out of graphics memory", 0x0507: "the graphics driver was reset"}

#: What emulated OpenGL calls itself.
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


class GLError(Exception):
    """OpenGL cannot draw, and why, in words for the person who looks at the view."""


@dataclass(frozen=True)
class GLProbe:
    """What OpenGL offers here. ``reason`` says why it is better not used, and is empty if it is fine."""

    usable: bool
    emulated: bool
    renderer: str
    reason: str


@cache
def probe_opengl() -> GLProbe:
    """Make a context off screen and look at who draws. Needs a QGuiApplication; asked once per process."""
    context, surface = QOpenGLContext(), QOffscreenSurface()
    surface.create()
    if not context.create() or not context.makeCurrent(surface):
        return GLProbe(False, False, "", "no OpenGL on this display")
    try:
        functions = _functions(context)
        renderer = str(functions.glGetString(_GL_RENDERER))
    except GLError as error:
        return GLProbe(False, False, "", str(error))
    finally:
        context.doneCurrent()
    if any(name in renderer.lower() for name in _EMULATORS):
        return GLProbe(True, True, renderer, f"OpenGL is only emulated here ({renderer.partition(' (')[0]})")
    return GLProbe(True, False, renderer, "")


def _functions(context: QOpenGLContext) -> QOpenGLFunctions_2_1:
    profile = QOpenGLVersionProfile()
    profile.setVersion(2, 1)
    functions: Any = QOpenGLVersionFunctionsFactory.get(profile, context)
    if functions is None or not functions.initializeOpenGLFunctions():
        raise GLError("this display has no OpenGL 2.1")
    if not functions.glGetIntegerv(_GL_MAX_VERTEX_TEXTURE_IMAGE_UNITS):
        raise GLError("this OpenGL has no textures in vertex shaders")
    return functions  # type: ignore[no-any-return]


class _VertexImage:
    """One image as a vertex attribute; uploaded when another array arrives."""

    def __init__(self, usage: QOpenGLBuffer.UsagePattern) -> None:
        self._buffer = QOpenGLBuffer(QOpenGLBuffer.Type.VertexBuffer)
        if not self._buffer.create():
            raise GLError("no OpenGL buffer can be made")
        self._buffer.setUsagePattern(usage)
        self._array: npt.NDArray[Any] | None = None

    def attach(
        self, program: QOpenGLShaderProgram, name: str, array: npt.NDArray[Any], kind: int, components: int
    ) -> None:
        self._buffer.bind()
        if array is not self._array:
            self._buffer.allocate(voidptr(array.data), array.nbytes)
            self._array = array
        location = program.attributeLocation(name)
        program.enableAttributeArray(location)
        program.setAttributeBuffer(location, kind, 0, components)
        self._buffer.release()

    def destroy(self) -> None:
        self._buffer.destroy()


class GLRenderer:
    """Shader, buffers and colour table of one view in one OpenGL context, which must be current."""

    def __init__(self, context: QOpenGLContext) -> None:
        self._gl = _functions(context)
        self._program = _linked_program()
        self._depth = _VertexImage(QOpenGLBuffer.UsagePattern.StreamDraw)
        self._index = _VertexImage(QOpenGLBuffer.UsagePattern.StreamDraw)
        self._rays = _VertexImage(QOpenGLBuffer.UsagePattern.StaticDraw)
        self._texture: QOpenGLTexture | None = None
        self._colors: tuple[object, tuple[int, int, int]] | None = None

    def render(
        self,
        cloud: DepthCloud | None,
        camera: ViewCamera,
        size: tuple[int, int],
        point_size: int,
        background: tuple[int, int, int],
    ) -> None:
        """Clear and draw into the current framebuffer; parameters as in `SoftwareRenderer.render`.

        Raises
        ------
        GLError
            The context was lost or has no memory left.
        """
        gl = self._gl
        gl.glViewport(0, 0, *size)
        red, green, blue = background
        gl.glClearColor(red / 255, green / 255, blue / 255, 1.0)
        gl.glDepthMask(True)
        gl.glClear(_GL_COLOR_AND_DEPTH)
        if cloud is not None:
            gl.glEnable(_GL_DEPTH_TEST)
            gl.glDepthFunc(_GL_LESS)
            gl.glDisable(_GL_BLEND)
            gl.glPointSize(float(point_size))
            self._draw(cloud, camera.clip_matrix(*size) @ cloud.pose, background)
            gl.glDisable(_GL_DEPTH_TEST)
        error = gl.glGetError()
        if error:
            raise GLError(_GL_ERRORS.get(error, f"OpenGL reported error 0x{error:04x}"))

    def _draw(self, cloud: DepthCloud, clip: npt.NDArray[np.float64], background: tuple[int, int, int]) -> None:
        program = self._program
        program.bind()
        self._bind_colors(cloud, background)
        self._depth.attach(program, "counts", cloud.depth, _GL_UNSIGNED_SHORT, 1)
        self._rays.attach(program, "ray", cloud.rays, _GL_FLOAT, 2)
        if cloud.index is not None:
            self._index.attach(program, "index", cloud.index, _GL_UNSIGNED_BYTE, 1)
        program.setUniformValue("clip_from_camera", QMatrix4x4(clip.ravel().tolist()))
        program.setUniformValue("metres", QVector2D(cloud.metres_per_count, cloud.depth_offset_m))
        program.setUniformValue("index_from_depth", QVector2D(*cloud.index_from_depth))
        program.setUniformValue("indexed", int(cloud.index is not None))
        program.setUniformValue("lut", 0)
        self._gl.glDrawArrays(_GL_POINTS, 0, cloud.depth.size)
        for name in ("counts", "ray", "index"):
            program.disableAttributeArray(program.attributeLocation(name))
        if self._texture is not None:
            self._texture.release(0)
        program.release()

    def _bind_colors(self, cloud: DepthCloud, background: tuple[int, int, int]) -> None:
        if (
            self._texture is None
            or self._colors is None
            or self._colors[0] is not cloud.lut
            or self._colors[1] != background
        ):
            if self._texture is not None:
                self._texture.destroy()
            table = over_background(cloud.lut, background)
            image = QImage(table.tobytes(), 256, 1, 1024, QImage.Format.Format_RGBA8888)
            self._texture = QOpenGLTexture(image, QOpenGLTexture.MipMapGeneration.DontGenerateMipMaps)
            self._texture.setMinMagFilters(QOpenGLTexture.Filter.Nearest, QOpenGLTexture.Filter.Nearest)
            self._texture.setWrapMode(QOpenGLTexture.WrapMode.ClampToEdge)
            self._colors = cloud.lut, background
        self._texture.bind(0)

    def destroy(self) -> None:
        """Free what lies in graphics memory."""
        for image in (self._depth, self._index, self._rays):
            image.destroy()
        if self._texture is not None:
            self._texture.destroy()
        self._program.removeAllShaders()


def _linked_program() -> QOpenGLShaderProgram:
    program = QOpenGLShaderProgram()
    vertex = program.addShaderFromSourceCode(QOpenGLShader.ShaderTypeBit.Vertex, _VERTEX_SHADER)
    fragment = program.addShaderFromSourceCode(QOpenGLShader.ShaderTypeBit.Fragment, _FRAGMENT_SHADER)
    # Attribute 0 must be in use, or old drivers draw nothing.
    program.bindAttributeLocation("counts", 0)
    if not (vertex and fragment and program.link()):
        raise GLError(f"the graphics driver refuses the shader: {program.log().strip()}")
    return program


class GLCanvas(QOpenGLWidget):
    """Shows a scene with `GLRenderer`; says so when it cannot."""

    #: OpenGL failed; carries the reason in words.
    failed = pyqtSignal(str)

    def __init__(self, scene: CloudScene, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._scene = scene
        self._renderer: GLRenderer | None = None

    def initializeGL(self) -> None:
        """Build everything anew: Qt makes another context when the view moves to another window."""
        context = self.context()
        if context is None:
            self.failed.emit("no OpenGL context")
            return
        try:
            self._renderer = GLRenderer(context)
        except GLError as error:
            self.failed.emit(str(error))
            return
        context.aboutToBeDestroyed.connect(self._release)

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
        try:
            self._renderer.render(self._scene.cloud, self._scene.camera, size, points, self._scene.background(self))
        except GLError as error:
            self.failed.emit(str(error))
            return
        painter = QPainter(self)
        paint_overlay(painter, self, self._scene)
        painter.end()

    def _release(self) -> None:
        if self._renderer is not None:
            self.makeCurrent()
            self._renderer.destroy()
            self.doneCurrent()
            self._renderer = None
