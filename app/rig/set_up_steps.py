"""The steps of the guided set-up beyond the untouched frame: noise, alignment, bias, suggestions and verdict."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from ...core.calibration.check import is_worse
from ...core.calibration.report import CalibrationReport, grade
from ...core.errors import CalibrationError, minus
from ...core.model.arrays import Float64Array
from ...core.model.frames import SensorFrame
from ...core.model.rig_noise import Verdict
from ...core.preset import Preset, RigNoise, now
from ...core.rig.noise import MIN_FRAMES, NOISE_FRAMES, describe, measure_noise, with_bias
from ...core.rig.untouched import tile_medians
from ...core.rig.verdict import judge_rig
from ...core.sources.base import part_of
from ...core.tuning.advice.proposal import Evidence
from ...core.tuning.advice.suggest import AllProposals, suggest_all
from ..calibration.finder import find_pairs
from ..calibration.fitting import fit, report_changes
from ..calibration.measuring_step import MeasuringStep
from ..calibration.session import Choices, SessionState
from ..calibration.snapshots import FRAMES, take_snapshot
from ..context import Context
from ..worker.jobs import Progress, Work
from ..worker.results import SourceInfo

#: A press: image tiles that moved towards the camera by more than this, metres, are more than this share of all.
_DENT_M, _DENTED = 0.005, 0.03
#: It is held while 95 % of the tiles stay within this, metres, over this number of frames.
_HELD_M: Final = 0.002
_HELD_FRAMES: Final = 8
#: Frames with which suggestions are made.
_RECENT: Final = 4


class SetUpStep(MeasuringStep):
    """A step of the guided set-up: also what it needs, and when it is done."""

    #: Whether a rig with one camera leaves it out.
    two_cameras = False

    def known(self, preset: Preset) -> str:
        """Return that the step is done, with its number; empty: it is open."""
        raise NotImplementedError


class NoiseStep(SetUpStep):
    """Measures at rest; the simulator takes its object away."""

    title, intro = "Noise", f"Everything at rest: {NOISE_FRAMES} frames."
    _tip = "Measure the noise of both cameras, and the bias on prints, into the preset; nothing may move"
    button = "&Measure noise", _tip
    field = "noise"
    wanted, min_frames = NOISE_FRAMES, MIN_FRAMES

    def known(self, preset: Preset) -> str:
        noise = preset.noise
        if noise is None:
            return ""
        sides = [("tactile", noise.tactile), ("proximity", noise.proximity)]
        if noise.proximity == noise.tactile:  # a rig with one camera
            sides.pop()
        return f"Noise {', '.join(f'{1e3 * side.total_m:.1f} mm {name}' for name, side in sides)}."

    def work(self, kept: list[SensorFrame], info: SourceInfo) -> Work:
        count, preset, untouched = self.wanted, self._document.preset, self.untouched_of(info)
        return lambda progress: measure_noise(
            kept[:count], info.rig, preset, untouched(part_of(progress, 0, 2)), part_of(progress, 1, 2)
        )

    def show_found(self, found: RigNoise) -> None:
        self.sentence.setText(" ".join(describe(found)))


class AlignmentStep(SetUpStep):
    """Finds points on the membrane's texture and fits the alignment to them."""

    title, intro = "Alignment", "Points found on the membrane's texture."
    two_cameras = True
    button = "Find poi&nts", "Find points in both colour images and fit the alignment"
    wanted = FRAMES

    def known(self, preset: Preset) -> str:
        record = preset.alignment.calibration
        if record is None:
            return ""
        quality = record.quality
        return f"Off by {quality.alignment_px:.2f} px; adds {quality.boundary_error_mm:.2f} mm to the boundary."

    def work(self, kept: list[SensorFrame], info: SourceInfo) -> Work:
        preset = self._document.preset

        def align(progress: Progress) -> tuple[CalibrationReport, bool, dict[str, Any]]:
            rig = info.rig
            snapshot = take_snapshot(kept[: self.wanted], 1, info)
            pairs, _ = find_pairs(Choices(), [snapshot], rig, progress)
            progress(0.9, "Fitting")
            outcome = fit(SessionState((snapshot,), tuple(pairs)), rig)
            if outcome.report is None or not grade(outcome.report.chosen).startswith(("Good", "Usable")):
                problem = outcome.problem if outcome.report is None else outcome.report.verdict
                raise CalibrationError(f"the points found do not tell the alignment; click some: {problem}")
            worse = is_worse(outcome.report, preset)
            return outcome.report, worse, {} if worse else report_changes(outcome.report, preset, [snapshot])

        return align

    def show_found(self, found: tuple[CalibrationReport, bool, dict[str, Any]]) -> None:
        report, worse, _ = found
        kept = " The present alignment is better and stays." if worse else ""
        self.sentence.setText(f"{grade(report.chosen)}{kept}")

    def changes(self) -> dict[str, Any]:
        return dict(self.found[2])


