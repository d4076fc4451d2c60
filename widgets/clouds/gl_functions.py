"""The few OpenGL functions that the cloud view calls, asked from Qt's own context.

They come from the very library that Qt loaded, whatever the platform, and names in OpenGL stay plain
numbers: wrapped buffers and textures crash when Python collects them after their context.
"""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_char_p, c_float, c_int, c_ssize_t, c_ubyte, c_uint, c_void_p
from typing import Any

from PyQt6.QtGui import QOpenGLContext

POINTS, LESS = 0x0000, 0x0201
DEPTH_TEST, BLEND, SCISSOR_TEST = 0x0B71, 0x0BE2, 0x0C11
TEXTURE_2D, RGBA, RGBA8, NEAREST = 0x0DE1, 0x1908, 0x8058, 0x2600
TEXTURE_MAG_FILTER, TEXTURE_MIN_FILTER, TEXTURE0 = 0x2800, 0x2801, 0x84C0
UNSIGNED_BYTE, UNSIGNED_SHORT, FLOAT = 0x1401, 0x1403, 0x1406
RENDERER, VERSION = 0x1F01, 0x1F02
COLOR_AND_DEPTH = 0x4000 | 0x0100
MAX_VERTEX_TEXTURE_IMAGE_UNITS = 0x8B4C
ARRAY_BUFFER, STREAM_DRAW, STATIC_DRAW = 0x8892, 0x88E0, 0x88E4
FRAGMENT_SHADER, VERTEX_SHADER, COMPILE_STATUS, LINK_STATUS = 0x8B30, 0x8B31, 0x8B81, 0x8B82
OUT_OF_MEMORY, CONTEXT_LOST = 0x0505, 0x0507

_uints, _ints = POINTER(c_uint), POINTER(c_int)
_SIGNATURES: dict[str, tuple[Any, ...]] = {
    "glActiveTexture": (None, c_uint),
    "glAttachShader": (None, c_uint, c_uint),
    "glBindAttribLocation": (None, c_uint, c_uint, c_char_p),
    "glBindBuffer": (None, c_uint, c_uint),
    "glBindTexture": (None, c_uint, c_uint),
    "glBufferData": (None, c_uint, c_ssize_t, c_void_p, c_uint),
    "glClear": (None, c_uint),
    "glClearColor": (None, c_float, c_float, c_float, c_float),
    "glCompileShader": (None, c_uint),
    "glCreateProgram": (c_uint,),
    "glCreateShader": (c_uint, c_uint),
    "glDeleteBuffers": (None, c_int, _uints),
    "glDeleteProgram": (None, c_uint),
    "glDeleteShader": (None, c_uint),
    "glDeleteTextures": (None, c_int, _uints),
    "glDepthFunc": (None, c_uint),
    "glDepthMask": (None, c_ubyte),
    "glDisable": (None, c_uint),
    "glDisableVertexAttribArray": (None, c_uint),
    "glDrawArrays": (None, c_uint, c_int, c_int),
    "glEnable": (None, c_uint),
    "glEnableVertexAttribArray": (None, c_uint),
    "glGenBuffers": (None, c_int, _uints),
    "glGenTextures": (None, c_int, _uints),
    "glGetError": (c_uint,),
    "glGetIntegerv": (None, c_uint, _ints),
    "glGetProgramiv": (None, c_uint, c_uint, _ints),
    "glGetShaderInfoLog": (None, c_uint, c_int, _ints, c_char_p),
    "glGetShaderiv": (None, c_uint, c_uint, _ints),
    "glGetString": (c_char_p, c_uint),
    "glGetUniformLocation": (c_int, c_uint, c_char_p),
    "glLinkProgram": (None, c_uint),
    "glPointSize": (None, c_float),
    "glScissor": (None, c_int, c_int, c_int, c_int),
    "glShaderSource": (None, c_uint, c_int, POINTER(c_char_p), _ints),
    "glTexImage2D": (None, c_uint, c_int, c_int, c_int, c_int, c_int, c_uint, c_uint, c_void_p),
    "glTexParameteri": (None, c_uint, c_uint, c_int),
    "glUniform1i": (None, c_int, c_int),
    "glUniform2f": (None, c_int, c_float, c_float),
    "glUniformMatrix4fv": (None, c_int, c_int, c_ubyte, POINTER(c_float)),
    "glUseProgram": (None, c_uint),
    "glVertexAttribPointer": (None, c_uint, c_int, c_uint, c_ubyte, c_int, c_void_p),
    "glViewport": (None, c_int, c_int, c_int, c_int),
}


class GLError(Exception):
    """OpenGL cannot draw; the message tells the user why."""


class GLFunctions:
    """The functions of one context as methods; it must be current whenever one is called.

    Raises
    ------
    GLError
        The context lacks OpenGL 2.1, or textures in vertex shaders.
    """

    def __init__(self, context: QOpenGLContext) -> None:
        for name, (result, *arguments) in _SIGNATURES.items():
            address = context.getProcAddress(name.encode())
            if not address:
                raise GLError(f"this display's OpenGL has no {name}")
            setattr(self, name, ctypes.CFUNCTYPE(result, *arguments)(int(address)))
        version = str(self.glGetString(VERSION).decode(errors="replace"))
        if version.startswith("OpenGL ES") or version < "2.1":
            raise GLError(f"this display has OpenGL {version}, not 2.1")
        if not self.integer("glGetIntegerv", MAX_VERTEX_TEXTURE_IMAGE_UNITS):
            raise GLError("this OpenGL has no textures in vertex shaders")

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"OpenGL function {name} is not in the table")

    def integer(self, function: str, *arguments: int) -> int:
        """Return what a ``gl…iv`` function writes."""
        value = c_int(0)
        getattr(self, function)(*arguments, ctypes.byref(value))
        return value.value

    def new_name(self, function: str) -> int:
        """Return the one name that ``glGenBuffers`` or ``glGenTextures`` makes."""
        name = c_uint(0)
        getattr(self, function)(1, ctypes.byref(name))
        return name.value

    def delete_name(self, function: str, name: int) -> None:
        """Delete one name through ``glDeleteBuffers`` or ``glDeleteTextures``."""
        getattr(self, function)(1, ctypes.byref(c_uint(name)))

    def new_program(self, vertex: str, fragment: str, attributes: tuple[str, ...]) -> int:
        """Compile and link a program whose attributes get the locations 0, 1, 2 and so on.

        Raises
        ------
        GLError
            The driver refuses the source.
        """
        program = int(self.glCreateProgram())
        for kind, source in ((VERTEX_SHADER, vertex), (FRAGMENT_SHADER, fragment)):
            shader = int(self.glCreateShader(kind))
            self.glShaderSource(shader, 1, ctypes.byref(c_char_p(source.encode())), None)
            self.glCompileShader(shader)
            if not self.integer("glGetShaderiv", shader, COMPILE_STATUS):
                log = ctypes.create_string_buffer(1000)
                self.glGetShaderInfoLog(shader, len(log), None, log)
                raise GLError(f"the graphics driver refuses the shader: {log.value.decode(errors='replace').strip()}")
            self.glAttachShader(program, shader)
            self.glDeleteShader(shader)
        for location, name in enumerate(attributes):
            self.glBindAttribLocation(program, location, name.encode())
        self.glLinkProgram(program)
        if not self.integer("glGetProgramiv", program, LINK_STATUS):
            raise GLError("the graphics driver cannot link the shaders")
        return program
