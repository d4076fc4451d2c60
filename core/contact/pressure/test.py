"""The pressure test: contact is where the membrane is curved less than tension and inflation would curve it.

At rest the inflation p and the tension T balance, p = T 2H, with the mean curvature H (Young-Laplace). Where an object
presses with q, the membrane is flatter: q = p - T 2H. The untouched frame gives p / T at each place, the free membrane
of the present frame the factor by which p / T has changed since, so a change of the inflation is no contact. The window
over which curvature is averaged follows from the noise of the camera. Where contact ends, `_Now.contact` explains.

The force follows from the balance of the membrane around a contact, see `surface.balance`, which needs slopes only.

Assumed: the same tension in all directions, no bending stiffness, no friction.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from ...errors import RigMismatchError
from ...model.arrays import (
    BoolArray,
    Float32Array,
    Float64Array,
    IndexArray,
    Int32Array,
    Uint8Array,
    Uint16Array,
    median,
)
from ...model.clouds import valid_depth
from ...model.frames import SensorFrame
from ...model.patch import NO_CANDIDATES, Candidates, Found, Lazy, PressureFacts, Provenance
from ..contact_test import MASK_REASON, PIXEL_FIELDS, ContactTest, DropReason, Steps
from .section import PressureSection

if TYPE_CHECKING:
    from ...preset import Preset
    from ..pixels import Pixels
    from .surface import Cells, Grid, Shape

#: In contact the pressure exceeds this many standard deviations in both of two windows, or, where no cell around does,
#: in the wider one, and the second number of them in the finer; the membrane has moved by more than the third, metres.
PRESSURE_SIGMAS, _LEAST_SIGMAS, _MOVED_M = 3.5, 2.0, 0.0007
#: Window of the curvature, cells: smallest and largest; that of the slopes and of the edge of contact.
_WINDOWS, _FINE_WINDOW = (1.5, 6.0), 1.3
#: Near the rim, windows are cut, and other errors than noise grow: the limit grows by this power of the noise's growth.
_CUT_POWER: Final = 4
#: How flat the membrane is, at the edge of contact, is limited to this range and averaged over this window, cells: an
#: edge of the object bends it far more than a face does.
_FLATNESS, _EDGE_WINDOW = (-0.75, 1.8), 1.25
_EDGE: Final = math.hypot(_FINE_WINDOW, _EDGE_WINDOW)
#: A step of the flatness, from the membrane to this quantile inside, that puts the edge of contact at the preset's
#: flatness. A smaller step, as on a flat object, puts it in proportion.
_STEP, _PLATEAU = 1.833, 0.7
#: Error of the edge of contact, share of its window: at least, and for each share of the flatness by which noise bends
#: the membrane; noise bends by this share of the deviation of twice the mean curvature, in units of the flatness. Of a
#: contact too small to look flat, share of the window of the curvature.
_OF_EDGE, _PER_BEND, _NOISE_BENDS, _OF_WINDOW = 0.5, 1.0, 0.886, 0.75
#: Of the depth noise: what a single frame tells of it where it was not measured.
_GUESSED: Final = 2.0
#: Past a deep dent the camera sees the membrane behind it. Contact lies at most this many cells farther than contact in
#: the same cell, plus this slope times the way from contact beside it, which is followed in steps of these cells.
_BEHIND, _STEEP, _PAST = 2.0, 1.0, (1, 1, 2, 2, 2, 2, 2)
_NOWHERE_M: Final = 1000.0  # Farther than any depth
#: The balance is drawn this far around a contact, cells, over a ramp of this width; the free membrane up to this far
#: around tells its tension.
_MARGIN, _RAMP, _REACH = 2.0, 3.0, 10.0
#: With two cameras, what the proximity camera sees farther behind the membrane is no contact, share of the distance.
_BOTH_SHARE: Final = 0.05
#: Error of the force by the model, share: tension that differs with direction and place.
_MODEL_SHARE: Final = 0.05
#: The force and the sum of area times pressure differ by less than this many standard deviations of the force.
_APART_SIGMAS: Final = 2.5
#: A contact with fewer flat cells is too small to look flat. Levels: the highest of what looks flat elsewhere; and that
#: of what does not, between flat cells.
_SMALL_CELLS, _OUTSIDE, _INSIDE = 4, -0.1, 0.1
#: Beyond this many standard deviations a cell tells nothing of the free membrane, which has at least this quantile.
_CUT, _FREE_QUANTILE = 2.5, 0.75


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
    smallest_field = "pressure.min_area_mm2"
    looser_words = "lower the pressure limit"
    drop_reasons = {
        Provenance.MASKED: MASK_REASON,
        Provenance.SMALL_CLUSTER: DropReason("the limit on small contacts", "lower the smallest contact"),
    }
    needs_proximity = False
    needs_untouched = True

    def __init__(self, pixels: Pixels) -> None:
        super().__init__(pixels)
        self._rest: _Rest | None = None

    def find(self, frame: SensorFrame, preset: Preset, due: Steps) -> Found:
        """Return the contact in a frame; `RigMismatchError` without an untouched frame."""
        from ..outliers.clusters import in_large_cluster, keep  # loads kernels

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
            self._inside = now.contact(preset.pressure)
            self._touching = self._inside > 0
            self._farthest = now.farthest(self._touching)
            self._seen = NO_CANDIDATES
            if self._touching.any():
                rows, columns = rest.grid.part(self._touching)[0].pixels
                within = None if pixels.rig.has_proximity else (columns.start, rows.start, columns.stop, rows.stop)
                self._seen = pixels.candidates(frame, _BOTH_SHARE, within)
            places = pixels.tactile_pixels(self._seen.pixels, frame)
            inside = self._in_contact(self._inside, self._farthest, frame)[places]
            self._pressed, self._places = keep(self._seen, inside), places[inside]
        if due("clusters"):
            pressed, camera, min_mm2 = self._pressed, pixels.rig.proximity.intrinsics, preset.pressure.min_area_mm2
            large = in_large_cluster(pressed.points[:, 2], pressed.pixels, camera, min_mm2)
            self._contact, self._kept = keep(pressed, large), self._places[large]
        if due("force"):
            held = np.zeros_like(self._touching)
            held.reshape(-1)[rest.numbers[self._kept]] = True
            touching = _parts_with(self._touching, held)
            self._facts = self._facts_of(now, touching, self._contact, frame, preset.pressure)
        groups = self._inside, self._farthest, self._seen, self._pressed, self._contact
        return Found(self._contact, lambda: self._provenance(frame, *groups), pressure=self._facts)

    def _in_contact(self, cells: Float64Array, farthest: Float32Array, frame: SensorFrame) -> BoolArray:
        """Return at which tactile pixels, flat, a level of the cells is above 0 and the depth is not beyond another."""
        assert self._rest is not None
        counts = frame.tactile_depth
        inside = np.zeros(counts.shape, np.bool_)
        if (cells > 0).any():
            part, own = self._rest.grid.part(cells > 0)
            near = counts[part.pixels] < part.on_pixels(farthest[own])
            inside[part.pixels] = near & (part.on_pixels(cells[own]) > 0)
        return inside.reshape(-1)

    def _facts_of(
        self, now: _Now, touching: BoolArray, contact: Candidates, frame: SensorFrame, section: PressureSection
    ) -> PressureFacts:
        """Return map and force, that of all contacts together, in the proximity depth frame."""
        assert self._rest is not None
        rig, rest, relative, sigmas = self.pixels.rig, self._rest, now.relative, now.sigmas.reshape(-1)
        least_error = now.least_error  # of this preset, also if it is asked for when another is in use
        force, sigma, at_rim, agrees = now.force(touching)
        turned, spread = 1e6 * rest.turn @ force, 1e6 * np.sqrt(rest.turn**2 @ sigma**2)

        def relative_on_membrane() -> Float32Array:
            found = np.full(rig.tactile.intrinsics.shape, np.nan, np.float32)
            found[rest.grid.pixels] = rest.grid.on_pixels(relative)
            return found

        on_membrane = Lazy(relative_on_membrane)

        def at(pixels: IndexArray) -> Float32Array:
            return on_membrane.get().reshape(-1)[self.pixels.tactile_pixels(pixels, frame)]

        def sigmas_at(pixels: IndexArray) -> Float64Array:
            return sigmas[rest.numbers[self.pixels.tactile_pixels(pixels, frame)]]

        def edge_error_m(pixels: IndexArray) -> float:
            return now.edge_error_m(rest.numbers[self.pixels.tactile_pixels(pixels, frame)], least_error)

        def image() -> Float32Array:
            if not rig.has_proximity:
                return on_membrane.get()
            known = np.flatnonzero(valid_depth(frame.proximity_depth))
            found = np.full(rig.proximity.intrinsics.shape, np.nan, np.float32)
            found.reshape(-1)[known] = at(known)
            return found

        return PressureFacts(
            relative=Lazy(image),
            on_membrane=on_membrane,
            at_points=Lazy(lambda: at(contact.pixels)),
            sigmas_at=sigmas_at,
            relative_sigma=median(now.sigma[::2, ::2]),
            force_mm2=(float(turned[0]), float(turned[1]), float(turned[2])),
            force_sigma_mm2=(float(spread[0]), float(spread[1]), float(spread[2])),
            inflation_pa=section.gauge_pa,
            # a press makes the free membrane rounder; where it is flatter, there is less inflation or more tension
            inflation_sigma_pa=math.hypot(section.gauge_sigma_pa, max(1 - now.grown, 0.0) * section.gauge_pa),
            window_m=rest.window * rest.cell_m,
            edge_error_m=edge_error_m,
            curvature_growth=now.grown,
            at_rim=at_rim,
            agrees=agrees,
            noise_known=rest.noise_known,
        )

    def _provenance(
        self,
        frame: SensorFrame,
        cells: Float64Array,
        farthest: Float32Array,
        seen: Candidates,
        pressed: Candidates,
        contact: Candidates,
    ) -> Uint8Array:
        image = self.pixels.classify(frame)
        verdicts = image.reshape(-1)
        known = np.flatnonzero(verdicts == Provenance.CONTACT)
        inside = self._in_contact(cells, farthest, frame)[self.pixels.tactile_pixels(known, frame)]
        verdicts[known] = np.where(inside, Provenance.MASKED, Provenance.OUTSIDE_TOLERANCE)
        verdicts[pressed.pixels] = Provenance.SMALL_CLUSTER
        verdicts[contact.pixels] = Provenance.CONTACT
        return image


#: Twice the mean curvature of an inflated membrane, at least: the apex of one of 200 mm then stands out by 2.5 mm. The
#: window it is measured in, cells. The membrane is at least this share of what the camera sees, in one piece.
_MIN_CURVATURE_PER_M, _WIDE_WINDOW, _MIN_MEMBRANE = 1.0, 4.0, 0.1
#: A piece of at least the second share whose curvature is below the first share of the membrane's is a rim or a wall.
_HARDLY, _BESIDE_SHARE = 0.2, 0.01


class _Rest:
    """The untouched membrane, and the window that the noise asks for."""

    def __init__(self, pixels: Pixels, preset: Preset) -> None:
        from ..alignment import tactile_pose  # loads kernels
        from ..kernels.quadric import CELL_PX
        from . import surface

        assert pixels.untouched is not None
        lens, tables, counts = pixels.rig.tactile.intrinsics, pixels.alignment.tables, pixels.untouched.tactile_depth
        self.unit_m, self.offset_m = float(tables.tactile_unit_m), float(preset.alignment.depth_offset_m)
        self.turn = np.eye(3) if not pixels.rig.has_proximity else tactile_pose(preset.alignment, pixels.rig)[:3, :3]
        seen = min(counts.shape) >= CELL_PX and valid_depth(counts).any()
        if seen:
            self.grid: Grid = surface.Grid.of(lens, counts)
            self.numbers = self.grid.numbers(counts.shape)
            self._beside = np.zeros_like(self.grid.x, np.bool_)
            depth_m, share = self.cells(counts)
            seen = (share > 0).any()
        if not seen:
            raise RigMismatchError(
                "the untouched frame has too little tactile depth for the contact test pressure to compare with; "
                "capture it again"
            )
        wide = surface.curvature(surface.fit(depth_m, share, _WIDE_WINDOW), self.grid)[0]
        bulging, seen_cells = wide > _MIN_CURVATURE_PER_M, np.count_nonzero(share)
        bulging = _parts_with(bulging, bulging, math.ceil(_MIN_MEMBRANE * seen_cells))  # noise bulges in small pieces
        if not bulging.any():
            raise RigMismatchError(
                "the membrane is flat in the untouched frame, so no pressure can be told from its curvature; inflate "
                "it and capture the frame again"
            )
        self.curvature_per_m = float(np.median(wide[bulging]))
        flat = wide < _HARDLY * self.curvature_per_m
        self._beside = _parts_with(flat, flat, round(_BESIDE_SHARE * seen_cells))
        if self._beside.any():
            depth_m, share = self.cells(counts)
            wide = surface.curvature(surface.fit(depth_m, share, _WIDE_WINDOW), self.grid)[0]
        distance_m = float(np.median(depth_m[share > 0]))
        self.cell_m = distance_m * self.grid.side[0]
        self.noise_known = preset.noise is not None
        first = surface.fit(depth_m, share, _FINE_WINDOW)
        if preset.noise is not None:
            known = preset.noise.tactile
            self.density_m4 = known.density_m4(lens.fx) * (distance_m / known.distance_m) ** 6
        else:
            left = (depth_m - first.fit[0])[np.isfinite(first.fit[0]) & (share > 0)]
            spread_m = 1.48 * float(np.median(np.abs(left))) if len(left) else 0.0
            self.density_m4 = (_GUESSED * spread_m * self.cell_m) ** 2
        # twice the mean curvature has this standard deviation over the cube of the window's sigma
        noise_m2 = math.sqrt(self.density_m4 / (2 * math.pi))
        window = (noise_m2 / (preset.pressure.noise * self.curvature_per_m)) ** (1 / 3) / self.cell_m
        self.window = min(max(window, _WINDOWS[0]), _WINDOWS[1])
        self.sigma_per_m = noise_m2 / (self.window * self.cell_m) ** 3
        self.fine = _Scale(self.grid, (depth_m, share), self.window, self.sigma_per_m)
        grid, cells = surface.halved(self.grid), surface.halved_cells(depth_m, share)
        self.wide = _Scale(grid, cells, self.window, self.sigma_per_m / 2**3)
        #: Pressure is a change of the curvature over this one, of a still wider window: noise of the untouched frame
        #: must not look like pressure.
        self.usual_per_m = np.where(np.isfinite(wide), wide, self.fine.bulge_per_m)
        #: The same; nan where the membrane hardly bulges, so that no pressure is known.
        self.bulging_per_m = np.where(self.usual_per_m > _HARDLY * self.curvature_per_m, self.usual_per_m, np.nan)

    def cells(self, counts: Uint16Array) -> Cells:
        """Return the depth of the membrane's cells, without what is beside it, and the share of pixels with depth."""
        from . import surface

        depth_m, share = surface.cells(counts, self.unit_m, self.offset_m, self.grid)
        return np.where(self._beside, 0.0, depth_m), np.where(self._beside, 0.0, share)


