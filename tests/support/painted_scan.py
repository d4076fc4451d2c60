"""Painted scans of simulated objects, with the contact that the solver knows."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np
import trimesh

from tactune.core.calibration.geometry import moved
from tactune.core.model.arrays import BoolArray, Float32Array, Float64Array
from tactune.core.sources.simulator.objects import object_surface, to_surface
from tactune.core.sources.simulator.simulator_source import SimulatorSource

#: Thermochromic paint, touched and not, RGB.
PINK: Final = (235, 110, 170)
PURPLE: Final = (90, 50, 140)
#: Side of the mesh's quads, metres, and standard deviation of a vertex's colour, 0 to 255.
_FINE_M, _NOISE = 0.0008, 12.0
#: Largest distance between membrane and touched surface along the camera's axis, metres: covers interpolation between
#: nodes and steep pixels. The far side of every object is farther away.
_NEAR_M: Final = 0.003


def write_painted_scan(source: SimulatorSource, index: int, path: Path) -> tuple[Path, Path]:
    """Write the object of a simulated frame as a scan, pink where the membrane touches it, and its true pose."""
    vertices, quads = object_surface(source.scene.pressed.kind, _FINE_M)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    colors = np.where(_touched(source, index, vertices)[:, None], PINK, PURPLE).astype(np.float64)
    colors += _NOISE * np.random.default_rng(1).standard_normal(colors.shape)
    painted = np.clip(np.round(colors), 0, 255).astype(np.uint8)
    trimesh.Trimesh(vertices, triangles, vertex_colors=painted, process=False).export(path)
    transform = path.with_suffix(".transform.txt")
    transform.write_text("\n".join(" ".join(map(str, row)) for row in source.facts(index).T_proximity_object))
    return path, transform


def _touched(source: SimulatorSource, index: int, points: Float64Array) -> BoolArray:
    """Return which points of the object's surface, (N, 3), the proximity camera sees in contact."""
    truth, pose = source.read(index).truth, source.facts(index).T_proximity_object
    assert truth is not None
    assert truth.depth_m is not None
    seen = moved(pose, points)
    outward = to_surface(source.scene.pressed.kind, points) @ np.asarray(pose)[:3, :3].T
    u, v = source.rig.proximity.intrinsics.project(seen).astype(np.float32).T
    share = _looked_up(truth.contact.astype(np.float32), u, v, cv2.INTER_LINEAR)
    film = _looked_up(truth.depth_m, u, v, cv2.INTER_NEAREST)
    facing = (outward * seen).sum(axis=1) < 0
    return np.asarray(facing & (share >= 0.5) & (np.abs(seen[:, 2] - film) < _NEAR_M))


def _looked_up(image: Float32Array, u: Float32Array, v: Float32Array, how: int) -> Float32Array:
    """Return an image's values at pixels, (N,), 0 outside."""
    rows = 4096  # OpenCV allows at most 32767 columns
    wide = [np.pad(where, (0, -len(where) % rows)).reshape(-1, rows) for where in (u, v)]
    found = cv2.remap(image, wide[0], wide[1], how, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)
    return np.asarray(found, np.float32).reshape(-1)[: len(u)]
