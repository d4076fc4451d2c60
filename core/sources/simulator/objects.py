"""The rigid objects that press on the membrane, as signed distance functions and as meshes.

Lengths are metres. In an object's own frame the membrane lies towards -z, and the origin is near the object's centre.
Distances are negative inside. The smooth unions are lower bounds away from the surface.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, TypeVar, cast

import numpy as np

from ...contact.kernels.compiling import kernel
from ...model.arrays import BoolArray, Float32Array, Float64Array, Int64Array

_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])

NO_OBJECT: Final = -1
CUBE: Final = 0
CUP: Final = 1
OCTOPUS: Final = 2
MUG: Final = 3
HAND: Final = 4
#: Serves the analytic checks.
BALL: Final = 5
TRAY: Final = 6

BALL_RADIUS_M: Final = 0.040

#: Radius of a sphere about the origin that holds any of the objects, and up to which distance from it the exact shape
#: is evaluated, metres.
_BOUND: Final = 0.080
_NEAR: Final = 0.020
#: Half the thickness of an octopus arm at its thickest, and the width of the smooth union of two, metres.
_ARM_REACH: Final = 0.0160
_ARM_UNION: Final = 0.012
#: Step of the finite differences that give the surface normal, metres.
_NORMAL_STEP: Final = 2e-6


def compiled(function: _Kernel) -> _Kernel:
    """Compile a kernel that creates no arrays: cached on disk, without the interpreter lock, bit-reproducible."""
    return cast(_Kernel, kernel(function, error_model="numpy"))


def allocating(function: _Kernel) -> _Kernel:
    """Compile a kernel that creates arrays, otherwise as `compiled`; it counts references, which is slower."""
    return cast(_Kernel, kernel(function, allocates=True, error_model="numpy"))


def turn(angles_deg: tuple[float, float, float]) -> Float64Array:
    """Return the 3 x 3 rotation that turns about the fixed axes x, y and z, in that order."""
    ax, ay, az = (math.radians(angle) for angle in angles_deg)
    rx = np.array([[1, 0, 0], [0, math.cos(ax), -math.sin(ax)], [0, math.sin(ax), math.cos(ax)]])
    ry = np.array([[math.cos(ay), 0, math.sin(ay)], [0, 1, 0], [-math.sin(ay), 0, math.cos(ay)]])
    rz = np.array([[math.cos(az), -math.sin(az), 0], [math.sin(az), math.cos(az), 0], [0, 0, 1]])
    rotation: Float64Array = rz @ ry @ rx
    return rotation


@dataclass(frozen=True)
class PressedObject:
    """An object: its shape, its rotation about x, y and z, where its origin presses, and its linear RGB."""

    kind: int
    rotation_deg: tuple[float, float, float]
    offset_m: tuple[float, float]
    colour: tuple[float, float, float]


OBJECTS: Final[dict[str, PressedObject]] = {
    "cube": PressedObject(CUBE, (5.0, -4.0, 24.0), (0.004, -0.003), (0.95, 0.62, 0.06)),
    "cup": PressedObject(CUP, (0.0, 0.0, 8.0), (-0.030, 0.0), (0.05, 0.62, 0.66)),
    "octopus": PressedObject(OCTOPUS, (3.0, 4.0, 10.0), (0.003, 0.004), (0.92, 0.80, 0.30)),
    "tray": PressedObject(TRAY, (0.0, 0.0, 0.0), (0.0, 0.0), (0.55, 0.36, 0.18)),
    "mug": PressedObject(MUG, (10.0, -8.0, 35.0), (0.006, 0.004), (0.20, 0.45, 0.90)),
    "hand": PressedObject(HAND, (-4.0, 5.0, 60.0), (0.010, -0.006), (0.88, 0.52, 0.36)),
}
#: Objects that are reserved for judging methods.
HELD_OUT: Final = ("mug", "hand")


@compiled
def _box(x: float, y: float, z: float, half_x: float, half_y: float, half_z: float, rounding: float) -> float:
    qx, qy, qz = abs(x) - half_x + rounding, abs(y) - half_y + rounding, abs(z) - half_z + rounding
    outside = math.sqrt(max(qx, 0.0) ** 2 + max(qy, 0.0) ** 2 + max(qz, 0.0) ** 2)
    return outside + min(max(qx, qy, qz), 0.0) - rounding


@compiled
def _cylinder(x: float, y: float, z: float, radius: float, half_length: float, rounding: float) -> float:
    qr, qz = math.sqrt(x * x + y * y) - radius + rounding, abs(z) - half_length + rounding
    return math.sqrt(max(qr, 0.0) ** 2 + max(qz, 0.0) ** 2) + min(max(qr, qz), 0.0) - rounding


@compiled
def _capsule(
    x: float, y: float, z: float, ax: float, ay: float, az: float, bx: float, by: float, bz: float, radius: float
) -> float:
    dx, dy, dz = bx - ax, by - ay, bz - az
    share = ((x - ax) * dx + (y - ay) * dy + (z - az) * dz) / (dx * dx + dy * dy + dz * dz)
    share = min(max(share, 0.0), 1.0)
    return math.sqrt((x - ax - share * dx) ** 2 + (y - ay - share * dy) ** 2 + (z - az - share * dz) ** 2) - radius


@compiled
def _smooth_min(a: float, b: float, width: float) -> float:
    h = max(width - abs(a - b), 0.0) / width
    return min(a, b) - 0.25 * h * h * width


@compiled
def _cup(x: float, y: float, z: float) -> float:
    """Cup on its side: its axis along y, its handle a ring reaching out towards +x and the membrane."""
    body = _cylinder(x, z, y, 0.037, 0.046, 0.004)
    # The handle lies in the plane of the cup's axis and the direction 24 degrees below +x.
    c, s = 0.9135454576426009, 0.40673664307580015
    out, across = c * x - s * z, s * x + c * z
    ring, tube, middle = 0.025, 0.0080, 0.043
    handle = math.sqrt((math.sqrt((out - middle) ** 2 + y * y) - ring) ** 2 + across * across) - tube
    return min(body, handle)


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
def _mug(x: float, y: float, z: float) -> float:
    """Mug that comes down with its base; its handle, towards +x, is a closed one."""
    body = _cylinder(x, y, z, 0.034, 0.036, 0.008)
    handle = _capsule(x, y, z, 0.046, 0.0, -0.010, 0.046, 0.0, 0.014, 0.0095)
    return _smooth_min(body, handle, 0.018)


@compiled
def _hand(x: float, y: float, z: float) -> float:
    """Hand, palm towards the membrane: a rounded plate, four fingers bent to it, a thumb."""
    hand = _box(x, y + 0.028, z - 0.004, 0.031, 0.030, 0.012, 0.010)
    for finger in range(4):
        root, reach = 0.0205 - 0.0137 * finger, 0.052 + 0.012 * (1.0 - 0.5 * (finger - 1.3) ** 2)
        tip = 1.45 * root
        limb = _capsule(x, y, z, root, 0.0, 0.004, tip, reach, -0.006, 0.0085)
        hand = _smooth_min(hand, limb, 0.014)
    thumb = _capsule(x, y, z, 0.024, -0.032, 0.002, 0.056, -0.006, -0.006, 0.0095)
    return _smooth_min(hand, thumb, 0.014)


@compiled
def distance(kind: int, pose: Float64Array, x: float, y: float, z: float) -> float:
    """Return the signed distance of a point to an object, metres; 1 m where there is none.

    Farther than ``_NEAR`` from the sphere that holds the object it is a lower bound. ``pose``, shape (3, 4), takes
    points to the object's frame.
    """
    px = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
    py = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
    pz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
    beyond = math.sqrt(px * px + py * py + pz * pz) - _BOUND
    if beyond > _NEAR:
        return 1.0 if kind == NO_OBJECT else beyond
    gap = 1.0
    if kind == CUBE:
        gap = _box(px, py, pz, 0.0325, 0.0325, 0.0325, 0.007)
    elif kind == CUP:
        gap = _cup(px, py, pz)
    elif kind == OCTOPUS:
        gap = _octopus(px, py, pz)
    elif kind == MUG:
        gap = _mug(px, py, pz)
    elif kind == HAND:
        gap = _hand(px, py, pz)
    elif kind == TRAY:  # its flat underside, in z = 0, is towards the membrane
        gap = _box(px, py, pz - 0.008, 0.058, 0.050, 0.008, 0.003)
    elif kind == BALL:
        gap = math.sqrt(px * px + py * py + pz * pz) - BALL_RADIUS_M
    return gap


@compiled
def clearance(kind: int, pose: Float64Array, points: Float64Array) -> float:
    """Return the smallest `distance` of points, (N, 3), to an object, metres."""
    least = np.inf
    for n in range(points.shape[0]):
        least = min(least, distance(kind, pose, points[n, 0], points[n, 1], points[n, 2]))
    return least


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


# Meshes

#: Half side of a cube around the origin that contains every object, metres.
_HALF_M: Final = 0.084
_IDENTITY: Final = np.eye(4)[:3].copy()


def object_surface(kind: int, spacing_m: float) -> tuple[Float64Array, Int64Array]:
    """Return the surface of an object, in its own frame, as quads of about equal size.

    Surface nets (Gibson 1998): each voxel that the surface crosses gets a vertex at the mean of the crossed edges, and
    each crossed edge gets a quad. The vertices are then moved onto the surface.
    """
    count = 2 * math.ceil(_HALF_M / spacing_m) + 2
    axis = np.asarray((np.arange(count) - (count - 1) / 2) * spacing_m, np.float64)
    values = np.empty((count, count, count), np.float32)
    _fill(kind, _IDENTITY, axis, values)
    number = _voxel_numbers(values < 0)
    sums, crossings, quads = np.zeros((number.max() + 1, 3)), np.zeros(number.max() + 1), []
    for along in range(3):
        step, beside, before = np.roll(np.eye(3, dtype=np.int64), -along, axis=0)
        ahead = np.moveaxis(values < 0, along, 0)  # starts of the edges along this axis that the surface crosses
        start = np.argwhere(np.moveaxis(ahead[:-1] != ahead[1:], 0, along))
        near, far = values[tuple(start.T)], values[tuple((start + step).T)]
        places = axis[start] + (near / (near - far))[:, None] * step * spacing_m
        around = np.stack([number[tuple((start - back).T)] for back in (beside + before, before, 0 * step, beside)], 1)
        np.add.at(sums, around, places[:, None])
        np.add.at(crossings, around, 1)
        quads.append(np.where((near < 0)[:, None], around, around[:, ::-1]))
    vertices = sums / crossings[:, None]
    to_surface(kind, vertices)
    return vertices, np.concatenate(quads)


def _voxel_numbers(inside: BoolArray) -> Int64Array:
    """Number the voxels with corners on both sides of the surface; -1 for all others."""
    side = len(inside) - 1
    within = np.zeros((side, side, side), np.int8)
    for i, j, k in np.ndindex(2, 2, 2):
        within += inside[i : i + side, j : j + side, k : k + side]
    passed = (within > 0) & (within < 8)
    number = np.full(passed.shape, -1, np.int64)
    number[passed] = np.arange(np.count_nonzero(passed))
    return number


def to_surface(kind: int, points: Float64Array, pose: Float64Array = _IDENTITY) -> Float64Array:
    """Move points near an object's surface onto it, in place; return the outward unit normals there, (N, 3)."""
    normals = np.empty_like(points)
    _settle(kind, pose, points, normals)
    return normals


@compiled
def _fill(kind: int, pose: Float64Array, axis: Float64Array, values: Float32Array) -> None:
    for i in range(len(axis)):
        for j in range(len(axis)):
            for k in range(len(axis)):
                values[i, j, k] = distance(kind, pose, axis[i], axis[j], axis[k])


@compiled
def _settle(kind: int, pose: Float64Array, points: Float64Array, normals: Float64Array) -> None:
    for n in range(len(points)):
        for _ in range(12):
            x, y, z = points[n, 0], points[n, 1], points[n, 2]
            gap = distance(kind, pose, x, y, z)
            nx, ny, nz = normal(kind, pose, x, y, z)
            normals[n, 0], normals[n, 1], normals[n, 2] = nx, ny, nz
            if abs(gap) < 1e-9:
                break
            points[n, 0], points[n, 1], points[n, 2] = x - gap * nx, y - gap * ny, z - gap * nz
