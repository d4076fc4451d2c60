"""The dent test, for rigs with a tactile camera only: the membrane has moved towards the camera since it was untouched.

The change of the tactile depth since the untouched frame is averaged over a few pixels. A dent is where it exceeds a
length, and what the measured noise explains. The rim of a dent does not touch the object, so its area is an upper
limit of the contact.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

import numpy as np

from ..errors import RigMismatchError
from ..model.arrays import BoolArray, Float32Array, Uint8Array
from ..model.frames import SensorFrame
from ..model.patch import NO_CANDIDATES, Candidates, Found, Provenance
from ..model.sections import Section, described
from .contact_test import MASK_REASON, PIXEL_FIELDS, BiasLimits, ContactTest, DropReason, Steps

if TYPE_CHECKING:
    from ..preset import Preset

#: Side of the square over which the change is averaged, pixels.
_SIDE_PX: Final = 7
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
    ] = 0.005
    min_area_mm2: Annotated[
        float,
        described(
            "Smallest dent area",
            "Connected groups of dented pixels with a smaller area are dropped. 0 keeps all.",
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
    steps = {"dent": (*PIXEL_FIELDS, "dent.limit_m", "noise"), "clusters": ("dent.min_area_mm2",)}
    summary = "the membrane has moved towards the camera since the untouched frame; for rigs with one camera."
    note = "Compares with the untouched frame. The rim of a dent counts, so the area is an upper limit."
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
        if due("dent"):
            seen = pixels.candidates(frame, np.inf)
            dented = (self._change_m(frame) > self._limit_m(preset)).reshape(-1)
            keep = dented[seen.pixels]
            self._dented, self._dent = Candidates(seen.pixels[keep], seen.points[keep]), dented
        if due("clusters"):
            from .outliers.clusters import without_small_clusters  # loads kernels

            self._contact = NO_CANDIDATES
            if len(self._dented):
                camera = pixels.rig.proximity.intrinsics
                self._contact = without_small_clusters(self._dented, camera, preset.dent.min_area_mm2)
        dented, large, contact = self._dent, self._dented, self._contact
        return Found(contact, lambda: _provenance(pixels.classify(frame), dented, large, contact))

    def _change_m(self, frame: SensorFrame) -> Float32Array:
        """Return the movement towards the camera, averaged over a square: float32 (H, W); nan where it is unknown."""
        import cv2  # on demand: presets and patches need no images

        pixels = self.pixels
        assert pixels.untouched is not None
        now = pixels.aligned(frame).measured_m
        before = pixels.alignment.align(frame.proximity_depth, pixels.untouched.tactile_depth, pixels.region).measured_m
        change = before - now
        known = np.isfinite(change)
        share = cv2.blur(known.astype(np.float32), (_SIDE_PX, _SIDE_PX))
        mean = cv2.blur(np.where(known, change, np.float32(0)), (_SIDE_PX, _SIDE_PX))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.where(known & (share > 0.5), mean / share, np.nan), np.float32)

    def _limit_m(self, preset: Preset) -> float:
        """Return the length that a dent must exceed: the preset's, or what the noise of two frames explains."""
        if preset.noise is None or preset.noise.tactile is None:
            return preset.dent.limit_m
        camera = preset.noise.tactile
        single = np.hypot(camera.white_m / _SIDE_PX, camera.correlated_m)
        return max(preset.dent.limit_m, float(_SIGMAS * np.sqrt(2) * single))

    @classmethod
    def accepted_share(cls, preset: Preset, distance_m: float) -> float:
        """Return 0: no difference between the depths of two cameras counts."""
        return 0.0

    @classmethod
    def bias_limits(cls, preset: Preset, distance_m: float) -> BiasLimits:
        """Return no limits: there is no bias between two cameras."""
        return BiasLimits(float("inf"), float("inf"), "the dent test compares no two cameras")


def _provenance(verdicts: Uint8Array, dented: BoolArray, large: Candidates, contact: Candidates) -> Uint8Array:
    """Write the verdicts of the steps over those of `Pixels.classify`."""
    pixels = verdicts.reshape(-1)
    seen = pixels == Provenance.CONTACT
    pixels[seen] = np.where(dented[seen], Provenance.MASKED, Provenance.OUTSIDE_TOLERANCE)
    pixels[large.pixels] = Provenance.SMALL_CLUSTER
    pixels[contact.pixels] = Provenance.CONTACT
    return verdicts