class _Look(NamedTuple):
    """The medians of a frame's tactile image tiles, metres, and whether something presses firmly.

    ``released`` is the opposite: the membrane is farther than in the untouched frame.
    """

    tiles_m: Float64Array
    pressed: bool
    released: bool


class PressStep(SetUpStep):
    """Base of the steps that work on a press: waits until an object is pressed firmly and held.

    ``press`` are the frames of the newest press, which the steps share. Without an untouched frame any frame will do.
    """

    at_rest = False
    prompt, recorded = "Press an object firmly into the membrane and hold it", "Looking for a firm press"

    def __init__(self, context: Context, press: list[SensorFrame]) -> None:
        super().__init__(context)
        self._press = press
        self._untouched: SensorFrame | None = None
        self._free_m: Float64Array | None = None
        self._firmest: SensorFrame  # with the deepest dent, metres: what there is where no press is firm
        self._deepest_m = -np.inf
        #: Only the newest frames of a press stay in memory, however long it takes.
        self._pressed: deque[SensorFrame] = deque(maxlen=_HELD_FRAMES)

    def at_hand(self) -> list[SensorFrame]:
        return [*self._press]

    def prepare(self, info: SourceInfo) -> Work:
        return self.untouched_of(info)

    def prepared(self, found: SensorFrame | None) -> None:
        assert self.info is not None
        self._pressed.clear()
        self._deepest_m = -np.inf
        self._untouched, self._free_m = found, None
        if found is not None:
            self._free_m = tile_medians(found.tactile_depth) * self.info.rig.tactile.depth_unit_m

    def keep(self, frame: SensorFrame) -> _Look:
        assert self.info is not None
        tiles_m = tile_medians(frame.tactile_depth) * self.info.rig.tactile.depth_unit_m
        pressed, released, deepest_m = True, False, 0.0
        if self._free_m is not None:
            nearer_m = self._free_m - tiles_m
            pressed, released = (bool(np.mean(sign * nearer_m > _DENT_M) > _DENTED) for sign in (1, -1))
            deepest_m = float(np.nanpercentile(nearer_m, 99)) if np.isfinite(nearer_m).any() else -np.inf
        if deepest_m >= self._deepest_m:
            self._firmest, self._deepest_m = frame, deepest_m
        if pressed:
            self._pressed.append(frame)
        return _Look(tiles_m, pressed, released)

    def share(self, kept: Sequence[_Look]) -> float:
        return len(kept) / _RECENT if self._free_m is None else len(_held(kept)) / _HELD_FRAMES

    def work(self, kept: list[Any], info: SourceInfo) -> Work:
        if not self.at_hand():
            self._press[:] = [*self._pressed][-len(_held(kept)) :] or [self._firmest]
        return self.measure(tuple(self._press), info)

    def measure(self, pressed: tuple[SensorFrame, ...], info: SourceInfo) -> Work:
        """Return the work on the frames of a press."""
        raise NotImplementedError


def _held(looks: Sequence[_Look]) -> list[_Look]:
    """Return the newest looks at a press that is held still."""
    held: list[_Look] = []
    for look in reversed(looks):
        if not look.pressed or (held and np.nanpercentile(np.abs(look.tiles_m - held[0].tiles_m), 95) > _HELD_M):
            break
        held.append(look)
    return held[::-1]


