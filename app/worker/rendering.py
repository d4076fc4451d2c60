"""Draws what the widgets show of a frame, on the worker thread: clouds, image strip and histogram, if visible."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import cv2
import numpy as np

from ...core.contact.alignment import tactile_pose
from ...core.contact.masking import in_hsv_range, masked_share
from ...core.contact.pipeline import ContactPatch
from ...core.contact.pixels import colors_at
from ...core.errors import TactuneError
from ...core.model.arrays import BoolArray, Float32Array, IndexArray, Uint8Array
from ...core.model.clouds import ray_table, valid_depth
from ...core.model.frames import Rig, SensorFrame
from ...core.model.intrinsics import Intrinsics
from ...core.model.patch import SURE, PressureFacts, Provenance
from ...core.preset import Preset
from ...core.tuning.advice.findings import depth_missing
from ...widgets.basics.colormaps import (
    CONTACT_ROW,
    LATE_VERDICTS,
    depth_lut,
    depth_lut_faint_behind,
    patch_lut,
    pressure_index,
    pressure_lut,
    provenance_lut,
    relief_index,
)
from ...widgets.basics.theme import ThemeName
from ...widgets.clouds.cloud_data import DepthCloud
from ...widgets.images.strip_render import (
    RenderedStrip,
    color_pane,
    depth_pane,
    difference_pane,
    outline_contact,
    stride_for,
)
from .results import CloudName, ColorBy, Histogram, Rendered, Wanted


def draw_strip(scene: Scene, wanted: Wanted) -> RenderedStrip:
    """Return the wanted ones of colour, expected and measured depth and relative difference."""
    frame, patch, rig, images = scene.frame, scene.patch, scene.rig, wanted.images
    depth_range_m = scene.tactile_range_m
    typical_m = sum(depth_range_m) / 2
    height, width = frame.proximity_depth.shape
    stride = stride_for(width, wanted.strip_width)
    every = np.s_[::stride, ::stride]
    counts = np.ascontiguousarray(frame.proximity_depth[every])
    valid = valid_depth(counts)
    depth_m = counts * np.float32(rig.proximity.depth_unit_m)
    image, mask = frame.proximity_color, scene.preset.mask
    shows_mask = mask.enabled and wanted.shows_mask
    as_masked = image if patch is None or patch.mask_colors is None else patch.mask_colors.get()
    panes: dict[str, Uint8Array] = {}
    if "color" in images:
        color, covered = aligned_color(image, rig, depth_m, valid, typical_m, stride), None
        if shows_mask:
            same = as_masked is image
            compared = color if same else aligned_color(as_masked, rig, depth_m, valid, typical_m, stride)
            covered = in_hsv_range(compared, mask)
        panes["color"] = color_pane(color, covered)
    if images != {"color"}:  # aligning depth takes long
        if patch is not None:
            expected_m, measured_m = patch.aligned.expected_m[every], patch.aligned.measured_m[every]
        else:
            measured_m = np.full(counts.shape, np.nan, np.float32)
            expected_m = np.where(valid, depth_m, measured_m)
            if not rig.has_proximity:  # one image, which needs no alignment
                measured_m = expected_m
        draw: dict[str, Callable[[], Uint8Array]] = {
            "proximity": lambda: depth_pane(expected_m, depth_range_m),
            "tactile": lambda: depth_pane(measured_m, depth_range_m),
            "difference": lambda: difference_pane(expected_m, measured_m, scene.accepted),
        }
        panes |= {name: pane() for name, pane in draw.items() if name in images}
    if patch is not None:
        outline_contact(panes.values(), patch.mask[every])
    share = masked_share(as_masked, mask) if mask.enabled else None
    return RenderedStrip(panes, (width, height), stride, depth_range_m, scene.accepted, share, shows_mask)


def aligned_color(
    image: Uint8Array, rig: Rig, depth_m: Float32Array, valid: BoolArray, typical_m: float, stride: int = 1
) -> Uint8Array:
    """Return the proximity colour at every ``stride``-th depth pixel, (h, w, 3); black where it is not seen."""
    if rig.proximity_color is None:
        return image[::stride, ::stride]
    return _colors_along(_rays_of_every(rig.proximity.intrinsics, stride), image, rig, depth_m, valid, typical_m)


def colors_around(frame: SensorFrame, rig: Rig, u: int, v: int, radius: int, typical_m: float) -> Uint8Array:
    """Return the `aligned_color` of the pixels around (u, v): uint8, square, smaller at the image's border."""
    part = np.s_[max(0, v - radius) : v + radius + 1, max(0, u - radius) : u + radius + 1]
    if rig.proximity_color is None:
        return frame.proximity_color[part]
    counts = frame.proximity_depth[part]
    depth_m = counts * np.float32(rig.proximity.depth_unit_m)
    rays = ray_table(rig.proximity.intrinsics)[part]
    return _colors_along(rays, frame.proximity_color, rig, depth_m, valid_depth(counts), typical_m)