class _Scale:
    """The untouched membrane in windows of one size, sigma in cells."""

    def __init__(self, grid: Grid, cells: Cells, window: float, sigma_per_m: float) -> None:
        from . import surface

        self.grid, self.window, self.sigma_per_m = grid, window, sigma_per_m
        self.shape: Shape = surface.fit(*cells, window)
        self.bulge_per_m = surface.curvature(self.shape, grid)[0]

    def compare(
        self, cells: Cells, usual_per_m: Float64Array
    ) -> tuple[Shape, Float64Array, Float64Array, Float64Array]:
        """Return the present shape, twice its mean curvature, p / T against the untouched one, and its deviation."""
        from . import surface

        shape = surface.fit(*cells, self.window)
        bulge_per_m, _, noise = surface.curvature(shape, self.grid)
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = 1 + (bulge_per_m - self.bulge_per_m) / usual_per_m
            sigma = math.sqrt(2) * self.sigma_per_m * noise / usual_per_m  # both frames have noise
        return shape, bulge_per_m, ratio, sigma


class _Now:
    """The present membrane against the untouched one."""

    def __init__(self, rest: _Rest, frame: SensorFrame) -> None:
        from . import surface

        self._rest = rest
        self._cells = rest.cells(frame.tactile_depth)
        self._shape, self.bulge_per_m, ratio, sigma = rest.fine.compare(self._cells, rest.bulging_per_m)
        self._fine: Lazy[Shape] = Lazy(lambda: surface.fit(*self._cells, _FINE_WINDOW, curved=False))
        self._moved_m = rest.fine.shape.fit[0] - self._shape.fit[0]
        self.grown, self.relative, scatter = _against_free(ratio, sigma)
        # what the measured noise does not explain, such as tension that differs with place, counts as noise
        self._scatter = max(scatter, 1.0)
        self.sigma = sigma * (self._scatter / self.grown if self.grown > 0 else math.nan)
        self._flatness: Lazy[Float64Array] = Lazy(self._measure_flatness)
        self.least_error = np.zeros_like(sigma)

    def contact(self, section: PressureSection) -> Float64Array:
        """Return a level of the cells that is above 0 in contact, and falls through 0 at its edge.

        Where a pressure exceeds the noise there is contact. Its edge is where the membrane stops being flat: free, it
        bulges in one direction at least, T1 k1 + T2 k2 = p, however unequal the tensions; on an object that is not
        hollow it bulges in none. A contact too small to look flat is as large as its pressed cells, less those that a
        window makes of a point.
        """
        import cv2

        with np.errstate(invalid="ignore", divide="ignore"):
            noise = self.sigma * self._shape.growth**_CUT_POWER
            limit = np.maximum(section.limit, _LEAST_SIGMAS * noise)
            pressed = (self.relative > limit) & (self._moved_m > _MOVED_M)
            self.sigmas = self.relative / noise
            if pressed.any():
                in_wide = self._sigmas_in_wide_windows()
                wide = in_wide > PRESSURE_SIGMAS
                sure = pressed & (self.sigmas > PRESSURE_SIGMAS) & (wide | np.isnan(in_wide))
                pressed = sure | (pressed & wide & ~_parts_with(wide | sure, sure))
                self.sigmas = np.fmax(self.sigmas, in_wide)
            if not pressed.any():
                return np.full(pressed.shape, -1.0)
            level = self._flatness.get() - self._flatness_at_edges(pressed, section.share)
            flat = _parts_with((level > 0) & (self._moved_m > 0), pressed, _SMALL_CELLS)
            # noise makes holes: what is pressed between flat cells, and not bulged, belongs to them
            disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
            between = cv2.morphologyEx(flat.view(np.uint8), cv2.MORPH_CLOSE, disc) > flat
            between &= pressed & (level > -section.share)
        flat |= between
        inside = np.where(flat, np.where(between, _INSIDE, level), np.fmin(level, _OUTSIDE))
        self.least_error = np.full(pressed.shape, _OF_EDGE * _EDGE)
        reach = 2 * math.ceil(self._rest.window) + 1
        small = pressed & (cv2.dilate(flat.view(np.uint8), np.ones((reach, reach), np.uint8)) == 0)
        peaks = np.where(pressed, self.relative, 0.0)
        small = _parts_with(small, small & (peaks >= cv2.dilate(peaks, np.ones((3, 3)))))
        count, labels = cv2.connectedComponents(small.view(np.uint8), connectivity=8)
        for number in range(1, count):
            own = labels == number
            levels = np.append(np.sort(self.relative[own])[::-1], limit[own].min())
            # number of cells that the window alone raises above the limit where the whole force presses at one point
            blurred = 2 * math.pi * self._rest.window**2 * math.log(levels[0] / max(levels[-1], 1e-3))
            cells = len(levels) - 1
            edge = levels[min(max(round(cells - blurred), _SMALL_CELLS), cells)]
            near = cv2.dilate(own.view(np.uint8), np.ones((3, 3), np.uint8)) > 0
            self.least_error[near] = _OF_WINDOW * self._rest.window
            inside = np.where(near, np.fmax(inside, self.relative / edge - 1), inside)
        return np.asarray(np.minimum(np.fmax(inside, -1.0), 1.0))

    def farthest(self, touching: BoolArray) -> Float32Array:
        """Return for each cell the raw depth beyond which nothing is contact, but membrane that is seen past a dent."""
        import cv2

        (depth_m, share), cell_m = self._cells, self._rest.cell_m
        near = np.where(touching & (share > 0), depth_m, _NOWHERE_M).astype(np.float32)
        for step in _PAST:
            around = np.ones((2 * step + 1, 2 * step + 1), np.uint8)
            near = np.minimum(near, cv2.erode(near, around) + np.float32(step * _STEEP * cell_m))
        return np.asarray((near + _BEHIND * cell_m - self._rest.offset_m) / self._rest.unit_m)

    def _sigmas_in_wide_windows(self) -> Float64Array:
        """Return the contact pressure over its noise in windows of twice the size.

        Noise falls with the third power of the window, the mean pressure of a small contact with the second: contact
        stands out more in the wide one, and what does not is noise.
        """
        import cv2

        from . import surface

        rest, cells = self._rest, surface.halved_cells(*self._cells)
        shape, _, ratio, sigma = rest.wide.compare(cells, rest.bulging_per_m[::2, ::2])
        sigmas = (self.grown - ratio) / (sigma * self._scatter * shape.growth**_CUT_POWER)
        height, width = self.relative.shape
        return np.asarray(cv2.resize(sigmas, None, fx=2, fy=2), np.float64)[:height, :width]

    def edge_error_m(self, cells: Int32Array, least_error: Float64Array) -> float:
        """Return the error of the edge of a contact in these cells (flat numbers); the least one is in cells."""
        rest = self._rest
        # noise bends what is flat in some direction, by the mean larger curvature that noise alone has
        bent = _NOISE_BENDS * rest.sigma_per_m * (rest.window / _FINE_WINDOW) ** 3 / (self.grown * rest.curvature_per_m)
        flat = max(median(self._flatness.get().reshape(-1)[cells]), bent)
        return float(rest.cell_m * max(median(least_error.reshape(-1)[cells]), _PER_BEND * _EDGE * bent / flat))

    def _flatness_at_edges(self, pressed: BoolArray, most: float) -> Float64Array:
        """Return the flatness at which contact ends near each cell: the smaller its step, the less, up to ``most``.

        Averaging blurs the step from the flatness inside to that of the membrane, which bends away.
        """
        import cv2

        flatness = self._flatness.get()
        labels = np.asarray(cv2.connectedComponents((flatness > most).view(np.uint8), connectivity=8)[1])
        edges = np.full(int(labels.max()) + 1, most)
        for number in np.unique(labels[pressed & (labels > 0)]):
            inside = np.sort(flatness[labels == number])
            if len(inside) >= _SMALL_CELLS:
                step = inside[int(_PLATEAU * len(inside))] - _FLATNESS[0]
                edges[number] = max(_FLATNESS[0] + (most - _FLATNESS[0]) * min(step / _STEP, 1.0), 0.0)
        return np.asarray(cv2.erode(edges[labels], np.ones((5, 5), np.uint8)))

    def _measure_flatness(self) -> Float64Array:
        """Return 1 where the membrane is flat or dented, 0 where it bulges as the free one does; nan if unknown."""
        import cv2

        from . import surface

        largest = surface.curvature(self._fine.get(), self._rest.grid)[1]
        flatness = 1 - 2 * largest / (self.grown * self._rest.usual_per_m)
        known = np.isfinite(flatness)
        size = (2 * math.ceil(2.5 * _EDGE_WINDOW) + 1,) * 2
        both = np.stack([np.where(known, np.clip(flatness, *_FLATNESS), 0.0), known], axis=-1)
        both = cv2.GaussianBlur(both, size, _EDGE_WINDOW, borderType=cv2.BORDER_CONSTANT)
        return np.where(known, both[..., 0] / np.maximum(both[..., 1], 1e-9), np.nan)

    def force(self, touching: BoolArray) -> tuple[Float64Array, Float64Array, bool, bool]:
        """Return the force over the inflation (m^2, tactile frame), its deviation, and `at_rim` and `agrees`."""
        import cv2

        from . import surface

        rest = self._rest
        force, sigma, at_rim, agrees = np.zeros(3), np.zeros(3), False, True
        if touching.any():
            slopes = self._fine.get().fit[0]
            depth_m, holes, inner = surface.filled(np.where(np.isfinite(slopes), slopes, self._shape.fit[0]))
            # contact is not seen within a window of a hole, and may go on there
            reach = 2 * math.ceil(rest.window + _FINE_WINDOW) + 1
            near = cv2.dilate(touching.view(np.uint8), np.ones((reach, reach), np.uint8)) > 0
            within = touching | _parts_with(holes, near)
            away = cv2.distanceTransform((~within).view(np.uint8), cv2.DIST_L2, 5)
            weight = np.clip(1 - (away - _MARGIN) / _RAMP, 0.0, 1.0)
            at_rim = bool(((weight > 0) & ~inner).any())
            weight *= inner  # at the rim the clamp's pull ends the balance
            # where no window of the curvature reaches the contact, which is flat
            free = (away > _MARGIN + rest.window) & (away < _MARGIN + _REACH) & np.isfinite(self.bulge_per_m)
            bulge = median(self.bulge_per_m[free])
            bulge = bulge if bulge > 0 else math.nan  # where it is flat, nothing tells its tension
            loaded = np.where(np.isfinite(self.relative), self.relative, 0.0)
            air, pull, pressed = surface.balance(rest.grid.points(depth_m), weight, loaded)
            force, by_area = pull / bulge - air, -pressed
            # tension from a few independent windows, slopes along the loop, and the model
            windows = max(np.count_nonzero(free) / (4 * math.pi * rest.window**2), 1.0)
            loop_m = rest.cell_m * 2 * math.sqrt(math.pi * np.count_nonzero(weight > 0))
            narrow_m3 = (_RAMP * rest.cell_m) ** 2 * math.sqrt(math.pi) * _FINE_WINDOW * rest.cell_m
            by_slopes = math.sqrt(rest.density_m4 * loop_m / narrow_m3) / bulge
            by_tension = np.abs(pull) / bulge * rest.sigma_per_m / bulge / math.sqrt(windows)
            by_model = _MODEL_SHARE * float(np.linalg.norm(force)) * (2.0 if at_rim else 1.0)
            sigma = np.sqrt(by_slopes**2 + by_tension**2 + by_model**2)
            # a force that is not known disagrees with nothing
            agrees = not np.linalg.norm(force - by_area) >= _APART_SIGMAS * np.linalg.norm(sigma)
        return force, sigma, at_rim, agrees


