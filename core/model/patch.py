"""The contact patch: what the pipeline returns, computed as far as it is read."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import Any, Final, Generic, NamedTuple, TypeVar

import numpy as np

from .arrays import BoolArray, Float32Array, Float64Array, IndexArray, Uint8Array
from .clouds import connected_groups, pixel_areas_m2
from .files import finite_or_none
from .frames import Rig


class Provenance(IntEnum):
    """The verdict on one proximity pixel, in the order of the tests; RIM, not of all tests, came last."""

    NO_PROXIMITY_DEPTH = 0
    OUTSIDE_REGION = 1
    OUTSIDE_RANGE = 2
    NO_TACTILE_DEPTH = 3
    OUTSIDE_TOLERANCE = 4
    MASKED = 5
    OUTLIER = 6
    SMALL_CLUSTER = 7
    CONTACT = 8
    RIM = 9

    @property
    def label(self) -> str:
        """A short name for legends."""
        return self.name.replace("_", " ").lower()

    @property
    def explanation(self) -> str:
        """One sentence for the person who asks why."""
        return _EXPLANATIONS[self]


_EXPLANATIONS = {
    Provenance.NO_PROXIMITY_DEPTH: "Dropped: the proximity camera measured no depth here.",
    Provenance.OUTSIDE_REGION: "Dropped: outside the region of interest.",
    Provenance.OUTSIDE_RANGE: "Dropped: the proximity depth is outside the working range.",
    Provenance.NO_TACTILE_DEPTH: "Dropped: the tactile camera has no depth where this point would be.",
    Provenance.OUTSIDE_TOLERANCE: "Dropped: membrane and object are too far apart here.",
    Provenance.MASKED: "Dropped: the colour lies in the mask's colour range (Tune > Mask).",
    Provenance.OUTLIER: "Dropped: the point lies unusually far from its neighbours, or has too few.",
    Provenance.SMALL_CLUSTER: "Dropped: its connected group is smaller than the smallest contact kept.",
    Provenance.CONTACT: "Kept: the membrane touches the object here.",
    Provenance.RIM: "Dropped: beside the contact, where the membrane has left the object; contact ends further in.",
}


T = TypeVar("T")


class Lazy(Generic[T]):
    """A value that is computed once, when it is first read; safe to read from any thread."""

    def __init__(self, compute: Callable[[], T]) -> None:
        self._compute: Callable[[], T] | None = compute
        self._lock = threading.Lock()

    def get(self) -> T:
        with self._lock:
            if self._compute is not None:
                self._value = self._compute()
                self._compute = None
            return self._value


@dataclass(frozen=True, eq=False)
class AlignedDepth:
    """Both sides of the tolerance test by proximity pixel (H, W), metres; nan where there is none."""

    #: dp: where the tactile camera would see the proximity point (rigid), or the proximity depth itself (homography).
    expected_m: Float32Array
    measured_m: Float32Array  # dt: the tactile depth there, after scale and offset

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> AlignedDepth:
        """Return two unwritten images."""
        return cls(np.empty(shape, np.float32), np.empty(shape, np.float32))


def relative_difference(expected_m: Float32Array, measured_m: Float32Array) -> Float32Array:
    """Return ``(dp - dt) / dp``, as histogram and pictures show it; the kernels' `within_tolerance` tests it."""
    return np.asarray((expected_m - measured_m) / expected_m, np.float32)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Pixels that may be contact, with their points."""

    pixels: IndexArray  # (N,): Flat proximity pixel numbers, ascending
    points: Float32Array  # (N, 3): Metres, proximity depth frame

    def __len__(self) -> int:
        return len(self.pixels)

    def mask(self, shape: tuple[int, int]) -> BoolArray:
        image = np.zeros(shape, np.bool_)
        image.reshape(-1)[self.pixels] = True
        return image


NO_CANDIDATES: Final = Candidates(np.empty(0, np.intp), np.empty((0, 3), np.float32))


#: A contact is doubtful below this probability that the membrane touches.
SURE: Final = 0.9


#: A force is shown as an arrow from this many of its standard deviations on.
_FORCE_SIGMAS: Final = 2.0


class Doubt(NamedTuple):
    """How sure a contact or a patch is."""

    touch_probability: float  # That the membrane touches there
    boundary_error_mm: float  # Expected error of its boundary; nan if the contact test cannot tell
    reasons: tuple[str, ...] = ()  # What is wrong, in words

    def record(self) -> dict[str, Any]:
        """Return the doubt for JSON; None for a number that is not known."""
        error_mm = finite_or_none(self.boundary_error_mm)
        return {
            "touch_probability": round(self.touch_probability, 4),
            "boundary_error_mm": None if error_mm is None else round(error_mm, 3),
            "doubt": list(self.reasons),
        }


_NO_DOUBT: Final = Doubt(1.0, math.nan)
#: Tells the doubt about one contact of a frame.
DoubtOf = Callable[[Candidates], Doubt]


@dataclass(frozen=True)
class Contact:
    """One connected part of a patch."""

    area_mm2: float  # Projected on the plane across the optical axis
    centroid_m: tuple[float, float, float]  # Mean of its points, metres, proximity depth frame
    doubt: Doubt
    members: IndexArray = field(repr=False, compare=False)  # Which points of the patch are its own


class Boundary(NamedTuple):
    """What the membrane test knows of the boundary of contact."""

    error_m: float  # Expected error; nan without contact
    unseen_share: float  # That borders on cells without depth
    noise_ratio: float  # Noise in contact as a multiple of what was measured


@dataclass(frozen=True, eq=False)
class MembraneFacts:
    """What the membrane test measured in a frame besides contact."""

    bias_m: float  # Proximity less tactile depth on the same surface, as the test subtracted it, metres
    firm_m2: float  # Area of firm contact that proves the bias; 0 if it follows from the rig or from prints
    bias_known: bool  # Whether firm contact, the measured rig or prints tell the bias; without them it is assumed
    bias_seen: bool  # Whether prints tell it in this frame
    bias_sigma_m: float  # Its standard deviation
    bias_change_m: float  # What prints read beyond the rig's measured bias; 0 where they agree, or without prints
    missed_parts: bool  # Whether parts of contact were added that only a larger bias shows
    curvature_per_m: float  # Twice the mean curvature of the free membrane as measured; nan if it cannot be measured
    used_curvature_per_m: float  # The one that the test used
    #: (H, W): The membrane's gap to the object in equilibrium, along the normal; nan where it is not computed.
    gap_m: Lazy[Float32Array]
    #: (N,): Proximity less tactile depth as measured at each point, less ``bias_m``; nan where one is missing.
    difference_m: Lazy[Float32Array]
    tactile_weight: float  # In the depth of the points, 0 to 1; the proximity depth has the rest
    boundary: Lazy[Boundary]


@dataclass(frozen=True, eq=False)
class PressureFacts:
    """What the pressure test measured in a frame besides contact."""

    #: Contact pressure as a share of the inflation, averaged over the window; nan where it is unknown: on the
    #: proximity pixels (H, W), on the tactile pixels, and at the points of the patch (N,).
    relative: Lazy[Float32Array]
    on_membrane: Lazy[Float32Array]
    at_points: Lazy[Float32Array]
    #: Contact pressure over its standard deviation at flat pixels of the patch, in the better of two windows.
    sigmas_at: Callable[[IndexArray], Float64Array]
    relative_sigma: float  # Standard deviation of the contact pressure; nan where nothing is seen
    #: Force of the object on the membrane over the inflation, mm^2, in the proximity depth frame, with the standard
    #: deviations; 0 without contact, nan if the free membrane around the contact is not seen.
    force_mm2: tuple[float, float, float]
    force_sigma_mm2: tuple[float, float, float]
    inflation_pa: float  # 0: not known
    inflation_sigma_pa: float
    window_m: float  # Sigma of the window over which curvature is averaged
    edge_error_m: Callable[[IndexArray], float]  # Error of the edge of a contact at flat pixels of the patch
    curvature_growth: float  # Of the free membrane since it was untouched, as a factor: by inflation and by the press
    at_rim: bool  # Whether a contact is so near the rim, or a part without depth, that its surroundings are cut off
    agrees: bool  # Whether area times pressure gives the force, too, within its standard deviations
    noise_known: bool  # Whether the noise was measured with the rig

    @property
    def force_n(self) -> tuple[float, float, float] | None:
        """Force in newtons; None if the inflation is not known."""
        return self._newtons(self.force_mm2) if self.inflation_pa > 0 else None

    @property
    def force_sigma_n(self) -> tuple[float, float, float] | None:
        """Standard deviations of the force in newtons; None if the inflation is not known."""
        if self.inflation_pa <= 0:
            return None
        share = self.inflation_sigma_pa / self.inflation_pa
        both = zip(self.force_mm2, self.force_sigma_mm2, strict=True)
        x, y, z = (math.hypot(sigma, share * force) for force, sigma in both)
        return self._newtons((x, y, z))

    @property
    def strength(self) -> tuple[float, float]:
        """Magnitude of the force and its standard deviation: newtons, or mm^2 where the inflation is not known."""
        force, sigma = self.force_n or self.force_mm2, self.force_sigma_n or self.force_sigma_mm2
        size = math.hypot(*force)
        along = (each * spread for each, spread in zip(force, sigma, strict=True))
        return size, math.hypot(*along) / size if size else math.hypot(*sigma)

    def words(self) -> str:
        """Return magnitude and standard deviation of the force with their unit; empty where they are not known."""
        size, sigma = self.strength
        digits, unit = (0, "mm²") if self.inflation_pa <= 0 else (2 if size < 10 else 1, "N")
        return f"{size:,.{digits}f} ± {sigma:,.{digits}f} {unit}" if math.isfinite(size) else ""

    def _newtons(self, area_mm2: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (1e-6 * self.inflation_pa * each for each in area_mm2)
        return x, y, z

    def by_point(self) -> dict[str, Float32Array]:
        """Return the contact pressure at the points of the patch by name, (N,): as a share, and in pascals if known."""
        relative = self.at_points.get()
        pascals = {"pressure_pa": relative * np.float32(self.inflation_pa)} if self.inflation_pa > 0 else {}
        return {"relative_pressure": relative, **pascals}

    def record(self) -> dict[str, Any]:
        """Return force and inflation for JSON; None for what is not known."""
        force_n, sigma_n = self.force_n, self.force_sigma_n
        return {
            "relative_force_mm2": [finite_or_none(each) for each in self.force_mm2],
            "relative_force_sigma_mm2": [finite_or_none(each) for each in self.force_sigma_mm2],
            "force_n": None if force_n is None else [finite_or_none(each) for each in force_n],
            "force_sigma_n": None if sigma_n is None else [finite_or_none(each) for each in sigma_n],
            "inflation_pa": self.inflation_pa or None,
        }


@dataclass(frozen=True, eq=False)
class Found:
    """What a contact test found in a frame; the last three fields are those of `ContactPatch`."""

    contact: Candidates
    make_provenance: Callable[[], Uint8Array]  # Computes the verdict on each pixel, uint8 (H, W), when it is read
    skipped: tuple[str, ...] = ()
    membrane: MembraneFacts | None = None
    pressure: PressureFacts | None = None


@dataclass(eq=False, repr=False)
class ContactPatch:
    """Where the membrane touches the object, and why every other pixel was dropped.

    Provenance, mask and aligned depths are computed from the frame's images when they are first read,
    so these images must not be overwritten while a patch is in use.

    Attributes
    ----------
    sequence : int
        The frame's number.
    points : float32, shape (N, 3)
        C-contiguous, metres, proximity depth frame, in row-major pixel order. A later frame does not overwrite the
        array: it lives as long as somebody holds it. Do not write into it, because the same array is returned again for
        an unchanged frame.
    made_provenance, made_aligned, made_mask
        What `provenance`, `aligned` and `mask` return, or compute first; without a mask it follows from the provenance.
    rig : Rig
    stage_ms : mapping of str to float
        Milliseconds of each step of the contact test; 0 for a step that was cached or skipped.
    skipped : tuple of str
        What this frame did not need, in words, such as "no candidates".
    averaged_frames : int
        Number of frames over which depth was averaged, this one included.
    membrane : MembraneFacts or None
        None for another contact test, and where both depths are nowhere near each other.
    doubt_of : DoubtOf
    pressure : PressureFacts or None
        None for another contact test.
    mask_colors : Lazy of uint8, shape (H, W, 3), or None
        The colours that the mask was compared with, where prints are found again in other light than before.
    """

    sequence: int
    points: Float32Array
    made_provenance: Uint8Array | Lazy[Uint8Array]
    made_aligned: AlignedDepth | Lazy[AlignedDepth]
    rig: Rig
    stage_ms: Mapping[str, float]
    skipped: tuple[str, ...] = ()
    made_mask: Lazy[BoolArray] | None = None
    averaged_frames: int = 1
    membrane: MembraneFacts | None = None
    doubt_of: DoubtOf = lambda contact: _NO_DOUBT
    pressure: PressureFacts | None = None
    mask_colors: Lazy[Uint8Array] | None = None

    @property
    def provenance(self) -> Uint8Array:
        """Uint8 (H, W), values of `Provenance`."""
        return self.made_provenance.get() if isinstance(self.made_provenance, Lazy) else self.made_provenance

    @property
    def aligned(self) -> AlignedDepth:
        """Both sides of the tolerance test."""
        return self.made_aligned.get() if isinstance(self.made_aligned, Lazy) else self.made_aligned

    @cached_property
    def mask(self) -> BoolArray:
        """Bool (H, W), True in contact; its i-th True pixel belongs to ``points[i]``."""
        return self.made_mask.get() if self.made_mask is not None else np.asarray(self.provenance == Provenance.CONTACT)

    @cached_property
    def relative_difference(self) -> Float32Array:
        """Float32 (H, W), what the tolerance test compares with t; nan where a depth is missing."""
        return relative_difference(self.aligned.expected_m, self.aligned.measured_m)

    @cached_property
    def area_mm2(self) -> float:
        """Area of the patch, projected on the plane across the optical axis."""
        return float(pixel_areas_m2(self.points[:, 2], self.rig.proximity.intrinsics).sum() * 1e6)

    @cached_property
    def contacts(self) -> tuple[Contact, ...]:
        """The 8-connected parts of the patch, the largest first."""
        pixels = np.flatnonzero(self.mask)
        if not len(pixels):
            return ()
        labels = connected_groups(pixels, self.mask.shape[1])
        areas_mm2 = 1e6 * pixel_areas_m2(self.points[:, 2], self.rig.proximity.intrinsics)
        total_mm2, size = (np.bincount(labels, weights) for weights in (areas_mm2, None))
        sums = np.stack([np.bincount(labels, self.points[:, axis]) for axis in range(3)], axis=1)
        centroids = sums / size[:, None]
        members = np.split(np.argsort(labels, kind="stable"), np.cumsum(size)[:-1])
        return tuple(
            Contact(float(total_mm2[i]), (x, y, z), self.doubt_of(Candidates(pixels[own], self.points[own])), own)
            for i in np.argsort(-total_mm2, kind="stable")
            for (x, y, z), own in [(centroids[i].tolist(), members[i])]
        )

    @cached_property
    def doubt(self) -> Doubt:
        """The doubt about the patch: that of its surest contact, their mean boundary error and all their reasons."""
        if not self.contacts:
            return self.doubt_of(NO_CANDIDATES)
        doubts, areas = [each.doubt for each in self.contacts], [each.area_mm2 for each in self.contacts]
        return Doubt(
            max(each.touch_probability for each in doubts),
            float(np.average([each.boundary_error_mm for each in doubts], weights=areas)),
            tuple(dict.fromkeys(reason for each in doubts for reason in each.reasons)),
        )

    @property
    def force_n(self) -> tuple[float, float, float] | None:
        """Force of the object on the membrane, newtons; None for another contact test or an unknown inflation."""
        return None if self.pressure is None else self.pressure.force_n

    @cached_property
    def pressure_centre_m(self) -> Float64Array | None:
        """Where the force acts: the mean of the points, weighted by their contact pressure; None without contact."""
        if self.pressure is None or not len(self.points):
            return None
        weights = np.fmax(self.pressure.at_points.get(), 1e-6)
        return np.asarray(np.average(self.points.astype(np.float64), axis=0, weights=weights))

    @property
    def force_arrow_m(self) -> Float64Array | None:
        """Centre of pressure and tip of the force's arrow, (2, 3), metres; None where no force exceeds its noise.

        The arrow is as long as the radius of the disc on which the inflation presses with that force.
        """
        if self.pressure is None or (centre := self.pressure_centre_m) is None:
            return None
        size, sigma = self.pressure.strength
        if not size > _FORCE_SIGMAS * sigma:
            return None
        force_mm2 = np.array(self.pressure.force_mm2)
        return np.stack([centre, centre + 1e-3 * force_mm2 / math.sqrt(math.pi * float(np.linalg.norm(force_mm2)))])

    @property
    def pressure_pa(self) -> Float32Array | None:
        """Float32 (H, W), the contact pressure, nan where it is unknown; None as for `force_n`."""
        if self.pressure is None or self.pressure.inflation_pa <= 0:
            return None
        return self.pressure.relative.get() * np.float32(self.pressure.inflation_pa)

    def doubt_by_point(self) -> dict[str, Float32Array]:
        """Return the numbers of the `Doubt` about each point's contact by name, float32 (N,)."""
        doubts = {name: np.zeros(len(self.points), np.float32) for name in Doubt._fields[:2]}
        for contact in self.contacts:
            for name, values in doubts.items():
                values[contact.members] = getattr(contact.doubt, name)
        return doubts

    @cached_property
    def centroid_m(self) -> tuple[float, float, float] | None:
        """Mean of the points in metres, or None for an empty patch."""
        if len(self.points) == 0:
            return None
        x, y, z = np.ascontiguousarray(self.points.T, np.float64).mean(axis=1)  # in a fifth of the time of axis 0
        return float(x), float(y), float(z)