def _colors_along(
    rays: Float32Array, image: Uint8Array, rig: Rig, depth_m: Float32Array, valid: BoolArray, typical_m: float
) -> Uint8Array:
    z = np.where(valid, depth_m, np.float32(typical_m))
    points = np.asarray(cv2.merge([rays[..., 0] * z, rays[..., 1] * z, z]), np.float32)
    colors, _ = colors_at(points.reshape(-1, 3), _pixels(depth_m.size), image, rig)
    return colors.reshape(*depth_m.shape, 3)


@lru_cache(maxsize=8)
def _rays_of_every(intrinsics: Intrinsics, stride: int) -> Float32Array:
    return np.ascontiguousarray(ray_table(intrinsics)[::stride, ::stride])


@lru_cache(maxsize=8)
def _pixels(count: int) -> IndexArray:
    return np.arange(count)


#: First row of the values in a colour table that begins with the shades of the context.
VALUE_ROWS = 128
HISTOGRAM_BINS = 160
HISTOGRAM_LIMIT = 0.1
GAP_HISTOGRAM_BINS = 50
GAP_HISTOGRAM_LIMIT_M = 0.0005
_SAMPLE = 6
#: Width of the stripes over doubtful contact, with the gap between two, pixels.
_STRIPE_PX = 6
#: The depth colours span these shares of the membrane's depth, extended by these shares of the span
#: on the near and far side: objects are behind the membrane.
_ENDS = (0.01, 0.99)
_NEARER, _FARTHER = 0.1, 0.75
_SMALLEST_SPAN_M = 0.02


@dataclass(frozen=True, eq=False)
class Scene:
    """One frame with everything that decides how it is drawn; the ranges are those of the depth colours."""

    frame: SensorFrame
    patch: ContactPatch | None
    preset: Preset
    rig: Rig
    color_by: ColorBy
    theme: ThemeName
    depth_range_m: tuple[float, float]
    tactile_range_m: tuple[float, float]
    pressure: PressureFacts | None = None  # if it is what the colours mean
    pressure_top: float = 1.0  # share of the inflation that has the last colour
    hatched: bool = True  # doubtful contacts

    @property
    def accepted(self) -> float:
        """Relative difference up to which the contact test treats both depths as equal, at mid-range."""
        return self.preset.test.accepted_share(self.preset, sum(self.depth_range_m) / 2)


