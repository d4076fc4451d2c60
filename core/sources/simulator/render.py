"""What each camera sees of the membrane and the object: rasterising, sphere tracing, shading.

Images here have no noise. Positions are metres in the membrane's frame. The kernels get cameras as ``camera_pose``,
(3, 4), from the membrane's frame to theirs, and ``pinhole``: (fx, fy, cx, cy) in pixels. The print is a texture of the
flat sheet: channel 0 is dark dye that infrared passes, droplets at random or a grid of dots for measuring strain,
channel 1 the opaque print, which reflects infrared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from ...model.arrays import Float32Array, Float64Array, Int32Array, Uint8Array
from ...model.intrinsics import Intrinsics
from .objects import compiled, distance, normal

Print = Literal["droplets", "dots"]

TEXEL_M: Final = 0.0004
#: Distance between the dots of the grid, and their radius, metres.
DOT_SPACING_M: Final = 0.010
DOT_RADIUS_M: Final = 0.0014
_DROPLET_SPACING_M: Final = 0.0105
#: Centres of the patches that reflect infrared, metres.
_OPAQUE_PLACES: Final = ((-0.128, -0.046), (-0.112, 0.058), (0.116, -0.060), (0.134, 0.030), (0.020, 0.084))


def paint_sheet(width_m: float, height_m: float, kind: Print) -> Uint8Array:
    """Paint the sheet, (rows, columns, 2). A grid of dots has no other print, so no dot is hidden."""
    rng = np.random.default_rng([0, 1])
    sheet = np.zeros((round(height_m / TEXEL_M) + 1, round(width_m / TEXEL_M) + 1, 2), dtype=np.uint8)
    if kind == "dots":
        for x, y in dot_grid(width_m, height_m):
            _paint_spot(sheet, x, y, DOT_RADIUS_M, 0.0, 0.0)
        return sheet
    for j in range(-10, 11):
        for i in range(-17, 18):
            x, y = (np.array([i + 0.5 * (j % 2), j]) + rng.uniform(-0.27, 0.27, 2)) * _DROPLET_SPACING_M
            _paint_spot(sheet, x, y, rng.uniform(0.0013, 0.0025), rng.uniform(0.0, 0.15), rng.uniform(0.0, 2 * np.pi))
    for place in _OPAQUE_PLACES:
        _paint_opaque(sheet, place, rng)
    return sheet


def dot_grid(width_m: float, height_m: float) -> Float64Array:
    """Return the places of the grid's dots on the flat sheet, row by row, (N, 2)."""
    columns, rows = dot_counts(width_m, height_m)
    i, j = np.meshgrid(np.arange(columns) - (columns - 1) / 2, np.arange(rows) - (rows - 1) / 2)
    return np.stack([i.ravel(), j.ravel()], axis=1) * DOT_SPACING_M


