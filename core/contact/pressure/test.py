"""The pressure test: contact is where the membrane is curved less than tension and inflation would curve it.

At rest the inflation p and the tension T balance, p = T 2H, with the mean curvature H (Young-Laplace). Where an object
presses with q, the membrane is flatter: q = p - T 2H. The untouched frame gives p / T at each place, the free membrane
of the present frame the factor by which p / T has changed since, so a change of the inflation is no contact. The window
over which curvature is averaged follows from the noise of the camera.

The force follows from the balance of the membrane around a contact, see `surface.balance`, which needs slopes only.

Assumed: the same tension in all directions, no bending stiffness, no friction.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from ...errors import RigMismatchError
from ...model.arrays import BoolArray, Float32Array, Float64Array, IndexArray, Uint8Array
from ...model.clouds import valid_depth
from ...model.frames import SensorFrame
from ...model.patch import NO_CANDIDATES, Candidates, Found, Lazy, PressureFacts, Provenance
from ..contact_test import MASK_REASON, PIXEL_FIELDS, BiasLimits, ContactTest, DropReason, Steps
from .section import PressureSection

if TYPE_CHECKING:
    from ...preset import Preset
    from ..pixels import Pixels
    from .surface import Grid, Shape

#: Contact pressure exceeds its noise by this many standard deviations, and the membrane has moved by more, metres.
PRESSURE_SIGMAS, _MOVED_M = 3.0, 0.0007
#: Window of the curvature, cells: smallest and largest; that of the slopes; first window, before the noise is known.
_WINDOWS, _SLOPE_WINDOW = (1.5, 6.0), 1.5
#: Of the depth noise: what a single frame tells of it where it was not measured.
_GUESSED: Final = 2.0
#: The balance is drawn this far around a contact, cells, over a ramp of this width; the free membrane up to this far
#: around tells its tension.
_MARGIN, _RAMP, _REACH = 2.0, 3.0, 10.0
#: With two cameras, what the proximity camera sees farther behind the membrane is no contact, share of the distance.
_BOTH_SHARE: Final = 0.05
#: Error of the force by the model, share: tension that differs with direction and place.
_MODEL_SHARE: Final = 0.05
#: Largest share of a contact pressure in a contact that tells where it ends.
_QUANTILE: Final = 0.9


class PressureTest(ContactTest):
    """Contact where the membrane carries a pressure beside its inflation."""

    name = "pressure"
    sections = {"pressure": PressureSection}
    steps = {
        "shape": (*PIXEL_FIELDS, "noise", "pressure.noise"),
        "contact": ("pressure.limit", "pressure.share"),
        "clusters": ("pressure.min_area_mm2",),
        "force": ("pressure.gauge_pa", "pressure.gauge_sigma_pa"),
    }
    summary = "the membrane is curved less than its inflation would curve it; gives force; one camera suffices."
    note = "By the curvature since the untouched frame. Its window follows from the noise, so small contacts look wide."
    near_words = "carry a contact pressure"
    looser_words = "lower the pressure limit"
    drop_reasons = {
        Provenance.MASKED: MASK_REASON,
        Provenance.SMALL_CLUSTER: DropReason("the limit on small contacts", "lower the smallest contact area"),
    }
    needs_proximity = False
    needs_untouched = True

    def __init__(self, pixels: Pixels) -> None:
        super().__init__(pixels)
        self._rest: _Rest | None = None

    def find(self, frame: SensorFrame, preset: Preset, due: Steps) -> Found:
        """Return the contact in a frame; `RigMismatchError` without an untouched frame."""
        pixels = self.pixels
        if pixels.untouched is None:
            raise RigMismatchError(
                f"preset {preset.name!r} uses the contact test pressure, which compares with the untouched frame, and "
                "there is none; capture it while nothing touches the membrane"
            )
        if due("shape"):
            if self._rest is None:
                self._rest = _Rest(pixels, preset)
            self._now = _Now(self._rest, frame)
        rest, now = self._rest, self._now
        assert rest is not None
        if due("contact"):
            self._touching = now.contact(preset.pressure)
            self._seen = NO_CANDIDATES
            if self._touching.any():
                self._seen = pixels.candidates(frame, _BOTH_SHARE)
            inside = self._at_pixels(self._touching, frame, self._seen)
            self._pressed = Candidates(self._seen.pixels[inside], self._seen.points[inside])
        if due("clusters"):
            from ..outliers.clusters import without_small_clusters  # loads kernels

            self._contact = NO_CANDIDATES
            if len(self._pressed):
                camera = pixels.rig.proximity.intrinsics
                self._contact = without_small_clusters(self._pressed, camera, preset.pressure.min_area_mm2)
        if due("force"):
            touching = self._touching if len(self._contact) else np.zeros_like(self._touching)
            self._facts = now.facts(touching, preset, self._images(now.relative, self._contact, frame))
        groups = self._touching, self._seen, self._pressed, self._contact
        return Found(self._contact, lambda: self._provenance(frame, *groups), pressure=self._facts)

    def _at_pixels(self, cells: BoolArray, frame: SensorFrame, seen: Candidates) -> BoolArray:
        if not len(seen):
            return np.zeros(0, np.bool_)
        smooth = _enlarged(cells.astype(np.float32), self.pixels.rig.tactile.intrinsics.shape)
        return np.asarray(smooth.reshape(-1)[self.pixels.tactile_pixels(seen.pixels, frame)] > 0.5)

    def _images(self, cells: Float64Array, contact: Candidates, frame: SensorFrame) -> dict[str, Lazy[Float32Array]]:
        """Return values of cells on the pixels of both cameras and at points, by the fields of `PressureFacts`."""
        rig = self.pixels.rig
        on_membrane = Lazy(lambda: _enlarged(cells.astype(np.float32), rig.tactile.intrinsics.shape))

        def at(pixels: IndexArray) -> Float32Array:
            return on_membrane.get().reshape(-1)[self.pixels.tactile_pixels(pixels, frame)]

        def image() -> Float32Array:
            if not rig.has_proximity:
                return on_membrane.get()
            known = np.flatnonzero(valid_depth(frame.proximity_depth))
            found = np.full(rig.proximity.intrinsics.shape, np.nan, np.float32)
            found.reshape(-1)[known] = at(known)
            return found

        return {"relative": Lazy(image), "on_membrane": on_membrane, "at_points": Lazy(lambda: at(contact.pixels))}

    def _provenance(
        self, frame: SensorFrame, cells: BoolArray, seen: Candidates, pressed: Candidates, contact: Candidates
    ) -> Uint8Array:
        image = self.pixels.classify(frame)
        verdicts = image.reshape(-1)
        known = np.flatnonzero(verdicts == Provenance.CONTACT)
        inside = self._at_pixels(cells, frame, Candidates(known, np.empty((len(known), 3), np.float32)))
        verdicts[known] = np.where(inside, Provenance.MASKED, Provenance.OUTSIDE_TOLERANCE)
        verdicts[pressed.pixels] = Provenance.SMALL_CLUSTER
        verdicts[contact.pixels] = Provenance.CONTACT
        return image

    @classmethod
    def accepted_share(cls, preset: Preset, distance_m: float) -> float:
        """Return 0: no difference between the depths of two cameras counts."""
        return 0.0

    @classmethod
    def bias_limits(cls, preset: Preset, distance_m: float) -> BiasLimits:
        """Return no limits: there is no bias between two cameras."""
        return BiasLimits(float("inf"), float("inf"), "the pressure test compares no two cameras")


#: Twice the mean curvature of an inflated membrane, at least: the apex of one of 200 mm then stands out by 2.5 mm.
_MIN_CURVATURE_PER_M: Final = 1.0


class _Rest:
    """The untouched membrane, and the window that the noise asks for."""

    def __init__(self, pixels: Pixels, preset: Preset) -> None:
        from ..alignment import tactile_pose  # loads kernels
        from . import surface

        assert pixels.untouched is not None
        lens, tables = pixels.rig.tactile.intrinsics, pixels.alignment.tables
        self.unit_m, self.offset_m = float(tables.tactile_unit_m), float(preset.alignment.depth_offset_m)
        self.grid: Grid = surface.Grid.of(lens)
        self.turn = np.eye(3) if not pixels.rig.has_proximity else tactile_pose(preset.alignment, pixels.rig)[:3, :3]
        depth_m, share = surface.cells(pixels.untouched.tactile_depth, self.unit_m, self.offset_m)
        if not (share > 0).any():
            raise RigMismatchError(
                "the untouched frame has no tactile depth, so the contact test pressure has nothing to compare with; "
                "capture it again"
            )
        distance_m = float(np.median(depth_m[share > 0]))
        self.cell_m = surface.CELL_PX * distance_m / lens.fx
        self.noise_known = preset.noise is not None
        first = surface.fit(depth_m, share, _SLOPE_WINDOW)
        if preset.noise is not None:
            known = preset.noise.tactile
            self.density_m4 = known.density_m4(lens.fx) * (distance_m / known.distance_m) ** 6
        else:
            left = (depth_m - first.fit[0])[np.isfinite(first.fit[0]) & (share > 0)]
            spread_m = 1.48 * float(np.median(np.abs(left))) if len(left) else 0.0
            self.density_m4 = (_GUESSED * spread_m * self.cell_m) ** 2
        wide = surface.curvature(surface.fit(depth_m, share, 4.0), self.grid)
        curved = wide[np.isfinite(wide)]
        self.curvature_per_m = float(np.median(curved)) if len(curved) else math.nan
        if not self.curvature_per_m > _MIN_CURVATURE_PER_M:
            raise RigMismatchError(
                "the membrane is flat in the untouched frame, so no pressure can be told from its curvature; inflate "
                "it and capture the frame again"
            )
        wanted = preset.pressure.noise * self.curvature_per_m
        window = (self.bend_noise / wanted) ** (1 / 3) / self.cell_m
        self.window = min(max(window, _WINDOWS[0]), _WINDOWS[1])
        self.sigma_per_m = self.bend_noise / (self.window * self.cell_m) ** 3
        self.shape: Shape = surface.fit(depth_m, share, self.window)
        self.bulge_per_m = surface.curvature(self.shape, self.grid)

    @property
    def bend_noise(self) -> float:
        """Standard deviation of twice the mean curvature times the cube of the window's sigma, m^2."""
        return math.sqrt(self.density_m4 / (2 * math.pi))


