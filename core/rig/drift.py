"""Drift of the membrane since the untouched frame was captured: the depth change of both cameras, in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from ..contact.checks import rig_in_use
from ..contact.pipeline import ContactPipeline
from ..errors import CalibrationError, FrameError, RigMismatchError, minus
from ..methods.membrane_view import MembraneView
from ..model.arrays import Float64Array, Uint16Array
from ..model.clouds import ray_table, valid_depth
from ..model.frames import DepthCamera, Rig, SensorFrame
from ..model.robust import spread
from ..preset import Preset

#: Largest harmless change: half the margin of the method proximity-only, which compares with the untouched frame.
LIMIT_M: Final = 0.001

Verdict = Literal["fine", "inflation", "camera", "touched"]

#: Touch: a residual that neither pressure nor pose explains, above this depth in more than this share of the membrane.
_DENT_M: Final = 0.003
_DENT_SHARE: Final = 0.02
#: The proximity camera sees the membrane itself only on prints, where both depths agree within this.
_SAME_SURFACE_M: Final = 0.006
#: Smallest bulge by which a change of inflation can be detected, metres.
MIN_BULGE_M: Final = 0.005
_MIN_PIXELS: Final = 200
_MAX_PIXELS: Final = 20_000
_ROUNDS: Final = 4


@dataclass(frozen=True)
class DepthChange:
    """Change of the membrane's depth in one camera, present minus untouched frame; positive is farther away.

    Attributes
    ----------
    median_m, spread_m : float
        Median and robust spread (1.4826 median absolute deviations) over the membrane's pixels, metres.
    moved_m : float
        Root mean square of the planar part of the change, as a moving camera causes it, metres.
    pixels : int
    """

    median_m: float
    spread_m: float
    moved_m: float
    pixels: int


@dataclass(frozen=True)
class MembraneDrift:
    """Drift of the membrane since the untouched frame was captured.

    Attributes
    ----------
    tactile : DepthChange
    proximity : DepthChange or None
        None if the proximity camera sees too little of the membrane itself.
    inflation_m : float
        Change of the apex's height above the rim, metres; positive is farther from the cameras.
    verdict : {"fine", "inflation", "camera", "touched"}
    sentence : str
        The result in words, with what to do.
    """

    tactile: DepthChange
    proximity: DepthChange | None
    inflation_m: float
    verdict: Verdict
    sentence: str


def compare_with_untouched(preset: Preset, rig: Rig, frame: SensorFrame, untouched: SensorFrame) -> MembraneDrift:
    """Compare the present untouched membrane with the untouched frame.

    The change of the tactile depth is fitted robustly by a multiple of the membrane's own bulge (a change of pressure)
    plus a plane over the image (a camera that moves or drifts). A local residual is a touch.

    Parameters
    ----------
    preset : Preset
        Its alignment relates the two cameras.
    rig : Rig
    frame : SensorFrame
        One frame without contact, or the median of several.
    untouched : SensorFrame

    Raises
    ------
    CalibrationError
        The frames have too few pixels with tactile depth in common.
    FrameError
        A frame is of another rig.
    RigMismatchError
        Neither preset nor rig has the pose between the cameras.
    """
    rig = rig_in_use(preset, rig)
    for one in (frame, untouched):
        one.check_against(rig)
    change, x, y, before = _changes(frame.tactile_depth, untouched.tactile_depth, rig.tactile)
    if len(change) < _MIN_PIXELS:
        raise CalibrationError(
            f"the tactile camera sees only {len(change)} pixels of the membrane both now and in the untouched frame; "
            "check that it sees the membrane, or capture the untouched frame again"
        )
    rim, apex = np.quantile(before, [0.02, 0.98])
    inflated = apex - rim >= MIN_BULGE_M
    bulge = (before - rim) / (apex - rim) if inflated else np.zeros_like(before)
    fitted = _fit(change, np.column_stack([np.ones_like(x), x, y, bulge]))
    inflation_m = float(fitted[3]) if inflated else 0.0
    plane = fitted[0] + fitted[1] * x + fitted[2] * y
    tactile = _sum_up(change, plane)
    dented = float(np.mean(np.abs(change - plane - inflation_m * bulge) > _DENT_M))
    proximity = _proximity_change(preset, rig, frame, untouched, inflation_m)
    verdict, sentence = _judge(tactile, proximity, inflation_m, dented)
    return MembraneDrift(tactile, proximity, inflation_m, verdict, sentence)


def _proximity_change(
    preset: Preset,
    rig: Rig,
    frame: SensorFrame,
    untouched: SensorFrame,
    inflation_m: float,
) -> DepthChange | None:
    """Return the change where the proximity camera sees the membrane, minus that of the inflation; None if too few."""
    view = MembraneView(preset.alignment, rig)
    membrane = view.depth_m(untouched.tactile_depth)
    with np.errstate(invalid="ignore"):
        seen = np.abs(untouched.proximity_depth * rig.proximity.depth_unit_m - membrane) < _SAME_SURFACE_M
    where = np.where(seen, untouched.proximity_depth, np.uint16(0))
    change, x, y, before = _changes(frame.proximity_depth, where, rig.proximity)
    if len(change) < _MIN_PIXELS:
        return None
    rim, apex = np.nanquantile(membrane, [0.02, 0.98])  # in the proximity camera
    bulge = (before - rim) / (apex - rim) if inflation_m else np.zeros_like(before)
    fitted = _fit(change - inflation_m * bulge, np.column_stack([np.ones_like(x), x, y]))
    return _sum_up(change, fitted[0] + fitted[1] * x + fitted[2] * y)


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
    """Return robust least-squares coefficients: outliers are dropped and the fit is repeated."""
    kept = np.abs(change - np.median(change)) <= 3 * spread(change, float(np.median(change))) + LIMIT_M
    fitted: Float64Array = np.zeros(columns.shape[1])
    for _ in range(_ROUNDS):
        fitted = np.asarray(np.linalg.lstsq(columns[kept], change[kept], rcond=None)[0], np.float64)
        left = change - columns @ fitted
        kept = np.abs(left) <= 3 * spread(left, float(np.median(left))) + LIMIT_M / 2
    return fitted


def _sum_up(change: Float64Array, plane: Float64Array) -> DepthChange:
    moved = float(np.sqrt(np.mean(plane**2)))
    median_m = float(np.median(change))
    return DepthChange(median_m, spread(change, median_m), moved, len(change))


def _judge(
    tactile: DepthChange, proximity: DepthChange | None, inflation_m: float, dented: float
) -> tuple[Verdict, str]:
    if dented > _DENT_SHARE:
        return "touched", (
            f"Something touches the membrane: {100 * dented:.0f} % of it differs from the untouched frame by more than "
            f"{1e3 * _DENT_M:.0f} mm; remove it and check again."
        )
    known = {"tactile": tactile} | ({} if proximity is None else {"proximity": proximity})
    moved = {name: change.moved_m for name, change in known.items() if change.moved_m > LIMIT_M}
    if moved:
        by = " and ".join(f"{1e3 * metres:.1f} mm" for metres in moved.values())
        cameras = f"The {next(iter(moved))} camera has" if len(moved) == 1 else "Both cameras have"
        return "camera", (
            f"{cameras} moved, or drifted with temperature: the membrane's depth is off by {by} up to its rim; "
            "calibrate again, then capture the untouched frame again."
        )
    if abs(inflation_m) > LIMIT_M:
        return "inflation", (
            f"The inflation has changed: the apex of the membrane stands {1e3 * abs(inflation_m):.1f} mm "
            f"{'farther out' if inflation_m > 0 else 'farther in'} than in the untouched frame; inflate it as before, "
            "or capture the untouched frame again."
        )
    numbers = ", ".join(f"{name} {minus(f'{1e3 * change.median_m:+.2f}')} mm" for name, change in known.items())
    unseen = "" if proximity else "; not checked: the proximity camera, which sees too little of the membrane itself"
    return "fine", f"The membrane is as in the untouched frame (median change: {numbers}){unseen}."


@dataclass(frozen=True)
class TouchDoubt:
    """A sign that something touches the membrane.

    Attributes
    ----------
    sentence : str
    certain : bool
        False if there is another possible explanation.
    """

    sentence: str
    certain: bool


def touch_doubts(preset: Preset, rig: Rig, membrane: SensorFrame, earlier: SensorFrame | None) -> list[TouchDoubt]:
    """Return signs that a membrane said to be untouched is touched; empty if there are none.

    Parameters
    ----------
    preset : Preset
        Its pipeline should find no contact.
    rig : Rig
    membrane : SensorFrame
        One frame, or the median of several.
    earlier : SensorFrame or None
        The preset's current untouched frame.

    Raises
    ------
    FrameError
        The membrane is of another rig.
    """
    try:
        patch = ContactPipeline(preset, rig).process(membrane)
    except RigMismatchError:  # the preset is for another sensor
        return []
    doubts = []
    if len(patch.points):
        found = (
            f"the preset finds a contact patch of {patch.area_mm2 / 100:.1f} cm2 on a membrane that should be untouched"
        )
        doubts.append(
            TouchDoubt(f"{found}; remove what touches the membrane or is close to it, and capture again", True)
            if preset.mask.enabled
            else TouchDoubt(f"{found}; the mask is off, so these may be its prints, or a touch", False)
        )
    if earlier is not None and (dent := _dent(preset, rig, membrane, earlier)):
        doubts.append(TouchDoubt(dent, False))
    return doubts


def _dent(preset: Preset, rig: Rig, membrane: SensorFrame, earlier: SensorFrame) -> str:
    try:
        drift = compare_with_untouched(preset, rig, membrane, earlier)
    except (CalibrationError, FrameError):  # of another sensor, or without depth
        return ""
    if drift.verdict != "touched":
        return ""
    return (
        "in places the membrane is more than 3 mm away from the preset's current untouched frame; one of the two is "
        "touched"
    )
