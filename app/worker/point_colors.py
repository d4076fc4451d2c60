"""Colours of points that are no measure: a camera's own colours, and what a tactile pixel was used for."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from ...core.contact.alignment import AlignmentModel, make_alignment
from ...core.contact.pipeline import ContactPatch
from ...core.errors import TactuneError
from ...core.model.arrays import Float32Array, Uint8Array
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from ...core.model.provenance import Provenance
from ...core.preset import AlignmentSection
from ...widgets.basics.colormaps import AGREED_ROW, NO_COLOR_ROW, TOUCHING_ROW, USED_ROW, real_color_lut

_SAMPLES, _ROUNDS = 4096, 8
#: Root mean square error in 8-bit levels above which a palette no longer fits, e.g. after the light was switched on.
_WORST_ERROR = 12.0


class Palette:
    """The colours of a camera's image in few rows of a colour table, which both kinds of views draw equally fast.

    Clustered by k-means in RGB (Lloyd 1982) from a sample of the first image, and again only for an image that they no
    longer fit, so colours do not flicker.
    """

    def __init__(self) -> None:
        self._lut = real_color_lut(np.zeros((1, 3), np.uint8))
        self._rows = np.empty(0, np.uint8)

    def index(self, image: Uint8Array) -> tuple[Uint8Array, Uint8Array]:
        """Return the row of a colour table for every pixel of an RGB image (h, w, 3), uint8 (h, w), and the table."""
        flat = image.reshape(-1, 3)
        sample = flat[:: max(1, len(flat) // _SAMPLES)]
        if not len(self._rows) or self._error(sample) > _WORST_ERROR:
            self._learn(sample)
        return self._look_up(flat).reshape(image.shape[:2]), self._lut

    def _look_up(self, colors: Uint8Array) -> Uint8Array:
        """Find colours (N, 3) by their upper 5 bits."""
        red, green, blue = ((colors[:, channel] >> 3).astype(np.uint16) for channel in range(3))
        return np.asarray(self._rows[red << 10 | green << 5 | blue])

    def _error(self, colors: Uint8Array) -> float:
        wrong = self._lut[self._look_up(colors), :3].astype(np.float32) - colors
        return float(np.sqrt(np.mean(wrong**2)))

    def _learn(self, sample: Uint8Array) -> None:
        cv2.setRNGSeed(1)
        count = min(NO_COLOR_ROW, len(np.unique(sample, axis=0)))
        stop = (cv2.TERM_CRITERIA_MAX_ITER, _ROUNDS, 0.0)
        labels = np.zeros((len(sample), 1), np.int32)
        _, _, centres = cv2.kmeans(sample.astype(np.float32), count, labels, stop, 1, cv2.KMEANS_RANDOM_CENTERS)
        self._lut = real_color_lut(np.rint(centres).astype(np.uint8))
        steps = np.arange(32, dtype=np.float32) * 8 + 4
        grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        # |a - b|^2 without |a|^2, which does not change the nearest
        distances = (centres**2).sum(axis=1) - 2 * grid @ centres.T
        self._rows = distances.argmin(axis=1).astype(np.uint8)


def tactile_use(frame: SensorFrame, patch: ContactPatch, section: AlignmentSection, rig: Rig) -> Uint8Array:
    """Return what each tactile pixel was used for, as rows of `tactile_use_lut`: uint8 (H, W) of the tactile image.

    A tactile pixel is used by the proximity points that the alignment projects onto it; if several do, contact counts
    first. Pixels between neighbouring projected points take the use of their neighbours.
    """
    used = np.zeros(frame.tactile_depth.shape, np.uint8)
    try:
        model = alignment_model(section, rig)
    except TactuneError:
        return used
    verdicts = patch.provenance.reshape(-1)
    pixels = np.flatnonzero(valid_depth(frame.proximity_depth))
    depth_m: Float32Array = frame.proximity_depth.reshape(-1)[pixels] * np.float32(rig.proximity.depth_unit_m)
    u, v = model.tactile_pixels(pixels, depth_m, rig)
    height, width = frame.tactile_depth.shape
    inside = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    places = np.rint(v[inside]).astype(np.int64) * width + np.rint(u[inside]).astype(np.int64)
    uses = _USE_OF[verdicts[pixels[inside]]]
    for use in (USED_ROW, AGREED_ROW, TOUCHING_ROW):
        used.reshape(-1)[places[uses == use]] = use
    step = int(np.ceil(rig.tactile.intrinsics.fx / rig.proximity.intrinsics.fx))
    return np.where(used > 0, used, cv2.dilate(used, np.ones((2 * step + 1, 2 * step + 1), np.uint8)))


@lru_cache(maxsize=2)
def alignment_model(section: AlignmentSection, rig: Rig) -> AlignmentModel:
    """Return `make_alignment`, remembered."""
    return make_alignment(section, rig)


#: The use of a tactile pixel by a proximity pixel of each verdict; 0: it was not compared.
_USE_OF = np.zeros(len(Provenance), np.uint8)
_USE_OF[Provenance.OUTSIDE_TOLERANCE] = USED_ROW
_USE_OF[[Provenance.MASKED, Provenance.OUTLIER, Provenance.SMALL_CLUSTER, Provenance.RIM]] = AGREED_ROW
_USE_OF[Provenance.CONTACT] = TOUCHING_ROW