class _Now:
    """The present membrane against the untouched one."""

    def __init__(self, rest: _Rest, frame: SensorFrame) -> None:
        from . import surface

        self._rest = rest
        self._depth_m, self._share = surface.cells(frame.tactile_depth, rest.unit_m, rest.offset_m)
        shape = surface.fit(self._depth_m, self._share, rest.window)
        self._shape, self.bulge_per_m = shape, surface.curvature(shape, rest.grid)
        with np.errstate(invalid="ignore", divide="ignore"):
            self._moved_m = rest.shape.fit[0] - shape.fit[0]
            ratio = np.where(rest.bulge_per_m > 0.2 * rest.curvature_per_m, self.bulge_per_m / rest.bulge_per_m, np.nan)
            self._sigma = rest.sigma_per_m / rest.bulge_per_m * shape.growth
        self.grown, self.relative = _against_free(ratio, self._sigma)

    def contact(self, section: PressureSection) -> BoolArray:
        """Return the cells that carry contact pressure, each contact down to a share of its largest."""
        import cv2

        with np.errstate(invalid="ignore", divide="ignore"):
            limit = np.maximum(section.limit, PRESSURE_SIGMAS * self._sigma / self.grown)
            pressed = (self.relative > limit) & (self._moved_m > _MOVED_M)
        count, labels = cv2.connectedComponents(pressed.view(np.uint8), connectivity=8)
        for number in range(1, count):
            own = labels == number
            pressed[own] = self.relative[own] >= section.share * np.quantile(self.relative[own], _QUANTILE)
        return np.asarray(pressed, np.bool_)

    def facts(self, touching: BoolArray, preset: Preset, images: dict[str, Lazy[Float32Array]]) -> PressureFacts:
        """Return map and force, that of all contacts together, in the proximity depth frame."""
        import cv2

        from . import surface

        rest, section = self._rest, preset.pressure
        force, sigma, at_rim = np.zeros(3), np.zeros(3), False
        if touching.any():
            slopes = surface.fit(self._depth_m, self._share, _SLOPE_WINDOW, curved=False).fit[0]
            depth_m = np.where(np.isfinite(slopes), slopes, self._shape.fit[0])
            away = cv2.distanceTransform((~touching).view(np.uint8), cv2.DIST_L2, 5)
            weight = np.clip(1 - (away - _MARGIN) / _RAMP, 0.0, 1.0)
            inner = surface.inner(np.isfinite(depth_m))
            at_rim = bool(((weight > 0) & ~inner).any())
            weight *= inner  # at the rim the clamp's pull ends the balance
            free = (away > _MARGIN) & (away < _MARGIN + _REACH) & np.isfinite(self.bulge_per_m)
            bulge = float(np.median(self.bulge_per_m[free])) if free.any() else math.nan
            bulge = bulge if bulge > 0 else math.nan  # where it is flat, nothing tells its tension
            air, pull = surface.balance(rest.grid.points(depth_m), weight)
            force = pull / bulge - air
            # tension from a few independent windows, slopes along the loop, and the model
            windows = max(np.count_nonzero(free) / (4 * math.pi * rest.window**2), 1.0)
            loop_m = rest.cell_m * 2 * math.sqrt(math.pi * np.count_nonzero(weight > 0))
            narrow_m3 = (_RAMP * rest.cell_m) ** 2 * math.sqrt(math.pi) * _SLOPE_WINDOW * rest.cell_m
            by_slopes = math.sqrt(rest.density_m4 * loop_m / narrow_m3) / bulge
            by_tension = np.abs(pull) / bulge * rest.sigma_per_m / bulge / math.sqrt(windows)
            by_model = _MODEL_SHARE * float(np.linalg.norm(force)) * (2.0 if at_rim else 1.0)
            sigma = np.sqrt(by_slopes**2 + by_tension**2 + by_model**2)
        turned, spread = 1e6 * rest.turn @ force, 1e6 * np.sqrt(rest.turn**2 @ sigma**2)
        usual = self._sigma[np.isfinite(self._sigma)]
        return PressureFacts(
            **images,
            relative_sigma=float(np.median(usual)) / self.grown if len(usual) and self.grown > 0 else math.nan,
            force_mm2=(float(turned[0]), float(turned[1]), float(turned[2])),
            force_sigma_mm2=(float(spread[0]), float(spread[1]), float(spread[2])),
            inflation_pa=section.gauge_pa,
            inflation_sigma_pa=section.gauge_sigma_pa,
            window_m=rest.window * rest.cell_m,
            curvature_growth=self.grown,
            at_rim=at_rim,
            noise_known=rest.noise_known,
        )


