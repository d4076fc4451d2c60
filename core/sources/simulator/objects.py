"""The rigid objects that press on the membrane, as signed distance functions.

Lengths are metres. In an object's own frame the membrane lies towards -z and the object's size and
place are chosen so that the origin is near its middle. Distances are negative inside; the smooth
unions are bounds rather than exact distances away from the surface, which is what sphere tracing and
projection to the surface need.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, TypeVar, cast

import numpy as np
import numpy.typing as npt
from numba import njit

from ...errors import SourceError

Float64Array = npt.NDArray[np.float64]
_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])

NO_OBJECT: Final = -1
CUBE: Final = 0
CUP: Final = 1
OCTOPUS: Final = 2

#: Radius of a sphere about the origin that holds any of the objects, metres.
_BOUND: Final = 0.080
#: Up to this distance from that sphere the exact shape is evaluated, metres.
_NEAR: Final = 0.020

#: Half the thickness of an octopus arm at its thickest, and the width of the smooth union of two, metres.
_ARM_REACH: Final = 0.0160
_ARM_UNION: Final = 0.012

#: Step of the finite differences that give the surface normal, metres.
_NORMAL_STEP: Final = 2e-6


def compiled(function: _Kernel) -> _Kernel:
    """Compile a kernel: kept on disk, free of the interpreter lock, and the same bits every time."""
    kernel: Any = njit(cache=True, nogil=True, error_model="numpy")(function)
    return cast(_Kernel, kernel)


@dataclass(frozen=True)
class PressedObject:
    """One object: its shape, how it is turned, where it presses and how it looks.

    Attributes
    ----------
    kind : int
        ``CUBE``, ``CUP`` or ``OCTOPUS``.
    rotation_deg : tuple of float
        Turns about x, y and z of the membrane's frame, applied in that order, degrees.
    offset_m : tuple of float
        Where the object's origin stands beside the membrane's middle, x and y, metres.
    colour : tuple of float
        Linear RGB of its surface, 0 to 1.
    """

    kind: int
    rotation_deg: tuple[float, float, float]
    offset_m: tuple[float, float]
    colour: tuple[float, float, float]

    def rotation(self) -> Float64Array:
        """Return the 3 x 3 rotation from the object's frame to the membrane's."""
        ax, ay, az = (math.radians(angle) for angle in self.rotation_deg)
        rx = np.array([[1, 0, 0], [0, math.cos(ax), -math.sin(ax)], [0, math.sin(ax), math.cos(ax)]])
        ry = np.array([[math.cos(ay), 0, math.sin(ay)], [0, 1, 0], [-math.sin(ay), 0, math.cos(ay)]])
        rz = np.array([[math.cos(az), -math.sin(az), 0], [math.sin(az), math.cos(az), 0], [0, 0, 1]])
        rotation: Float64Array = rz @ ry @ rx
        return rotation


OBJECTS: Final[dict[str, PressedObject]] = {
    "cube": PressedObject(CUBE, (5.0, -4.0, 24.0), (0.004, -0.003), (0.95, 0.62, 0.06)),
    "cup": PressedObject(CUP, (0.0, 0.0, 8.0), (-0.030, 0.0), (0.05, 0.62, 0.66)),
    "octopus": PressedObject(OCTOPUS, (3.0, 4.0, 10.0), (0.003, 0.004), (0.92, 0.80, 0.30)),
}


def find_object(scene: str) -> PressedObject:
    """Return the object of a scene by name.

    Raises
    ------
    SourceError
        No scene has this name.
    """
    if scene not in OBJECTS:
        raise SourceError(f"the simulator has no scene {scene!r}; choose one of {', '.join(OBJECTS)}")
    return OBJECTS[scene]


@compiled
def _cube(x: float, y: float, z: float) -> float:
    half, rounding = 0.0325, 0.007
    qx, qy, qz = abs(x) - half + rounding, abs(y) - half + rounding, abs(z) - half + rounding
    outside = math.sqrt(max(qx, 0.0) ** 2 + max(qy, 0.0) ** 2 + max(qz, 0.0) ** 2)
    return outside + min(max(qx, qy, qz), 0.0) - rounding


@compiled
def _cup(x: float, y: float, z: float) -> float:
    """Cup on its side: its axis along y, its handle a ring reaching out towards +x and the membrane."""
    radius, half_length, rounding = 0.037, 0.046, 0.004
    qr = math.sqrt(x * x + z * z) - radius + rounding
    qy = abs(y) - half_length + rounding
    body = math.sqrt(max(qr, 0.0) ** 2 + max(qy, 0.0) ** 2) + min(max(qr, qy), 0.0) - rounding
    # The handle lies in the plane of the cup's axis and the direction 24 degrees below +x.
    c, s = 0.9135454576426009, 0.40673664307580015
    out, across = c * x - s * z, s * x + c * z
    ring, tube, middle = 0.025, 0.0080, 0.043
    handle = math.sqrt((math.sqrt((out - middle) ** 2 + y * y) - ring) ** 2 + across * across) - tube
    return min(body, handle)


@compiled
def _smooth_min(a: float, b: float, width: float) -> float:
    h = max(width - abs(a - b), 0.0) / width
    return min(a, b) - 0.25 * h * h * width


@compiled
def _arm(across: float, along: float, z: float) -> float:
    """One octopus arm in its own vertical plane: a capsule that bends down to a knob."""
    ax, az, bx, bz = 0.016, 0.004, 0.050, -0.006
    dx, dz = bx - ax, bz - az
    share = min(max(((along - ax) * dx + (z - az) * dz) / (dx * dx + dz * dz), 0.0), 1.0)
    limb = math.sqrt((along - ax - share * dx) ** 2 + across * across + (z - az - share * dz) ** 2) - 0.0095
    knob = math.sqrt((along - 0.052) ** 2 + across * across + (z + 0.007) ** 2) - 0.0135
    return _smooth_min(limb, knob, 0.008)


@compiled
def _octopus(x: float, y: float, z: float) -> float:
    """Round head with six arms; only the nearest arm in angle and its two neighbours matter at any point."""
    head = math.sqrt(x * x + y * y + (z - 0.004) ** 2) - 0.031
    half, tall = 0.5, 0.8660254037844386
    # Arms stand every 60 degrees from x: mirror into one quadrant, then turn the arm at 60 degrees onto x.
    along, across = abs(x), abs(y)
    if across > along * half / tall:
        along, across = half * along + tall * across, half * across - tall * along
    arms = _arm(across, along, z)
    first = -1.0 if across > 0.0 else 1.0
    for side in (first, -first):
        beside = half * across + side * tall * along
        # An arm is nowhere nearer than this; farther than the union's width it changes nothing.
        if abs(beside) - _ARM_REACH < arms + _ARM_UNION:
            arms = _smooth_min(arms, _arm(beside, half * along - side * tall * across, z), _ARM_UNION)
    return _smooth_min(head, arms, 0.016)


@compiled
def distance(kind: int, pose: Float64Array, x: float, y: float, z: float) -> float:
    """Return the signed distance of a point to an object, metres; 1 m where there is none.

    Farther than ``_NEAR`` from the sphere that holds the object it is a lower bound.

    Parameters
    ----------
    kind : int
    pose : float64, shape (3, 4)
        Takes points of the surrounding frame to the object's own.
    x, y, z : float
        The point in the surrounding frame, metres.
    """
    px = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
    py = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
    pz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
    beyond = math.sqrt(px * px + py * py + pz * pz) - _BOUND
    if beyond > _NEAR:
        return 1.0 if kind == NO_OBJECT else beyond
    if kind == CUBE:
        return _cube(px, py, pz)
    if kind == CUP:
        return _cup(px, py, pz)
    if kind == OCTOPUS:
        return _octopus(px, py, pz)
    return 1.0


@compiled
def normal(kind: int, pose: Float64Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the unit outward normal of the level set through a point, in the surrounding frame."""
    e = _NORMAL_STEP
    a = distance(kind, pose, x + e, y - e, z - e)
    b = distance(kind, pose, x - e, y - e, z + e)
    c = distance(kind, pose, x - e, y + e, z - e)
    d = distance(kind, pose, x + e, y + e, z + e)
    nx, ny, nz = a - b - c + d, -a - b + c + d, -a + b - c + d
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if length == 0.0:
        return 0.0, 0.0, -1.0
    return nx / length, ny / length, nz / length