class Renderer:
    """Draws frames; the depth colours of one source keep their range."""

    def __init__(self) -> None:
        self._rig: Rig | None = None
        self._ranges_m: dict[str, tuple[float, float]] = {}
        self._median_m, self._pressure_top = float("nan"), 1.0
        self._last_clouds: dict[CloudName, DepthCloud | None] = {}
        self._counts: dict[CloudName, int] = {}
        self._doubtful = False
        self._no_contact = "", ""

    def render(
        self, frame: SensorFrame, patch: ContactPatch | None, preset: Preset, rig: Rig, wanted: Wanted
    ) -> Rendered:
        """Return the wanted images; without a patch, only those that need none."""
        if wanted.words or rig is not self._rig:
            self.measure(frame, preset, rig)
        depth_range_m, tactile_range_m = (self._ranges_m.get(role, (0.0, 1.0)) for role in ("proximity", "tactile"))
        theme: ThemeName = "dark" if wanted.dark else "light"
        color_by, pressure = wanted.color_by, patch.pressure if patch is not None else None
        if color_by is not ColorBy.PRESSURE:
            pressure = None
        elif pressure is None:
            color_by = ColorBy.CONTACT
        elif wanted.words:
            self._pressure_top = max(self._pressure_top, _pressure_top(pressure))
        if wanted.words and patch is not None:
            doubts = [each.doubt.touch_probability for each in patch.contacts]
            self._doubtful = min(doubts, default=0.0) < SURE  # a first contact is looked at again
        scene = Scene(
            frame, patch, preset, rig, color_by, theme, depth_range_m, tactile_range_m, pressure, self._pressure_top,
            hatched=self._doubtful,
        )  # fmt: skip
        clouds = {
            name: self._shared(name, self._with_count(name, _VIEWS[name](scene), wanted.words))
            for name in CloudName
            if name in wanted.clouds
        }
        if not patch or len(patch.points) or CloudName.PATCH not in wanted.clouds:
            self._no_contact = "", ""
        elif wanted.words or not self._no_contact[0]:
            blind = depth_missing(frame, rig)
            why = preset.test.why_no_contact(patch.provenance)
            self._no_contact = why if blind is None else (blind.sentence, blind.action)
        no_contact, no_contact_action = self._no_contact
        return Rendered(
            clouds=clouds,
            color_by=color_by,
            strip=draw_strip(scene, wanted) if wanted.images else None,
            histogram=histogram_of(patch, preset, wanted.histograms) if patch else None,
            median_distance_m=self._median_m,
            depth_range_m=depth_range_m,
            tactile_range_m=tactile_range_m,
            pressure_scale=(self._pressure_top, pressure.inflation_pa if pressure is not None else 0.0),
            verdicts=frozenset(map(Provenance, np.flatnonzero(np.bincount(patch.provenance.ravel())).tolist()))
            if patch and color_by is ColorBy.PROVENANCE
            else frozenset(),
            no_contact=no_contact,
            no_contact_action=no_contact_action,
        )

    def _with_count(self, name: CloudName, cloud: DepthCloud | None, anew: bool) -> DepthCloud | None:
        """Return a cloud with its number of points, counted here so that the window does not have to, or the last."""
        if cloud is None:
            return None
        if not anew and cloud.count != 0 and (last := self._counts.get(name)):
            return replace(cloud, count=last)
        self._counts[name] = cloud.point_count
        return cloud

    def _shared(self, name: CloudName, cloud: DepthCloud | None) -> DepthCloud | None:
        """Return the last cloud of a view instead of one that looks like it: two presets then share one picture."""
        last = self._last_clouds.get(name)
        if cloud is not None and last is not None and cloud.looks_like(last):
            return last
        self._last_clouds[name] = cloud
        return cloud

    def measure(self, frame: SensorFrame, preset: Preset, rig: Rig) -> None:
        """Take a frame's depths into the ranges of the colours, and keep the membrane's median distance."""
        if rig is not self._rig:
            self._rig, self._ranges_m, self._pressure_top = rig, {}, 1.0
        sample_m = membrane_sample_m(frame, preset, rig)
        self._median_m = float("nan")
        if not len(sample_m):
            return
        # Along the tactile axis the membrane is not tilted, so its own depth decides on the reserve of both ranges.
        low, self._median_m, high = _quantiles(sample_m, _ENDS[0], 0.5, _ENDS[1])
        seen_by_proximity_m = _quantiles(membrane_along_proximity_m(frame, preset, rig, sample_m), *_ENDS)
        span_m = max(high - low, _SMALLEST_SPAN_M)
        for camera, ends_m in (("proximity", seen_by_proximity_m), ("tactile", (low, high))):
            near, far = max(ends_m[0] - _NEARER * span_m, 0.0), ends_m[1] + _FARTHER * span_m
            before = self._ranges_m.get(camera, (near, far))
            self._ranges_m[camera] = min(near, before[0]), max(far, before[1])