def _against_free(ratio: Float64Array, sigma: Float64Array) -> tuple[float, Float64Array, float]:
    """Return the growth of p / T in the free membrane, 1 less each cell's ratio over it, and the scatter there.

    The relative pressure is 1 less the ratio; the scatter is that of the free membrane as a multiple of ``sigma``.
    """
    import cv2

    some, some_sigma = ratio[::2, ::2], sigma[::2, ::2]  # windows of neighbours overlap, so every second cell tells all
    known, nothing = np.isfinite(some) & np.isfinite(some_sigma), np.full_like(ratio, np.nan)
    if not known.any():
        return 1.0, nothing, 1.0
    # contact may be larger than the free membrane, but only lowers the ratio: the highest ratios tell where to begin
    place = int(_FREE_QUANTILE * np.count_nonzero(known))
    grown, scatter = float(np.partition(some[known], place)[place]), 1.0
    with np.errstate(invalid="ignore", divide="ignore"):
        away = (some - grown) / some_sigma
    more = max(1.0, 1.48 * median(away[known & (away > 0)]))  # times the noise that was measured
    free = known & (np.abs(away) <= _CUT * more)
    for _ in range(4):
        grown = median(some[free])
        with np.errstate(invalid="ignore", divide="ignore"):
            away = (some - grown) / some_sigma
            scatter = 1.48 * median(np.abs(away[free]))
            # both ends are cut, lest the rest be one-sided; a contact is left out with what surrounds it
            pressed = known & (away < -_CUT * scatter)
            left = known & (np.abs(away) <= _CUT * scatter)
        left &= cv2.dilate(pressed.view(np.uint8), np.ones((3, 3), np.uint8)) == 0
        if np.count_nonzero(left) < 0.1 * np.count_nonzero(known) or np.array_equal(left, free):
            break
        free = left
    # without inflation nothing tells a contact pressure
    return grown, 1 - ratio / grown if grown > 0 else nothing, scatter


def _parts_with(cells: BoolArray, seeds: BoolArray, smallest: int = 1) -> BoolArray:
    """Return the connected parts of some cells, of a smallest number, that hold a seed."""
    import cv2

    labels = np.asarray(cv2.connectedComponents(cells.view(np.uint8), connectivity=8)[1])
    chosen = np.zeros(int(labels.max()) + 1, np.bool_)
    chosen[labels[seeds & cells]] = True
    if smallest > 1:
        chosen &= np.bincount(labels.ravel()) >= smallest
    return np.asarray(chosen[labels])