def dot_counts(width_m: float, height_m: float) -> tuple[int, int]:
    """Return how many dots the grid has along the length and the width; the rim keeps half a spacing free."""
    columns, rows = (int((size - DOT_SPACING_M) / DOT_SPACING_M) // 2 * 2 + 1 for size in (width_m, height_m))
    return columns, rows


def _paint_spot(sheet: Uint8Array, x_m: float, y_m: float, radius: float, wobble: float, phase: float) -> None:
    rows, columns = sheet.shape[:2]
    near = (slice(*_span(y_m, radius, rows)), slice(*_span(x_m, radius, columns)))
    y, x = (grid[near] for grid in _places(rows, columns))
    rim = radius * (1 + wobble * np.cos(2 * np.arctan2(y - y_m, x - x_m) + phase))
    cover = np.clip((rim - np.hypot(x - x_m, y - y_m)) / TEXEL_M + 0.5, 0, 1)
    sheet[(*near, 0)] = np.maximum(sheet[(*near, 0)], np.round(255 * cover).astype(np.uint8))


def _paint_opaque(sheet: Uint8Array, place: tuple[float, float], rng: np.random.Generator) -> None:
    px, py = place + rng.uniform(-0.005, 0.005, 2)
    a, b, turn = rng.uniform(0.008, 0.014), rng.uniform(0.006, 0.009), rng.uniform(0, np.pi)
    y, x = _places(*sheet.shape[:2])
    s, t = np.cos(turn) * (x - px) + np.sin(turn) * (y - py), np.cos(turn) * (y - py) - np.sin(turn) * (x - px)
    around = np.arctan2(t, s)
    rim = 1 + 0.12 * np.cos(2 * around + turn) + 0.10 * np.cos(3 * around) + 0.05 * np.cos(7 * around - turn)
    sheet[np.hypot(s / a, t / b) < rim, 1] = 255


def _places(rows: int, columns: int) -> tuple[Float64Array, Float64Array]:
    """Return y and x of every texel, as views that take no memory."""
    y, x = ((np.arange(count) - (count - 1) / 2) * TEXEL_M for count in (rows, columns))
    return np.broadcast_to(y[:, None], (rows, columns)), np.broadcast_to(x[None, :], (rows, columns))


def _span(centre: float, radius: float, texels: int) -> tuple[int, int]:
    texel = centre / TEXEL_M + 0.5 * (texels - 1)
    reach = 1.3 * radius / TEXEL_M + 2
    return max(int(texel - reach), 0), max(min(int(texel + reach) + 1, texels), 0)


#: One count of the clean depth images, metres.
CLEAN_UNIT_M: Final = 2e-5
#: Contents of the flag images, bit by bit.
CONTACT_FLAG: Final = 1
EDGE_FLAG: Final = 2
REFLECTIVE_FLAG: Final = 4

#: Share of the light that the clear film lets through to the object and back.
_FILM_SHARE: Final = 0.70
#: Distance behind the film over which its haze takes the object's contrast down to 1/e, metres.
_HAZE_M: Final = 0.030
#: Tangent of the half-angle into which the film scatters: an outline blurs by this share of the gap.
_BLUR_TANGENT: Final = 0.20
#: A step of depth between neighbours that flying pixels bridge, metres.
_EDGE_STEP_M: Final = 0.006
#: A ray this near the object has met it, metres.
_HIT_M: Final = 1e-5
#: Linear RGB of the bare film, of the saturated print that reflects infrared, and of the droplets' dark dye.
_FILM_COLOUR: Final = (0.36, 0.21, 0.29)
_PRINT_COLOUR: Final = (0.72, 0.055, 0.40)
_DYE_COLOUR: Final = (0.015, 0.02, 0.055)
_HOUSING_LEVEL: Final = 0.012


@dataclass(frozen=True)
class Camera:
    """A pinhole without distortion; ``pose``, (3, 4), takes points of the membrane's frame to the camera's."""

    intrinsics: Intrinsics
    pose: Float64Array

    @property
    def pinhole(self) -> Float64Array:
        """Focal lengths and principal point ``(fx, fy, cx, cy)`` in pixels."""
        i = self.intrinsics
        return np.array([i.fx, i.fy, i.cx, i.cy])


@dataclass(frozen=True)
class Surface:
    """The membrane as one camera sees it, pixel by pixel."""

    #: (H, W), metres; 0 where the camera sees the housing.
    depth: Float32Array
    #: (H, W, 7): place on the flat sheet (x, y, metres), touching (0 to 1), unit normal, and contact pressure, Pa.
    attributes: Float32Array


def rasterise(camera: Camera, nodes: Float64Array, triangles: Int32Array, values: Float64Array) -> Surface:
    """Draw the membrane's triangles into a depth buffer and interpolate some values, (N, K), of its nodes."""
    height, width = camera.intrinsics.shape
    depth = np.zeros((height, width), dtype=np.float32)
    attributes = np.zeros((height, width, values.shape[1]), dtype=np.float32)
    seen = nodes @ camera.pose[:, :3].T + camera.pose[:, 3]
    _rasterise(seen, triangles, values, camera.pinhole, depth, attributes)
    return Surface(depth, attributes)


@compiled
def _rasterise(
    nodes: Float64Array,
    triangles: Int32Array,
    values: Float64Array,
    pinhole: Float64Array,
    depth: Float32Array,
    attributes: Float32Array,
) -> None:
    height, width = depth.shape
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        wa, wb, wc = 1.0 / nodes[a, 2], 1.0 / nodes[b, 2], 1.0 / nodes[c, 2]
        ua, va = nodes[a, 0] * wa * pinhole[0] + pinhole[2], nodes[a, 1] * wa * pinhole[1] + pinhole[3]
        ub, vb = nodes[b, 0] * wb * pinhole[0] + pinhole[2], nodes[b, 1] * wb * pinhole[1] + pinhole[3]
        uc, vc = nodes[c, 0] * wc * pinhole[0] + pinhole[2], nodes[c, 1] * wc * pinhole[1] + pinhole[3]
        doubled = (ub - ua) * (vc - va) - (uc - ua) * (vb - va)
        if doubled == 0.0:
            continue
        left, right = max(math.ceil(min(ua, ub, uc)), 0), min(math.floor(max(ua, ub, uc)), width - 1)
        top, bottom = max(math.ceil(min(va, vb, vc)), 0), min(math.floor(max(va, vb, vc)), height - 1)
        for v in range(top, bottom + 1):
            for u in range(left, right + 1):
                kb = ((u - ua) * (vc - va) - (uc - ua) * (v - va)) / doubled
                kc = ((ub - ua) * (v - va) - (u - ua) * (vb - va)) / doubled
                ka = 1.0 - kb - kc
                if ka < 0.0 or kb < 0.0 or kc < 0.0:
                    continue
                z = 1.0 / (ka * wa + kb * wb + kc * wc)
                if depth[v, u] != 0.0 and depth[v, u] <= z:
                    continue
                depth[v, u] = z
                ka, kb, kc = ka * wa * z, kb * wb * z, kc * wc * z
                for k in range(values.shape[1]):
                    attributes[v, u, k] = ka * values[a, k] + kb * values[b, k] + kc * values[c, k]


def node_areas(nodes: Float64Array, triangles: Int32Array) -> Float64Array:
    """Return the areas of the membrane at its nodes as vectors, (N, 3), which point outward."""
    a, b, c = (nodes[triangles[:, corner]] for corner in range(3))
    areas = np.zeros_like(nodes)
    np.add.at(areas, triangles, np.cross(b - a, c - a)[:, None] / 6.0)  # a third of a triangle to each corner
    return areas


@compiled
def _ray(camera_pose: Float64Array, pinhole: Float64Array, u: int, v: int) -> tuple[float, float, float, float]:
    """Return the length of a pixel's ray of depth 1 and its unit direction in the membrane's frame."""
    r = camera_pose
    x, y = (u - pinhole[2]) / pinhole[0], (v - pinhole[3]) / pinhole[1]
    length = math.sqrt(x * x + y * y + 1.0)
    dx = (r[0, 0] * x + r[1, 0] * y + r[2, 0]) / length
    dy = (r[0, 1] * x + r[1, 1] * y + r[2, 1]) / length
    dz = (r[0, 2] * x + r[1, 2] * y + r[2, 2]) / length
    return length, dx, dy, dz


@compiled
def see_through(
    camera_pose: Float64Array,
    pinhole: Float64Array,
    membrane: Float32Array,
    kind: int,
    pose: Float64Array,
    backdrop: Float64Array,
    depth: Float32Array,
    cosine: Uint8Array,
) -> None:
    """Trace each ray on behind the membrane to the object or the backdrop; fill in depth and cosine of incidence * 255.

    ``membrane`` is its depth, (H, W), 0 where the housing blocks the view; ``backdrop`` a plane n . x = d: n, d.
    """
    height, width = depth.shape
    r = camera_pose
    # The camera's centre in the membrane's frame: -R^T t.
    ox = -(r[0, 0] * r[0, 3] + r[1, 0] * r[1, 3] + r[2, 0] * r[2, 3])
    oy = -(r[0, 1] * r[0, 3] + r[1, 1] * r[1, 3] + r[2, 1] * r[2, 3])
    oz = -(r[0, 2] * r[0, 3] + r[1, 2] * r[1, 3] + r[2, 2] * r[2, 3])
    for v in range(height):
        for u in range(width):
            depth[v, u], cosine[v, u] = 0.0, 0
            if membrane[v, u] == 0.0:
                continue
            length, dx, dy, dz = _ray(r, pinhole, u, v)
            facing = backdrop[0] * dx + backdrop[1] * dy + backdrop[2] * dz
            end = (backdrop[3] - backdrop[0] * ox - backdrop[1] * oy - backdrop[2] * oz) / facing
            # Flat triangles cut a little into edges that the true sheet wraps around: start before it.
            reach = max(membrane[v, u] * length - 0.002, 0.0)
            gap = np.inf
            for _ in range(200):
                gap = distance(kind, pose, ox + reach * dx, oy + reach * dy, oz + reach * dz)
                if gap < _HIT_M or reach > end:
                    break
                reach += gap
            if gap < _HIT_M:
                nx, ny, nz = normal(kind, pose, ox + reach * dx, oy + reach * dy, oz + reach * dz)
                facing = -(nx * dx + ny * dy + nz * dz)
            else:
                reach = end
            depth[v, u] = reach / length
            cosine[v, u] = int(255.0 * min(max(abs(facing), 0.0), 1.0))


@compiled
def _sample(texture: Uint8Array, channel: int, x: float, y: float) -> float:
    """Return a texture's value, 0 to 1, bilinearly; the origin is its centre."""
    rows, columns = texture.shape[0], texture.shape[1]
    s = min(max(x / TEXEL_M + 0.5 * (columns - 1), 0.0), columns - 1.001)
    t = min(max(y / TEXEL_M + 0.5 * (rows - 1), 0.0), rows - 1.001)
    i, j = int(s), int(t)
    fs, ft = s - i, t - j
    upper = (1.0 - fs) * texture[j, i, channel] + fs * texture[j, i + 1, channel]
    lower = (1.0 - fs) * texture[j + 1, i, channel] + fs * texture[j + 1, i + 1, channel]
    return float(((1.0 - ft) * upper + ft * lower) / 255.0)


@compiled
def _seen_through_film(
    kind: int, pose: Float64Array, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> float:
    """Return the share, 0 to 1, of an object behind the film in the light from a point along a unit direction.

    Falls with the gap along the ray (haze); rays that miss by less than the blur at that gap see a part.
    """
    reach, gap, share = 0.0, 0.0, 0.0
    for _ in range(60):
        gap = distance(kind, pose, x + reach * dx, y + reach * dy, z + reach * dz)
        if gap < _HIT_M:
            return max(share, math.exp(-reach / _HAZE_M))
        missed = 1.0 - gap / (_BLUR_TANGENT * reach) if reach > 0.0 else 0.0
        if missed > 0.0:
            share = max(share, missed * missed * math.exp(-reach / _HAZE_M))
        reach += max(gap, 2e-4)
        if reach > 5.0 * _HAZE_M:
            break
    return share


@compiled
def shade(
    camera_pose: Float64Array,
    pinhole: Float64Array,
    membrane: Float32Array,
    attributes: Float32Array,
    kind: int,
    pose: Float64Array,
    tint: Float64Array,
    texture: Uint8Array,
    gamma: Uint8Array,
    image: Uint8Array,
) -> None:
    """Colour the membrane: its prints, and between them a clear film that shows what is behind, in its haze.

    ``tint`` is the object's linear RGB, ``gamma`` the display value of each of 4096 levels.
    """
    height, width = membrane.shape
    r = camera_pose
    for v in range(height):
        for u in range(width):
            z = membrane[v, u]
            if z == 0.0:
                level = gamma[int(4095 * _HOUSING_LEVEL)]
                image[v, u, 0], image[v, u, 1], image[v, u, 2] = level, level, level
                continue
            _, dx, dy, dz = _ray(r, pinhole, u, v)
            rx, ry = (u - pinhole[2]) / pinhole[0], (v - pinhole[3]) / pinhole[1]
            cx, cy, cz = rx * z - r[0, 3], ry * z - r[1, 3], z - r[2, 3]
            x = r[0, 0] * cx + r[1, 0] * cy + r[2, 0] * cz
            y = r[0, 1] * cx + r[1, 1] * cy + r[2, 1] * cz
            w = r[0, 2] * cx + r[1, 2] * cy + r[2, 2] * cz
            share = _FILM_SHARE * _seen_through_film(kind, pose, x, y, w, dx, dy, dz)
            dye = 0.94 * _sample(texture, 0, attributes[v, u, 0], attributes[v, u, 1])
            print_ = _sample(texture, 1, attributes[v, u, 0], attributes[v, u, 1])
            # A ring of lamps around the cameras, 0.25 m below the rim's plane.
            lz = w + 0.25
            far2 = x * x + y * y + lz * lz
            far = math.sqrt(far2)
            facing = (x * attributes[v, u, 3] + y * attributes[v, u, 4] + lz * attributes[v, u, 5]) / far
            light = 0.30 + 0.62 * max(facing, 0.0) * 0.0986 / far2
            for k in range(3):
                seen = (1.0 - share) * _FILM_COLOUR[k] + share * tint[k]
                seen = (1.0 - dye) * seen + dye * _DYE_COLOUR[k]
                level_k = light * ((1.0 - print_) * seen + print_ * _PRINT_COLOUR[k])
                image[v, u, k] = gamma[int(4095.0 * min(max(level_k, 0.0), 1.0))]


@compiled
def flag(behind: Float32Array, attributes: Float32Array, texture: Uint8Array, flags: Uint8Array) -> None:
    """Mark contact, steps of depth and infrared-reflective rubber in the proximity image."""
    height, width = behind.shape
    for v in range(height):
        for u in range(width):
            flags[v, u] = 0
            z = behind[v, u]
            if z == 0.0:
                continue
            bits = 0
            if attributes[v, u, 2] >= 0.5:
                bits |= CONTACT_FLAG
            if _sample(texture, 1, attributes[v, u, 0], attributes[v, u, 1]) >= 0.5:
                bits |= REFLECTIVE_FLAG
            for dv in range(-1, 2):
                for du in range(-1, 2):
                    j, i = min(max(v + dv, 0), height - 1), min(max(u + du, 0), width - 1)
                    if behind[j, i] > 0.0 and abs(behind[j, i] - z) > _EDGE_STEP_M:
                        bits |= EDGE_FLAG
            flags[v, u] = bits
