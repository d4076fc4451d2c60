"""The dent test, for rigs with a tactile camera only: the membrane has moved towards the camera since it was untouched.

The change of the tactile depth since the untouched frame is averaged over a few pixels. A dent is where it exceeds a
length, and what the measured noise explains. The skin around a contact moves too, the less the farther away it is, so
only what moved by more than a share of the deepest movement of its dent counts as contact.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

import numpy as np

from ..errors import RigMismatchError
from ..model.arrays import BoolArray, Float32Array, Uint8Array, Uint16Array
from ..model.clouds import valid_depth
from ..model.frames import SensorFrame
from ..model.patch import NO_CANDIDATES, Candidates, Found, Provenance
from ..model.sections import Section, described
from .contact_test import MASK_REASON, PIXEL_FIELDS, ContactTest, DropReason, Steps

if TYPE_CHECKING:
    from ..model.rig_noise import RigNoise
    from ..preset import Preset

#: Side of the square over which the change is averaged, pixels.
_SIDE_PX: Final = 11
#: The change exceeds the noise by this many standard deviations.
_SIGMAS: Final = 4.0


class DentSection(Section):
    """The dent test: movement of the membrane since the untouched frame."""

    limit_m: Annotated[
        float,
        described(
            "Smallest dent",
            "The membrane must have moved towards the camera by more than this since the untouched frame. A larger "
            "value gives a smaller patch.",
            unit="m",
            scale="log",
            slider=(0.0005, 0.03),
            step=0.0005,
            limits=(0.0, 0.1),
        ),
    ] = 0.004
    share: Annotated[
        float,
        described(
            "Share of deepest",
            "Contact is where a dent is deeper than this share of its deepest point. A larger value gives a smaller "
            "patch. 0 counts the whole dent.",
            slider=(0.0, 0.95),
            step=0.01,
            limits=(0.0, 1.0),
        ),
    ] = 0.6
    min_area_mm2: Annotated[
        float,
        described(
            "Smallest area",
            "Connected groups of pixels with a smaller area are dropped. 0 keeps all.",
            unit="mm2",
            slider=(0.0, 500.0),
            step=5.0,
            limits=(0.0, 1e6),
        ),
    ] = 50.0


class DentTest(ContactTest):
    """The tactile depth is smaller than in the untouched frame by more than a length."""

    name = "dent"
    sections = {"dent": DentSection}
    steps = {
        "change": PIXEL_FIELDS,
        "dent": ("dent.limit_m", "dent.share", "noise"),
        "clusters": ("dent.min_area_mm2",),
    }
    summary = "the membrane has moved towards the camera since the untouched frame; for rigs with one camera."
    note = "Compares with the untouched frame. The rim of a dent moves too, so the area is an estimate."
    near_words = "are dented"
    looser_words = "lower the smallest dent"
    drop_reasons = {
        Provenance.MASKED: MASK_REASON,
        Provenance.SMALL_CLUSTER: DropReason("the limit on small dents", "lower the smallest dent area"),
    }
    needs_proximity = False
    needs_untouched = True

    def find(self, frame: SensorFrame, preset: Preset, due: Steps) -> Found:
        """Return the contact in a frame; `RigMismatchError` without an untouched frame."""
        pixels = self.pixels
        if pixels.untouched is None:
            raise RigMismatchError(
                f"preset {preset.name!r} uses the contact test dent, which compares with the untouched frame, and "
                "there is none; capture it while nothing touches the membrane"
            )
        if due("change"):
            self._seen = pixels.candidates(frame, np.inf)
            self._moved_m = self._movement_m(pixels.untouched.tactile_depth, frame.tactile_depth)
        if due("dent"):
            dent = self._moved_m > dent_limit_m(preset)
            self._dent, deepest = dent.reshape(-1), _deepest(dent, self._moved_m, preset.dent.share).reshape(-1)
            keep = deepest[self.pixels.tactile_pixels(self._seen.pixels, frame)]
            self._dented = Candidates(self._seen.pixels[keep], self._seen.points[keep])
        if due("clusters"):
            from .outliers.clusters import without_small_clusters  # loads kernels

            self._contact = NO_CANDIDATES
            if len(self._dented):
                camera = pixels.rig.proximity.intrinsics
                self._contact = without_small_clusters(self._dented, camera, preset.dent.min_area_mm2)
        groups = self._seen, self._dented, self._contact
        dent = self._dent
        return Found(self._contact, lambda: self._provenance(frame, dent, *groups))

    def _provenance(
        self, frame: SensorFrame, dent: BoolArray, seen: Candidates, dented: Candidates, contact: Candidates
    ) -> Uint8Array:
        """Return the verdict on each pixel: those of `Pixels.classify`, then those of the steps."""
        image = self.pixels.classify(frame)
        verdicts = image.reshape(-1)
        known = np.flatnonzero(verdicts == Provenance.CONTACT)
        inside = dent[self.pixels.tactile_pixels(known, frame)]
        verdicts[known] = np.where(inside, Provenance.MASKED, Provenance.OUTSIDE_TOLERANCE)
        unmasked = seen.pixels[verdicts[seen.pixels] == Provenance.MASKED]
        verdicts[unmasked] = Provenance.RIM
        verdicts[dented.pixels] = Provenance.SMALL_CLUSTER
        verdicts[contact.pixels] = Provenance.CONTACT
        return image

    def _movement_m(self, before: Uint16Array, now: Uint16Array) -> Float32Array:
        """Return the movement towards the camera, averaged over a square: float32 (H, W); 0 where it is unknown."""
        import cv2  # on demand: presets and patches need no images

        known = valid_depth(before) & valid_depth(now)
        counts = np.where(known, before.astype(np.float32) - now, np.float32(0))
        sums, share = (np.asarray(cv2.blur(each, (_SIDE_PX, _SIDE_PX))) for each in (counts, known.astype(np.float32)))
        mean = np.divide(sums, share, out=np.zeros(known.shape, np.float32), where=known & (share > 0.5))
        return np.asarray(mean * self.pixels.alignment.tables.tactile_unit_m, np.float32)


def dent_limit_m(preset: Preset) -> float:
    """Return the length that a dent must exceed: the preset's, or what the measured noise explains."""
    return max(preset.dent.limit_m, noise_limit_m(preset.noise) if preset.noise is not None else 0.0)


def noise_limit_m(noise: RigNoise) -> float:
    """Return the largest movement that noise explains where the membrane is at rest: its fixed part cancels."""
    tactile = noise.tactile
    changing = 2.0 * tactile.changing_share  # of the variances of two frames
    return float(_SIGMAS * np.sqrt(changing) * np.hypot(tactile.white_m / _SIDE_PX, tactile.correlated_m))


def _deepest(dented: BoolArray, moved_m: Float32Array, share: float) -> BoolArray:
    """Return where each connected dent is deeper than a share of its deepest point."""
    import cv2

    count, image = cv2.connectedComponents(dented.view(np.uint8), connectivity=8)
    dents = np.asarray(image, np.intp)
    deepest_m = np.zeros(count, np.float32)
    np.maximum.at(deepest_m, dents[dented], moved_m[dented])
    return np.asarray(dented & (moved_m > share * deepest_m[dents]))