def _quantiles(sample: Float32Array, *shares: float) -> tuple[float, ...]:
    """Return the elements of a sample that are nearest to these quantiles; several times faster than interpolation."""
    places = [round(share * (len(sample) - 1)) for share in shares]
    ordered = np.partition(sample, places)
    return tuple(float(ordered[place]) for place in places)


def _pressure_top(pressure: PressureFacts) -> float:
    """Return the share of the inflation that nearly all of the patch stays below, in steps of a half."""
    known = pressure.at_points.get()
    known = known[np.isfinite(known)]
    return math.ceil(2 * _quantiles(known, _ENDS[1])[0]) / 2 if len(known) else 0.0


def membrane_sample_m(frame: SensorFrame, preset: Preset, rig: Rig) -> Float32Array:
    """Return the membrane's depth at every sixth row and column, (N,) metres, by the proximity camera if need be."""
    alignment = preset.alignment
    sample = frame.tactile_depth[::_SAMPLE, ::_SAMPLE]
    scale, offset = rig.tactile.depth_unit_m * alignment.depth_scale, alignment.depth_offset_m
    if not valid_depth(sample).any():
        sample, scale, offset = frame.proximity_depth[::_SAMPLE, ::_SAMPLE], rig.proximity.depth_unit_m, 0.0
    return np.asarray(sample[valid_depth(sample)] * np.float32(scale) + np.float32(offset))


def membrane_along_proximity_m(frame: SensorFrame, preset: Preset, rig: Rig, sample_m: Float32Array) -> Float32Array:
    """Return the depths of `membrane_sample_m` along the proximity camera's axis; unchanged where no pose is known."""
    seen = valid_depth(frame.tactile_depth[::_SAMPLE, ::_SAMPLE])
    try:
        x, y, z, offset = tactile_pose(preset.alignment, rig)[2].astype(np.float32)
    except TactuneError:
        return sample_m
    if not seen.any():
        return sample_m
    rays = _rays_of_every(rig.tactile.intrinsics, _SAMPLE)[seen]
    return np.asarray(sample_m * (rays @ np.array([x, y], np.float32) + z) + offset)


def proximity_view(scene: Scene) -> DepthCloud:
    patch = scene.patch
    if patch is not None and scene.color_by is ColorBy.PROVENANCE:
        return _proximity_cloud(scene, patch.provenance, provenance_lut(scene.theme), patch)
    return _proximity_cloud(scene, None, depth_lut_faint_behind())


def tactile_view(scene: Scene) -> DepthCloud | None:
    """Return the tactile cloud in the proximity frame, depth correction included; None without a pose."""
    alignment, camera = scene.preset.alignment, scene.rig.tactile
    try:
        pose = tactile_pose(alignment, scene.rig)
    except TactuneError:
        return None
    return DepthCloud(
        depth=scene.frame.tactile_depth,
        depth_unit_m=camera.depth_unit_m,
        rays=ray_table(camera.intrinsics),
        lut=depth_lut() if scene.pressure is None else pressure_lut(scene.theme),
        pose=pose.astype(np.float64),
        depth_scale=alignment.depth_scale,
        depth_offset_m=alignment.depth_offset_m,
        depth_range_m=scene.tactile_range_m,
        index=None if scene.pressure is None else pressure_index(scene.pressure.on_membrane.get(), scene.pressure_top),
    )


def patch_view(scene: Scene) -> DepthCloud | None:
    """Return the patch over the faint rest of the scene; None without a patch."""
    patch = scene.patch
    if patch is None:
        return None
    shown = patch.mask & ~hatching(patch) if scene.hatched else patch.mask
    if scene.color_by is ColorBy.PROVENANCE:
        late = np.isin(patch.provenance, LATE_VERDICTS)
        index, lut = _over_relief(scene, patch.provenance, late), _relief_lut(scene.theme, provenance_lut)
    elif scene.pressure is not None:
        rows = np.zeros(patch.mask.shape, np.uint8)
        rows[patch.mask] = pressure_index(scene.pressure.at_points.get(), scene.pressure_top)
        index, lut = _over_relief(scene, rows, shown), _relief_lut(scene.theme, pressure_lut)
    else:
        index, lut = _relief(scene), patch_lut(scene.theme)
        index[shown] = CONTACT_ROW
    return _proximity_cloud(scene, index, lut, patch, len(patch.points))


