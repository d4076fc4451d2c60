"""Change of the membrane since the untouched frame was captured: a camera that moved, another inflation, or a touch.

The change of the tactile depth is a plane over the image (the camera moved along its axis, turned, or drifts), plus a
multiple of the membrane's own bulge (the pressure changed), plus a local residual (a touch). A camera that moves
sideways changes the depth little, but it shifts the membrane's texture in the colour image, which is tracked by
Lucas-Kanade.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import cv2
import numpy as np

from ..calibration.check import Drift, check_alignment
from ..calibration.geometry import color_lens, named_sides
from ..calibration.texture import tracked
from ..contact.alignment import make_alignment
from ..contact.kernels.tolerance import Region
from ..contact.pipeline import ContactPipeline
from ..errors import CalibrationError, TactuneError
from ..model.arrays import Float64Array, Uint8Array, Uint16Array, spread
from ..model.clouds import ray_table, valid_depth
from ..model.frames import DepthCamera, Rig, SensorFrame
from ..model.patch import SURE
from ..preset import Preset
from .untouched import load_untouched

#: Largest harmless change of depth: half the margin of the method proximity-only, which compares with the untouched
#: frame. Largest harmless shift of the texture, which is measured ten times as exactly.
LIMIT_M: Final = 0.001
SHIFT_LIMIT_M: Final = 0.0004
#: Seconds from one look of a `Watch` to the next, and between its first looks; and the looks that must agree.
INTERVAL_S: Final = 10.0
_FIRST_INTERVAL_S: Final = 1.0
LOOKS: Final = 3

Verdict = Literal["fine", "inflation", "camera", "touched"]
Remedy = Literal["calibrate", "capture"]

#: Touch: a residual that neither pressure nor pose explains, above this depth and this number of its robust standard
#: deviations (a single frame is noisy), in more than this share of the membrane.
_DENT_M, _DENT_SIGMAS, _DENT_SHARE = 0.003, 4.0, 0.02
#: Touch during a watch: the preset finds this much more contact than in the untouched frame.
_CONTACT_MM2: Final = 50.0
#: The proximity camera sees the membrane itself only on prints, where both depths agree within this.
_SAME_SURFACE_M: Final = 0.006
#: Smallest bulge by which a change of inflation can be detected, metres.
_MIN_BULGE_M: Final = 0.005
_MIN_PIXELS, _MAX_PIXELS, _ROUNDS = 200, 20_000, 4
#: Texture: most and fewest places, their distance and window, pixels.
_MAX_PLACES, _MIN_PLACES, _APART_PX, _WINDOW_PX = 300, 20, 12, 15
#: Places follow a common motion within this, pixels. A common shift beyond the second, metres, is no touch.
_SCATTER_PX, _FAR_M = 3.0, 0.001
#: A change of the apex moves the texture sideways by at most this share of it.
_PRESSURE_SHIFT: Final = 0.06
#: No membrane bulges exactly as assumed: on prints the error is up to this share of the apex's change.
_BULGE_ERROR: Final = 0.1


@dataclass(frozen=True)
class MembraneDrift:
    """Drift of the membrane since the untouched frame was captured, and what to do in words.

    By how much each camera, ``"tactile"`` and ``"proximity"``, has moved or drifted: the larger of what depth and
    texture tell; and the shift of the texture alone, metres at the membrane's distance. A camera that sees too little
    is missing. The inflation is the change of the apex's height above the rim, positive is farther from the cameras.
    """

    moved_m: dict[str, float]
    shift_m: dict[str, float]
    inflation_m: float
    verdict: Verdict
    sentence: str


def compare_with_untouched(preset: Preset, rig: Rig, frame: SensorFrame, untouched: SensorFrame) -> MembraneDrift:
    """Compare the present membrane with the untouched frame; `CalibrationError` if too little is seen in both."""
    for one in (frame, untouched):
        one.check_against(rig)
    change, x, y, before = _changes(frame.tactile_depth, untouched.tactile_depth, rig.tactile)
    if len(change) < _MIN_PIXELS:
        raise CalibrationError(
            f"the tactile camera sees only {len(change)} pixels of the membrane in both frames; check what it sees"
        )
    rim, apex = np.quantile(before, [0.02, 0.98])
    inflated = apex - rim >= _MIN_BULGE_M
    bulge = (before - rim) / (apex - rim) if inflated else np.zeros_like(before)
    fitted = _fit(change, np.column_stack([np.ones_like(x), x, y, bulge]))
    inflation_m = float(fitted[3]) if inflated else 0.0
    plane = fitted[0] + fitted[1] * x + fitted[2] * y
    residual = change - plane - inflation_m * bulge
    dented = float(np.mean(np.abs(residual) > max(_DENT_M, _DENT_SIGMAS * spread(residual, 0.0))))

    planes = {"tactile": plane}
    shifts: dict[str, Float64Array | None] = {}
    if rig.has_proximity:
        proximity = _proximity_plane(preset, rig, frame, untouched, inflation_m)
        if proximity is not None:
            planes["proximity"] = proximity
        shifts["proximity"] = _shift_px(untouched.proximity_color, frame.proximity_color)
    distance_m = float(np.median(before))
    metres_a_px = {"proximity": distance_m / color_lens(rig).fx, "tactile": distance_m / rig.tactile.intrinsics.fx}
    if untouched.tactile_color is not None and frame.tactile_color is not None:
        shifts["tactile"] = _shift_px(untouched.tactile_color, frame.tactile_color)
    shift_m = {
        name: max(_rms(shift) * metres_a_px[name] - _PRESSURE_SHIFT * abs(inflation_m), 0.0)
        for name, shift in shifts.items()
        if shift is not None
    }
    planes_m = {name: _rms(seen) for name, seen in planes.items()}
    if "proximity" in planes_m:
        planes_m["proximity"] = max(planes_m["proximity"] - _BULGE_ERROR * abs(inflation_m), 0.0)
    ways = {
        name: _way(planes.get(name), None if shift_m.get(name, 0.0) < planes_m.get(name, 0.0) else shifts.get(name))
        for name in {**planes_m, **shift_m}
    }
    verdict, sentence = _judge(planes_m, shift_m, ways, inflation_m, dented, rig.has_proximity)
    moved_m = {name: max(planes_m.get(name, 0.0), shift_m.get(name, 0.0)) for name in {**planes_m, **shift_m}}
    return MembraneDrift(moved_m, shift_m, inflation_m, verdict, sentence)


def _proximity_plane(
    preset: Preset, rig: Rig, frame: SensorFrame, untouched: SensorFrame, inflation_m: float
) -> Float64Array | None:
    """Return the planar change where the proximity camera sees the membrane, less inflation that shows."""
    height, width = rig.proximity.intrinsics.shape
    aligned = make_alignment(preset.alignment, rig).align(
        untouched.proximity_depth, untouched.tactile_depth, Region(0, 0, width, height)
    )
    with np.errstate(invalid="ignore"):
        seen = np.abs(aligned.expected_m - aligned.measured_m) < _SAME_SURFACE_M
    where = np.where(seen, untouched.proximity_depth, np.uint16(0))
    change, x, y, before = _changes(frame.proximity_depth, where, rig.proximity)
    if len(change) < _MIN_PIXELS:
        return None
    # Both distances are those along the tactile camera's axis; the bulge is needed along the proximity camera's.
    proximity_m = untouched.proximity_depth * rig.proximity.depth_unit_m
    membrane_m = proximity_m + aligned.measured_m - aligned.expected_m
    rim, apex = np.nanquantile(membrane_m, [0.02, 0.98])
    bulge = (before - rim) / (apex - rim) if inflation_m else np.zeros_like(before)
    # A tactile camera that moved along its axis looks like inflation, too: the smaller of both motions counts.
    columns = np.column_stack([np.ones_like(x), x, y])
    return min((columns @ _fit(of_camera, columns) for of_camera in (change - inflation_m * bulge, change)), key=_rms)


def _changes(
    now: Uint16Array, then: Uint16Array, camera: DepthCamera
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
    """Return change of depth, ray x and y, and depth before, each (M,) in metres, at pixels with depth in both."""
    pixels = np.flatnonzero(valid_depth(now) & valid_depth(then))
    pixels = pixels[:: max(1, len(pixels) // _MAX_PIXELS)]
    before, after = (image.reshape(-1)[pixels].astype(np.float64) * camera.depth_unit_m for image in (then, now))
    rays = ray_table(camera.intrinsics).reshape(-1, 2)[pixels].astype(np.float64)
    return after - before, rays[:, 0], rays[:, 1], before


def _fit(change: Float64Array, columns: Float64Array) -> Float64Array:
    """Return robust least-squares coefficients: outliers are dropped and the fit is repeated.

    It begins without what differs from the median, as a touch does, and with everything, since the median may be that
    of a rim that keeps its place; the one that leaves less is taken.
    """
    near = np.abs(change - np.median(change)) <= 3 * spread(change, float(np.median(change))) + LIMIT_M
    fits = []
    for start in (near, np.ones_like(near)):
        kept = start
        for _ in range(_ROUNDS):
            fitted = np.asarray(np.linalg.lstsq(columns[kept], change[kept], rcond=None)[0], np.float64)
            residual = change - columns @ fitted
            kept = np.abs(residual) <= 3 * spread(residual, float(np.median(residual))) + LIMIT_M / 2
        fits.append((float(np.minimum(np.abs(residual), _DENT_M).mean()), fitted))
    return min(fits, key=lambda fit: fit[0])[1]


def _rms(change: Float64Array) -> float:
    """Return the root mean square of numbers, (M,), or of the lengths of vectors, (M, 2)."""
    return float(np.sqrt(np.sum(change**2) / len(change)))


def _way(plane: Float64Array | None, shift: Float64Array | None) -> str:
    """Return which way a camera moved, from its image's shift, (M, 2), or else from the depth's planar change, (M,)."""
    if shift is not None:
        way = -shift.mean(axis=0)  # the image moves against the camera
        turned = np.hypot(*way) <= _rms(shift) / 2
        return ", turned about its axis," if turned else f" {named_sides(*way)} in its image"
    assert plane is not None
    mean = float(plane.mean())
    return f" {'away from' if mean > 0 else 'towards'} the membrane" if abs(mean) > _rms(plane) / 2 else ", turned,"


def _shift_px(before: Uint8Array, now: Uint8Array) -> Float64Array | None:
    """Return the shifts of the texture by a similarity that most of it follows, pixels, (M, 2); None without enough."""
    first, second = _local_contrast(before), _local_contrast(now)
    corners = cv2.goodFeaturesToTrack(first, _MAX_PLACES, 0.05, _APART_PX, blockSize=_WINDOW_PX)
    if corners is None or len(corners) < _MIN_PLACES:
        return None
    there, found = tracked(first, second, np.asarray(corners, np.float32), levels=4)
    if found.sum() < _MIN_PLACES:
        return None
    before_px, now_px = corners.reshape(-1, 2)[found].astype(np.float64), there[found]
    similarity, inliers = cv2.estimateAffinePartial2D(before_px, now_px, ransacReprojThreshold=_SCATTER_PX)
    if similarity is None or inliers.sum() < max(_MIN_PLACES, len(before_px) / 2):
        return None
    moved = before_px @ similarity[:, :2].T + similarity[:, 2] - before_px
    return np.asarray(moved, np.float64)


def _local_contrast(color: Uint8Array) -> Uint8Array:
    """Return brightness relative to that of the surroundings, which light and exposure do not change."""
    gray = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY).astype(np.float32) + 8.0  # below 8 levels there is only noise
    ratio = cv2.GaussianBlur(gray, (0, 0), 1.0) / cv2.GaussianBlur(gray, (0, 0), 6.0)
    return np.asarray(np.clip(128 + 200 * np.log(ratio), 0, 255), np.uint8)


def _judge(
    planes_m: dict[str, float],
    shift_m: dict[str, float],
    ways: dict[str, str],
    inflation_m: float,
    dented: float,
    two_cameras: bool,
) -> tuple[Verdict, str]:
    if dented > _DENT_SHARE and shift_m.get("tactile", 0.0) < _FAR_M:
        return "touched", (
            f"Something touches the membrane: {100 * dented:.0f} % of it differs from the untouched frame by more than "
            f"{1e3 * _DENT_M:.0f} mm; remove it and check again."
        )
    moved: dict[str, float] = {}
    for name in ("tactile", "proximity"):
        plane_m, texture_m = planes_m.get(name, 0.0), shift_m.get(name, 0.0)
        if plane_m > LIMIT_M or texture_m > SHIFT_LIMIT_M:
            moved[name] = max(plane_m, texture_m)
    if moved:
        by = " and ".join(f"{1e3 * metres:.1f} mm{ways[name]}" for name, metres in moved.items())
        cameras = f"The {next(iter(moved))} camera has" if len(moved) == 1 else "Both cameras have"
        return "camera", (
            f"{cameras} moved by {by} or drifted with temperature; "
            f"{'calibrate again, then ' if two_cameras else ''}capture the untouched frame again."
        )
    if abs(inflation_m) > LIMIT_M:
        return "inflation", (
            f"The inflation has changed: the apex of the membrane stands {1e3 * abs(inflation_m):.1f} mm "
            f"{'farther out' if inflation_m > 0 else 'farther in'} than in the untouched frame; inflate it as before, "
            "or capture the untouched frame again."
        )
    unseen = ""
    if two_cameras and "proximity" not in planes_m:
        unseen = " The proximity camera sees too little of it to be checked."
    return "fine", f"The membrane is as in the untouched frame.{unseen}"


def remedies_of(verdict: Verdict, rig: Rig) -> tuple[Remedy, ...]:
    """Return what mends a drift of the membrane: a moved camera of two is calibrated again, too."""
    return ("calibrate", "capture") if verdict == "camera" and rig.has_proximity else ("capture",)


@dataclass(frozen=True)
class WatchReport:
    """Something that changed, or that is as before again, and when that was decided, by the time of `Watch.look`."""

    verdict: Verdict
    state: Literal["told", "withdrawn"]
    time_s: float
    sentence: str
    remedies: tuple[Remedy, ...]


class Watch:
    """Compares a rig with the untouched frame at intervals; a change is told or withdrawn once `LOOKS` looks agree."""

    def __init__(self, preset: Preset, rig: Rig, untouched: SensorFrame | None) -> None:
        if untouched is None:
            raise CalibrationError("the preset has no untouched frame to compare with; capture one")
        untouched.check_against(rig)
        self._preset, self._rig, self._untouched = preset, rig, untouched
        # One look must not depend on earlier ones.
        self._pipeline = ContactPipeline(preset.with_value("membrane.frames", 1), rig, untouched)
        self._area_mm2 = self._pipeline.process(untouched).area_mm2
        self._verdicts: list[Verdict] = []
        self._next_s, self._looks = -np.inf, 0
        #: The change that has been told and not withdrawn; "fine" if there is none.
        self.told: Verdict = "fine"
        #: What the newest look measured; None while something touches.
        self.drift: MembraneDrift | None = None

    def due(self, time_s: float) -> bool:
        """Return whether the next look is due; also after time was set back."""
        return time_s >= self._next_s or time_s < self._next_s - INTERVAL_S

    def look(self, frame: SensorFrame, time_s: float) -> WatchReport | None:
        """Measure one frame, taken at ``time_s`` by any clock, and return what it decides."""
        self._looks += 1
        self._next_s = time_s + (INTERVAL_S if self._looks >= LOOKS else _FIRST_INTERVAL_S)
        self.drift = None
        try:
            drift = compare_with_untouched(self._preset, self._rig, frame, self._untouched)
        except CalibrationError:  # too little depth at this moment
            return None
        touched = self._pipeline.process(frame).area_mm2 > self._area_mm2 + _CONTACT_MM2
        if drift.verdict == "touched" or (touched and drift.shift_m.get("tactile", 0.0) < _FAR_M):
            return None
        self.drift = drift
        self._verdicts = [*self._verdicts[1 - LOOKS :], drift.verdict]
        if self._verdicts != [drift.verdict] * LOOKS or drift.verdict == self.told:
            return None
        before, self.told = self.told, drift.verdict
        if drift.verdict == "fine":
            return WatchReport(before, "withdrawn", time_s, drift.sentence, ())
        return WatchReport(drift.verdict, "told", time_s, drift.sentence, remedies_of(drift.verdict, self._rig))


@dataclass(frozen=True, eq=False)
class RigCheck:
    """Drift of the alignment and of the membrane; for each, a sentence instead if it could not be checked."""

    alignment: Drift | str
    membrane: MembraneDrift | str

    @property
    def state(self) -> Literal["good", "drifted", "unknown"]:
        """Whether all is as before; unknown if nothing could be checked, or while something touches the membrane."""
        verdict = "unknown" if isinstance(self.membrane, str) else self.membrane.verdict
        off = isinstance(self.alignment, Drift) and self.alignment.recalibrate
        if off or verdict in ("camera", "inflation"):
            return "drifted"
        return "unknown" if verdict == "touched" or (isinstance(self.alignment, str) and verdict != "fine") else "good"

    @property
    def unchecked(self) -> list[str]:
        """What could not be checked, and why."""
        parts = (("alignment", self.alignment), ("membrane", self.membrane))
        return [f"the {what} was not checked: {found}" for what, found in parts if isinstance(found, str)]

    @property
    def sentence(self) -> str:
        """The state in one line: what was measured, or what moved, by how much, which way, and what mends it."""
        good: list[str] = []
        bad: list[str] = []
        if isinstance(self.alignment, Drift):
            good.append(f"{self.alignment.drift_px:.1f} px")
            if self.alignment.recalibrate:
                bad.append(self.alignment.sentence)
        if isinstance(self.membrane, MembraneDrift):
            moved_m = max(*self.membrane.moved_m.values(), abs(self.membrane.inflation_m))
            good.append(f"membrane moved by {1e3 * moved_m:.1f} mm")
            if self.membrane.verdict != "fine":
                bad.append(self.membrane.sentence)
        if self.state == "unknown":
            return " ".join(bad) or "; ".join(self.unchecked)
        return f"drifted: {' '.join(bad)}" if bad else f"still good: {', '.join(good)}"


def drift_or_reason(preset: Preset, rig: Rig, frame: SensorFrame) -> Drift | str:
    """Return the drift of the alignment, or why it could not be checked."""
    try:
        return check_alignment(preset, rig, frame)
    except TactuneError as error:
        return str(error)


def check_rig(
    preset: Preset, preset_path: Path | None, rig: Rig, frame: SensorFrame, untouched: SensorFrame | None = None
) -> RigCheck:
    """Check a preset on a frame; its untouched frame, unless it is given, lies beside ``preset_path``."""
    membrane: MembraneDrift | str = "the preset has no untouched frame; capture one while nothing touches the membrane"
    if preset.untouched is not None and preset_path is not None:
        try:
            untouched = untouched or load_untouched(preset.untouched, preset_path)
            membrane = compare_with_untouched(preset, rig, frame, untouched)
            if membrane.verdict == "inflation" and preset.test.needs_untouched:  # which tells it from a press
                patch = ContactPipeline(preset, rig, untouched).process(frame)
                if patch.doubt.touch_probability > SURE:
                    found = f"{patch.area_mm2:,.0f} mm² of contact; remove it and check again."
                    membrane = replace(membrane, verdict="touched", sentence=f"Something touches the membrane: {found}")
        except TactuneError as error:
            membrane = str(error)
    return RigCheck(drift_or_reason(preset, rig, frame), membrane)
