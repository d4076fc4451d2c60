"""Painted scans of simulated objects, with the contact that the solver knows."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import trimesh
from scipy.spatial import cKDTree

from tactune.core.lab.scan import transformed
from tactune.core.model.arrays import BoolArray, Float32Array, Float64Array, Uint8Array
from tactune.core.model.frames import GroundTruth, Matrix4, Rig
from tactune.core.sources.simulator.objects import object_surface, to_surface
from tactune.core.sources.simulator.source import SimulatorSource

#: Thermochromic paint, touched and not, RGB.
PINK: Final = (235, 110, 170)
PURPLE: Final = (90, 50, 140)

#: Side of the mesh's quads, metres.
FINE_M: Final = 0.0008
#: Largest distance between membrane and touched surface along the camera's axis, metres: covers interpolation between
#: nodes and steep pixels. The far side of every object is farther away.
_NEAR_M: Final = 0.003
_SPECK_RADIUS_M: Final = 0.0012


@dataclass(frozen=True)
class PaintFlaws:
    """Deviations of a real scan's colours from two pure ones.

    Attributes
    ----------
    noise : float
        Standard deviation of each channel at each vertex, 0 to 255.
    specks : int
        Spots of the other colour, 2.4 mm wide, anywhere on the object.
    seed : int
    """

    noise: float = 0.0
    specks: int = 0
    seed: int = 0


def write_painted_scan(source: SimulatorSource, index: int, path: Path, flaws: PaintFlaws | None = None) -> list[Path]:
    """Write the object of a simulated frame as a scan, pink where the membrane touches it, and its true pose.

    Contact is the frame's ground truth, projected from the proximity camera onto the object. Surface that the camera
    does not see stays purple.

    Parameters
    ----------
    path : path
        ``NAME.ply``: a fine mesh with vertex colours.

    Returns
    -------
    list of Path
        The scan, and ``NAME.transform.json`` for `load_transform`.
    """
    truth, pose = source.read(index).truth, source.facts(index).T_proximity_object
    assert truth is not None
    painter = _Painter(source.scene.pressed.kind, pose, truth, source.rig, flaws or PaintFlaws())
    vertices, quads = object_surface(painter.kind, FINE_M)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    trimesh.Trimesh(vertices, triangles, vertex_colors=painter.colors(vertices), process=False).export(path)
    transform = path.with_suffix(".transform.json")
    transform.write_text(json.dumps({"T_proximity_scan": pose}))
    return [path, transform]


@dataclass(frozen=True, eq=False)
class _Painter:
    """Colours points on the object of one frame."""

    kind: int
    T_proximity_object: Matrix4
    truth: GroundTruth
    rig: Rig
    flaws: PaintFlaws

    def touched(self, points: Float64Array) -> BoolArray:
        """Tell which points of the surface, (N, 3), the proximity camera sees in contact."""
        normals = to_surface(self.kind, points)
        seen = transformed(self.T_proximity_object, points)
        outward = normals @ np.asarray(self.T_proximity_object)[:3, :3].T
        u, v = self.rig.proximity.intrinsics.project(seen).astype(np.float32).T
        assert self.truth.depth_m is not None
        share = _looked_up(self.truth.contact.astype(np.float32), u, v, cv2.INTER_LINEAR)
        film = _looked_up(self.truth.depth_m, u, v, cv2.INTER_NEAREST)
        facing = (outward * seen).sum(axis=1) < 0
        return np.asarray(facing & (share >= 0.5) & (np.abs(seen[:, 2] - film) < _NEAR_M))

    def colors(self, points: Float64Array) -> Uint8Array:
        """Return the paint's colour with flaws, uint8 (N, 3), of points on the surface."""
        touched, random = self.touched(points), np.random.default_rng(self.flaws.seed)
        if self.flaws.specks:
            centres = points[random.integers(len(points), size=self.flaws.specks)]
            hit = np.unique(np.concatenate(cKDTree(points).query_ball_point(centres, _SPECK_RADIUS_M)))
            touched[hit.astype(np.intp)] ^= True
        colors = np.where(touched[:, None], PINK, PURPLE).astype(np.float64)
        colors += self.flaws.noise * random.standard_normal(colors.shape)
        return np.clip(np.round(colors), 0, 255).astype(np.uint8)


def _looked_up(image: Float32Array, u: Float32Array, v: Float32Array, how: int) -> Float32Array:
    """Return an image's values at pixels, (N,), 0 outside."""
    rows = 4096  # OpenCV allows at most 32767 columns
    wide = [np.pad(where, (0, -len(where) % rows)).reshape(-1, rows) for where in (u, v)]
    found = cv2.remap(image, wide[0], wide[1], how, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)
    return np.asarray(found, np.float32).reshape(-1)[: len(u)]
