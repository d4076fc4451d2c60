"""Alignment models: they map tactile measurements to proximity pixels.

The homography of one plane aligns both images, as published. The rigid model projects each proximity point into the
tactile image and compares the depth expected there with the depth measured there: exact wherever the membrane touches.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from ..errors import RigMismatchError
from ..model.alignment import AlignmentSection
from ..model.arrays import Float32Array, Float64Array, IndexArray, Int32Array, Uint16Array
from ..model.clouds import ray_table
from ..model.frames import Rig
from ..model.patch import AlignedDepth
from .kernels import tolerance as kernels
from .kernels.lenses import lens_parameters
from .kernels.threads import in_parallel

UNKNOWN_POSE = "the pose of the tactile camera is not known: calibrate, or set alignment.rigid.T_proximity_tactile"


@dataclass(frozen=True, eq=False)
class AlignmentModel:
    """An alignment model, with its tables for the kernels."""

    tables: kernels.AlignmentTables

    @property
    def size(self) -> kernels.ImageSizes:
        return self.tables.size

    def align(self, proximity: Uint16Array, tactile: Uint16Array, region: kernels.Region) -> AlignedDepth:
        """Return both depths for every proximity pixel of a region."""
        aligned = AlignedDepth.empty(proximity.shape)
        images = kernels.DepthImages(kernels.flat(proximity), kernels.flat(tactile))
        expected, measured = aligned.expected_m.reshape(-1), aligned.measured_m.reshape(-1)
        in_parallel(partial(kernels.align_rows, images, self.tables, region, expected, measured), len(proximity))
        return aligned

    def tactile_pixels(self, pixels: IndexArray, depth_m: Float32Array, rig: Rig) -> tuple[Float32Array, Float32Array]:
        """Return the tactile pixels ``u``, ``v`` (N,) of flat proximity pixels at some depths; nan for none."""
        tables = self.tables
        if not tables.rigid:
            partners = tables.table[pixels]
            width = tables.size.tactile_width
            u, v = (np.where(partners >= 0, part, np.nan) for part in (partners % width, partners // width))
            return u.astype(np.float32), v.astype(np.float32)
        planes = tables.planes[: 3 * tables.size.width * tables.size.height].reshape(3, -1)
        points = np.take(planes, pixels, axis=1) * depth_m + tables.translation_m[:, None]
        points[:, points[2] <= 0] = np.nan
        u, v = rig.tactile.intrinsics.project(points.T).astype(np.float32).T
        return u, v


def make_alignment(section: AlignmentSection, rig: Rig) -> AlignmentModel:
    """Build the model that a preset asks for; `RigMismatchError` if neither the preset nor the rig has a pose."""
    (height, width), (tactile_height, tactile_width) = rig.proximity.intrinsics.shape, rig.tactile.intrinsics.shape
    if not rig.has_proximity:  # both images are the same
        section = AlignmentSection(model="rigid")
    rigid = section.model == "rigid"
    planes, table = np.empty(0, np.float32), np.empty(0, np.int32)
    translation: Float64Array = np.zeros(3)
    if rigid:
        T_t_p = np.linalg.inv(tactile_pose(section, rig))
        translation = np.asarray(T_t_p[:3, 3], np.float64)
        rays = ray_table(rig.proximity.intrinsics).astype(np.float64)
        homogeneous = np.concatenate([rays, np.ones((height, width, 1))], axis=2)
        planes = kernels.planes_of((homogeneous @ T_t_p[:3, :3].T).astype(np.float32))
    else:
        shapes = (height, width), (tactile_height, tactile_width)
        table = kernels.flat(homography_table(tactile_homography(section, rig), *shapes))
    lens, camera = lens_parameters(rig.tactile.intrinsics)
    return AlignmentModel(
        kernels.AlignmentTables(
            rigid,
            kernels.ImageSizes(width, height, tactile_width, tactile_height),
            np.float32(rig.proximity.depth_unit_m),
            np.float32(rig.tactile.depth_unit_m * section.depth_scale),
            np.float32(section.depth_offset_m),
            translation.astype(np.float32),
            planes,
            table,
            lens,
            camera,
        )
    )


def tactile_pose(section: AlignmentSection, rig: Rig) -> Float64Array:
    """Return ``T_p_t`` (4 x 4): the preset's own, or else the rig's; `RigMismatchError` if neither has one."""
    calibrated = section.rigid.T_proximity_tactile if rig.has_proximity else None
    pose = calibrated or rig.T_proximity_tactile
    if pose is None:
        raise RigMismatchError(UNKNOWN_POSE)
    return np.asarray(pose)


def tactile_homography(section: AlignmentSection, rig: Rig) -> Float64Array:
    """Return ``H_p_t`` (3 x 3): the preset's own, or else the one that the pose induces.

    For the frontal plane z = d in the proximity frame, ``H_t_p = K_t (R + t n^T / d) K_p^-1`` with
    ``T_t_p = [R | t]`` and n = (0, 0, 1) (Hartley and Zisserman, Multiple View Geometry, eq. 13.2). `RigMismatchError`
    if there is no pose, or the tactile camera lies in that plane.
    """
    if section.homography.H_p_t is not None:
        return np.asarray(section.homography.H_p_t)
    T_t_p = np.linalg.inv(tactile_pose(section, rig))
    plane = np.outer(T_t_p[:3, 3], (0.0, 0.0, 1.0 / section.homography.plane_distance_m))
    if abs(np.linalg.det(T_t_p[:3, :3] + plane)) < 1e-6:
        raise RigMismatchError(
            f"alignment.homography.plane_distance_m is {section.homography.plane_distance_m:g}, "
            "but the tactile camera lies in that plane; choose another distance or check the pose"
        )
    K_p, K_t = rig.proximity.intrinsics.camera_matrix(), rig.tactile.intrinsics.camera_matrix()
    H_p_t = np.linalg.inv(K_t @ (T_t_p[:3, :3] + plane) @ np.linalg.inv(K_p))
    return np.asarray(H_p_t / H_p_t[2, 2])


def homography_table(
    H_p_t: Float64Array, proximity_shape: tuple[int, int], tactile_shape: tuple[int, int]
) -> Int32Array:
    """Return the flat tactile pixel nearest to each proximity pixel's preimage; -1 outside the image or the horizon."""
    (height, width), (tactile_height, tactile_width) = proximity_shape, tactile_shape
    v, u = np.mgrid[:height, :width].astype(np.float64)
    x, y, w = np.einsum("ij,jvu->ivu", np.linalg.inv(H_p_t), np.stack([u, v, np.ones_like(u)]))
    centre_w = H_p_t[2] @ ((tactile_width - 1) / 2, (tactile_height - 1) / 2, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        tactile_u, tactile_v = np.floor(x / w + 0.5), np.floor(y / w + 0.5)
    inside = (w * centre_w > 0) & (tactile_u >= 0) & (tactile_u < tactile_width)
    inside &= (tactile_v >= 0) & (tactile_v < tactile_height)
    table = np.full(proximity_shape, -1, np.int32)
    table[inside] = (tactile_v[inside] * tactile_width + tactile_u[inside]).astype(np.int32)
    return table