def _against_free(ratio: Float64Array, sigma: Float64Array) -> tuple[float, Float64Array]:
    """Return the growth of p / T in the free membrane, and 1 less each cell's ratio over it: the relative pressure."""
    import cv2

    free = np.isfinite(ratio)
    if not free.any():
        return 1.0, np.full_like(ratio, np.nan)
    grown = float(np.median(ratio[free]))
    for _ in range(3):
        if grown <= 0:
            break
        with np.errstate(invalid="ignore"):
            pressed = (1 - ratio / grown > 2 * sigma / grown) & free
        near = cv2.dilate(pressed.view(np.uint8), np.ones((5, 5), np.uint8)) > 0
        left = free & ~near
        if np.count_nonzero(left) < 0.1 * np.count_nonzero(free):
            break
        grown = float(np.median(ratio[left]))
    # without inflation nothing tells a contact pressure
    return grown, np.asarray(1 - ratio / grown) if grown > 0 else np.full_like(ratio, np.nan)


def _enlarged(cells: Float32Array, shape: tuple[int, int]) -> Float32Array:
    """Return an image of cells on pixels, interpolated; 0 or nan beyond the last whole cell."""
    import cv2

    from .surface import CELL_PX

    size = cells.shape[1] * CELL_PX, cells.shape[0] * CELL_PX
    image = np.asarray(cv2.resize(cells, size, interpolation=cv2.INTER_LINEAR), np.float32)
    if image.shape == shape:
        return image
    whole = np.full(shape, 0 if not np.isnan(cells).any() else np.nan, np.float32)
    whole[: image.shape[0], : image.shape[1]] = image
    return whole