class BiasStep(PressStep):
    """Measures the bias between the cameras where an object is pressed."""

    title, intro = "Bias", "One firm press, 1,000 mm² or more, held."
    two_cameras = True
    button = "Measure &bias", "Press an object of 1,000 mm² or more firmly into the membrane and hold it"
    field = "noise"

    def known(self, preset: Preset) -> str:
        noise = preset.noise
        if noise is None or noise.bias_from == "unknown":
            return ""
        place = "on the prints" if noise.bias_from == "prints" else "in a firm press"
        return f"{minus(f'{1e3 * noise.bias_m:+z.1f}')} ± {1e3 * noise.bias_sigma_m:.1f} mm, measured {place}."

    def at_hand(self) -> list[SensorFrame]:
        return []  # each measurement has a press of its own

    def prepare(self, info: SourceInfo) -> Work:
        preset, read = self._document.preset, super().prepare(info)

        def check(progress: Progress) -> SensorFrame:
            untouched: SensorFrame | None = read(progress) if preset.untouched is not None else None
            if untouched is None or preset.noise is None:
                raise CalibrationError("the bias needs the untouched frame and the noise: measure these first")
            return untouched

        return check

    def work(self, kept: list[_Look], info: SourceInfo) -> Work:
        if any(look.pressed for look in kept):
            return super().work(kept, info)
        problem = "no firm press was seen; press an object of 1,000 mm² or more, and hold it"
        if any(look.released for look in kept):
            problem = (
                "the membrane is farther away than in the untouched frame, which was captured during a press; go to a "
                "frame where nothing touches it, and capture it again"
            )

        def fail(_: Progress) -> RigNoise:
            raise CalibrationError(problem)

        return fail

    def measure(self, pressed: tuple[SensorFrame, ...], info: SourceInfo) -> Work:
        preset, untouched = self._document.preset, self._untouched
        noise = preset.noise
        assert noise is not None

        def measure(_: Progress) -> RigNoise:
            found = with_bias(noise, pressed, info.rig, preset, untouched)
            if found.bias_from == "unknown":
                raise CalibrationError(
                    "the press was not firm enough; press an object of 1,000 mm² or more, and hold it"
                )
            return found

        return measure

    def show_found(self, found: RigNoise) -> None:
        self.sentence.setText(describe(found)[-1])


class SuggestStep(PressStep):
    """Takes over the suggestions for mask, test and limits, as one undo step."""

    title, intro = "Mask, test and limits", "Suggested from the press."
    button = "&Suggest", "Measure mask, contact test and limits, and take them over"

    def known(self, preset: Preset) -> str:
        done = preset.suggested
        return "" if done is None else f"Suggestions taken over, {done.astimezone():%Y-%m-%d}."

    def measure(self, pressed: tuple[SensorFrame, ...], info: SourceInfo) -> Work:
        preset, untouched = self._document.preset, self.untouched_of(info)
        return lambda progress: suggest_all(
            Evidence(preset, info.rig, pressed[-_RECENT:], untouched(part_of(progress, 0, 2))), part_of(progress, 1, 2)
        )

    def show_found(self, found: AllProposals) -> None:
        taken = [part.label for part in found.parts if part.changes]
        self.sentence.setText(f"{'. '.join(taken) or 'Nothing to change'}.")

    def changes(self) -> dict[str, Any]:
        return {**self.found.merged.changes, "suggested": now()}


class VerdictStep(PressStep):
    """Judges the preset on the press: the error of a patch's boundary and the weakest link."""

    title, intro = "Verdict", "How far the boundary of a patch is off."
    button = "&Judge", "Tell the error of a patch's boundary, and what limits it"
    field = "verdict"

    def known(self, preset: Preset) -> str:
        verdict = preset.verdict
        if verdict is None:
            return ""
        links = sorted(verdict.links_mm.items(), key=lambda link: -link[1])
        shares = ", ".join(f"{link} {error_mm:.1f}" for link, error_mm in links)
        return f"Off by {verdict.error_mm:.1f} mm: {shares}."

    def measure(self, pressed: tuple[SensorFrame, ...], info: SourceInfo) -> Work:
        preset, untouched = self._document.preset, self.untouched_of(info)
        return lambda progress: judge_rig(preset, info.rig, pressed[-1], untouched(progress))

    def show_found(self, found: Verdict) -> None:
        self.sentence.setText(found.sentence)
