"""Point clouds of patches: each where its method says the membrane is, over the relief of the scene."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from ...core.evaluation.metrics import truth_cloud
from ...core.methods.method import MethodPatch
from ...core.model.arrays import BoolArray, Float32Array, Uint16Array
from ...core.model.clouds import ray_table
from ...core.model.intrinsics import Intrinsics
from ...widgets.basics.colormaps import Theme, patch_index
from ...widgets.clouds.cloud_data import DepthCloud
from ..worker.results import Result
from .method_looks import CONTACT_ROW, FALSE_ROW, HIDDEN_ROW, MISSED_ROW, agreement_lut, method_lut

_IDENTITY = np.eye(4)
_MOST_COUNTS = 65534


class Drawing:
    """Makes the clouds of one frame, which share all but the patches.

    Parameters
    ----------
    result : Result
    theme : "light" or "dark"
    by_truth : bool
        Colour by the agreement with the frame's truth, which there must be, not by method.
    step : int
        Every how many rows and columns a point is drawn.
    """

    def __init__(self, result: Result, theme: Theme, by_truth: bool, step: int) -> None:
        frame, self._rig = result.frame, result.source.rig
        camera = self._rig.proximity
        self._theme, self._step, self._camera = theme, step, camera
        self._depth = np.ascontiguousarray(frame.proximity_depth[::step, ::step])
        self._rays = _coarse_rays(camera.intrinsics, step)
        self._range_m = result.rendered.depth_range_m
        near, far = (limit / camera.depth_unit_m for limit in self._range_m)
        context = patch_index(np.zeros(self._depth.shape, bool), self._depth, near, far)
        self._context = np.minimum(context, np.uint8(HIDDEN_ROW))
        self._truth = frame.truth if by_truth else None

    def cloud(self, name: str, patch: MethodPatch) -> DepthCloud:
        """Return a patch at its own depth; the scene around it ends where the depth colours end."""
        depth, rows = self._depth.copy(), self._context.copy()
        mask = self._coarse(patch.mask)
        rows[mask] = CONTACT_ROW
        if self._truth is not None:
            true = self._coarse(self._truth.contact)
            rows[mask & ~true] = FALSE_ROW
            rows[true & ~mask] = MISSED_ROW
            self._lift(depth, true & ~mask, truth_cloud(self._truth, self._rig).points)
        self._lift(depth, mask, patch.points)
        return DepthCloud(
            depth=depth,
            depth_unit_m=self._camera.depth_unit_m,
            rays=self._rays,
            lut=method_lut(name, self._theme) if self._truth is None else agreement_lut(self._theme),
            pose=_IDENTITY,
            index=rows,
            depth_range_m=self._range_m,
            count=len(patch.points) or int(np.count_nonzero(patch.mask)),
        )

    def _coarse(self, mask: BoolArray) -> BoolArray:
        return mask[:: self._step, :: self._step]

    def _lift(self, depth: Uint16Array, where: BoolArray, points: Float32Array) -> None:
        """Put pixels to the depth of the point that is projected nearest to each.

        Points need not be proximity pixels: those of tactile methods are another camera's.
        """
        points = points[points[:, 2] > 0]
        columns, rows = np.rint(self._camera.intrinsics.project(points) / self._step).astype(np.intp).T
        inside = (columns >= 0) & (columns < depth.shape[1]) & (rows >= 0) & (rows < depth.shape[0])
        if not inside.any() or not where.any():
            return
        known: Uint16Array = np.zeros(depth.shape, np.uint16)
        counts = np.clip(np.rint(points[:, 2] / self._camera.depth_unit_m), 1, _MOST_COUNTS)
        known[rows[inside], columns[inside]] = counts[inside].astype(np.uint16)
        _, labels = cv2.distanceTransformWithLabels(
            (known == 0).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
        )
        of_label = np.zeros(labels.max() + 1, np.uint16)
        of_label[labels[known > 0]] = known[known > 0]
        depth[where] = of_label[labels[where]]


@lru_cache(maxsize=4)
def _coarse_rays(intrinsics: Intrinsics, step: int) -> Float32Array:
    """Return the rays of every ``step``-th row and column, the same array each time."""
    return np.ascontiguousarray(ray_table(intrinsics)[::step, ::step])