def hatching(patch: ContactPatch) -> BoolArray:
    """Return the stripes of the image that are left out of doubtful contact, bool (H, W)."""
    height, width = patch.rig.proximity.intrinsics.shape
    stripes = np.zeros((height, width), np.bool_)
    pixels = np.flatnonzero(patch.mask)
    for contact in patch.contacts:
        if contact.doubt.touch_probability < SURE:
            stripes.reshape(-1)[pixels[contact.members]] = True
    if stripes.any():
        v, u = np.ogrid[:height, :width]
        stripes &= (u + v) % _STRIPE_PX < _STRIPE_PX // 2
    return stripes


_VIEWS: dict[CloudName, Callable[[Scene], DepthCloud | None]] = {
    CloudName.PROXIMITY: proximity_view,
    CloudName.TACTILE: tactile_view,
    CloudName.PATCH: patch_view,
}


def _proximity_cloud(
    scene: Scene, index: Uint8Array | None, lut: Uint8Array, patch: ContactPatch | None = None, count: int | None = None
) -> DepthCloud:
    camera, depth = scene.rig.proximity, scene.frame.proximity_depth
    if patch is not None and scene.preset.test.moves_points:
        depth = depth.copy()
        depth[patch.mask] = np.rint(patch.points[:, 2] / camera.depth_unit_m)
    return DepthCloud(
        depth=depth,
        depth_unit_m=camera.depth_unit_m,
        rays=ray_table(camera.intrinsics),
        lut=lut,
        pose=np.eye(4),
        index=index,
        depth_range_m=scene.depth_range_m,
        count=count,
    )


def histogram_of(patch: ContactPatch, preset: Preset, wanted: frozenset[str]) -> Histogram | None:
    """Count what the contact test's limit applies to in every other row and column, if this histogram is wanted."""
    if preset.contact_test == "tolerance" and "tolerance.t" in wanted:
        reach = max(HISTOGRAM_LIMIT, 1.5 * preset.tolerance.t)
        return _counted("tolerance.t", patch.relative_difference, -reach, reach, HISTOGRAM_BINS)
    if preset.contact_test == "membrane" and "membrane.gap_m" in wanted:
        gap_m = np.empty((0, 0), np.float32) if patch.membrane is None else patch.membrane.gap_m.get()
        reach = max(GAP_HISTOGRAM_LIMIT_M, 1.5 * preset.membrane.gap_m)
        return _counted("membrane.gap_m", gap_m, 0.0, reach, GAP_HISTOGRAM_BINS)
    return None


def _counted(field: str, image: Float32Array, low: float, high: float, bins: int) -> Histogram:
    values, edges = image[::2, ::2], np.linspace(low, high, bins + 1)
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return Histogram(field, np.zeros(bins, np.int64), edges, 0)
    counts = cv2.calcHist([values[None]], [0], None, [bins], [low, high])
    return Histogram(field, counts.ravel().astype(np.int64), edges, len(values))


def _relief(scene: Scene) -> Uint8Array:
    """Return rows of `patch_lut`: shades of the context over the range of the depth colours."""
    near, far = (limit / scene.rig.proximity.depth_unit_m for limit in scene.depth_range_m)
    return relief_index(scene.frame.proximity_depth, near, far)


def _over_relief(scene: Scene, rows: Uint8Array, within: BoolArray) -> Uint8Array:
    """Return rows of a table: shades of the context below, values 0 to 127 above, where ``within``."""
    return np.where(within, rows + np.uint8(VALUE_ROWS), _relief(scene) >> 1)


@cache
def _relief_lut(theme: ThemeName, lut_of: Callable[[ThemeName], Uint8Array]) -> Uint8Array:
    """Return the table of `_over_relief`: every other shade of the context, then values by another table."""
    mixed = np.concatenate([patch_lut(theme)[::2], lut_of(theme)[:VALUE_ROWS]])
    mixed.flags.writeable = False
    return mixed
