"""The table of faults: what breaks after a rig was measured, and how often the patch is then wrong without a word.

Each fault is laid over simulated touches and hovers with known truth. A patch is silent where its probability of
touching is `SURE` or more and it states no boundary error of `LARGE_MM` or more.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

import cv2
import numpy as np

from ..contact.pipeline import ContactPipeline
from ..model.arrays import BoolArray
from ..model.frames import Rig, SensorFrame, pose_matrix
from ..model.patch import SURE
from ..preset import Preset
from ..rig.noise import measure_noise
from ..rig.untouched import average_untouched
from ..sources.simulator.objects import HELD_OUT
from ..sources.simulator.scenes import MEMBRANES, Variant
from ..sources.simulator.sensors import DEFAULT_SENSOR
from ..sources.simulator.simulator_source import SimulatorSource
from .table import FIRST_HELD_OUT_SEED, aligned

#: A large error of the boundary, mm.
LARGE_MM: Final = 3.0
#: Frames of the measurement of the rig, and cells of the membranes' meshes, which are half as fine as those of a table.
_FRAMES, _CELLS = 20, (118, 68)
#: Frames of an approach that pass the first touch by 1.5 and by 4.5 mm.
_LIGHT: Final = (6, 8)

#: Brightness of the prints in the light of the untouched frame.
_VALUES: Final = (110, 255)

_ImageFault = Callable[[SensorFrame, np.random.Generator], SensorFrame]


@dataclass(frozen=True)
class Fault:
    """Something that breaks: other errors of the sensor, other images, or another pose than the preset believes."""

    about: str
    sensor: dict[str, Any] = field(default_factory=dict)  # Added to fields of the `SensorModel`; flags are set
    images: _ImageFault = lambda frame, rng: frame
    turn_deg: float = 0.0  # Of the tactile camera about its y axis since the calibration
    from_start: bool = False  # Also while the rig is measured
    mask: bool = True


def _dimmed(factors: tuple[float, float, float], frame: SensorFrame, rng: np.random.Generator) -> SensorFrame:
    dimmed = np.asarray(frame.proximity_color * np.array(factors, np.float32), np.uint8)
    return replace(frame, proximity_color=dimmed)


def _without_depth(share: float, frame: SensorFrame, rng: np.random.Generator) -> SensorFrame:
    images = []
    for image in (frame.proximity_depth, frame.tactile_depth):
        lost = rng.random(image.shape, np.float32) < share
        images.append(np.where(lost, np.uint16(0), image))
    return replace(frame, proximity_depth=images[0], tactile_depth=images[1])


def _scaled_tactile(factor: float, frame: SensorFrame, rng: np.random.Generator) -> SensorFrame:
    scaled = np.where(frame.tactile_depth < 65535, np.round(frame.tactile_depth * factor), 65535)
    return replace(frame, tactile_depth=scaled.astype(np.uint16))


FAULTS: Final[dict[str, Fault]] = {
    "none": Fault("nothing"),
    "tof+1.5": Fault("time of flight drifts by +1.5 mm", {"tof_offset_m": 0.0015}),
    "tof-1.5": Fault("time of flight drifts by -1.5 mm", {"tof_offset_m": -0.0015}),
    "no-prints": Fault(
        "no prints on the membrane, bias -1.2 mm", {"tof_offset_m": -0.0012, "prints_reflect": False},
        from_start=True, mask=False,
    ),
    "peeled": Fault("prints no longer reflect", {"prints_reflect": False}),
    "light": Fault("light dims to half", images=partial(_dimmed, (0.5, 0.5, 0.5))),
    "warm": Fault("light becomes warmer", images=partial(_dimmed, (1.0, 0.85, 0.6))),
    "holes": Fault("30 % of the pixels without depth", images=partial(_without_depth, 0.3)),
    "patches": Fault("15 % of the tactile depth missing in patches", {"stereo_hole_share": 0.15}),
    "turned": Fault("tactile camera turned by 0.2 degrees", turn_deg=0.2),
    "scale": Fault("tactile depth grows by 0.5 %", images=partial(_scaled_tactile, 1.005)),
    "slope": Fault("bias slopes by 2 mm over the image", {"tof_slope_m": 0.002}),
    "noise": Fault(
        "noise doubles", {"tof_white_m": 0.0002, "tof_correlated_m": 0.00086, "stereo_correlated_px": 0.09}
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Trial:
    """A simulated touch, or a hover over the membrane at a gap."""

    object: str
    variant: Variant
    seed: int
    frame: int = 0

    @property
    def touches(self) -> bool:
        return not self.variant.gap_mm


@dataclass(frozen=True)
class Outcome:
    """What a patch claims, and what is true."""

    fault: str
    trial: Trial
    claimed: bool
    probability: float
    stated_mm: float
    error_mm: float  # Mean distance between both boundaries; nan where the patch or the contact is empty

    @property
    def sure(self) -> bool:
        """Whether it is claimed without a doubt that it touches."""
        return self.claimed and self.probability >= SURE

    @property
    def silent(self) -> bool:
        """Whether no large error of the boundary is stated, either."""
        return self.sure and not self.stated_mm >= LARGE_MM


def trials(objects: Sequence[str], membranes: Sequence[str], seed: int) -> list[Trial]:
    """Return as many hovers as touches: presses and gaps over the first membrane, and the first object over others."""
    found: list[Trial] = []
    for name in objects:
        presses = [Variant("low"), Variant("medium"), Variant("high"), Variant("high", "left")]
        gaps = [Variant(gap_mm=gap) for gap in (0.5, 1.0, 2.0, 5.0)]
        found += [
            Trial(name, replace(each, membrane=membranes[0]), seed, len(found) % 20) for each in (*presses, *gaps)
        ]
    found += [Trial(name, Variant(membrane=membranes[0]), seed, frame) for name in objects[:2] for frame in _LIGHT]
    for number, membrane in enumerate(membranes[1:], 1):
        each = [Variant("medium"), Variant(gap_mm=2.0 + number)]
        found += [Trial(objects[0], replace(variant, membrane=membrane), seed + number) for variant in each]
    return found


def try_faults(preset: Preset, sensor: str = DEFAULT_SENSOR, *, held_out: bool = False) -> Iterator[list[Outcome]]:
    """Yield the outcomes of all trials for one fault after another; ``held_out``: on what nothing was developed on."""
    objects = HELD_OUT if held_out else ("cup", "octopus", "cube", "tray")
    membranes = tuple(name for name in MEMBRANES if name.startswith("held-") == held_out and name != "sticky")
    chosen = trials(objects, membranes, FIRST_HELD_OUT_SEED if held_out else 0)
    if preset.mask.value[0] < _VALUES[0]:
        preset = preset.with_value("mask.value", _VALUES)
    sources = [
        SimulatorSource(trial.object, trial.seed, cells=_CELLS, variant=trial.variant, sensor=sensor)
        for trial in chosen
    ]
    rigs: dict[tuple[str, int, str], tuple[Preset, SensorFrame]] = {}
    for name, fault in FAULTS.items():
        found = []
        for number, (trial, source) in enumerate(zip(chosen, sources, strict=True)):
            key = trial.variant.membrane, trial.seed, name if fault.from_start else ""
            if key not in rigs:
                rigs[key] = _measured(preset, source.with_object_away(), fault)
            found.append(_outcome(name, trial, source, *rigs[key], number))
        yield found


def _measured(preset: Preset, away: SimulatorSource, fault: Fault) -> tuple[Preset, SensorFrame]:
    """Return the preset with the noise and bias of a rig, and its untouched frame."""
    if fault.from_start:
        away = _with_fault(away, fault)
        preset = preset.with_value("mask.enabled", fault.mask)
    frames = list(itertools.islice(away, _FRAMES))
    noise = measure_noise(frames, away.rig, preset)
    return preset.model_copy(update={"noise": noise}), average_untouched(frames[:15]).frame


def _with_fault(source: SimulatorSource, fault: Fault) -> SimulatorSource:
    changes: dict[str, Any] = {
        name: value if isinstance(value, bool) else getattr(source.sensor, name) + value
        for name, value in fault.sensor.items()
    }
    return source.with_sensor(replace(source.sensor, **changes))


def _outcome(
    name: str, trial: Trial, source: SimulatorSource, preset: Preset, untouched: SensorFrame, number: int
) -> Outcome:
    fault = FAULTS[name]
    rng = np.random.default_rng([trial.seed, number])
    frame = fault.images(_with_fault(source, fault).read(trial.frame), rng)
    rig = _turned(source.rig, fault.turn_deg)
    patch = ContactPipeline(preset, rig, untouched).process(frame)
    truth = frame.truth
    assert truth is not None  # the simulator knows it
    error_mm = np.nan
    if len(patch.points) and truth.contact.any():
        pixel_mm = 1e3 * float(np.median(patch.points[:, 2])) / rig.proximity.intrinsics.fx
        error_mm = pixel_mm * boundary_distance_px(patch.mask, truth.contact)
    doubt = patch.doubt
    return Outcome(name, trial, len(patch.points) > 0, doubt.touch_probability, doubt.boundary_error_mm, error_mm)


def _turned(rig: Rig, degrees: float) -> Rig:
    """Return the rig with the pose that a preset believes although the tactile camera has turned."""
    if degrees == 0.0:
        return rig
    turn = cv2.Rodrigues(np.radians([0.0, degrees, 0.0]))[0]
    matrix = np.array(rig.T_proximity_tactile) @ pose_matrix(turn, np.zeros(3))
    return rig.model_copy(update={"T_proximity_tactile": tuple(map(tuple, matrix.tolist()))})


def boundary_distance_px(mask: BoolArray, truth: BoolArray) -> float:
    """Return the mean distance between the boundaries of two masks that are not empty, both ways, pixels."""
    edges = [each & ~cv2.erode(each.view(np.uint8), np.ones((3, 3), np.uint8)).view(np.bool_) for each in (mask, truth)]
    away = [cv2.distanceTransform((~edge).view(np.uint8), cv2.DIST_L2, 5) for edge in edges]
    return float(away[1][edges[0]].mean() + away[0][edges[1]].mean()) / 2


def faults_text(outcomes: Sequence[Outcome]) -> str:
    """Return the table: a line for each fault."""
    lines = [
        ["fault", "", "touches missed", "doubted", "hovers claimed", "without doubt", "boundary mm", "silent > 3 mm"]
    ]
    for name in dict.fromkeys(outcome.fault for outcome in outcomes):
        mine = [outcome for outcome in outcomes if outcome.fault == name]
        touches = [outcome for outcome in mine if outcome.trial.touches]
        hovers = [outcome for outcome in mine if not outcome.trial.touches]
        claimed = [outcome for outcome in touches if outcome.claimed]
        errors = [outcome.error_mm for outcome in claimed]
        lines.append([
            name, FAULTS[name].about,
            f"{len(touches) - len(claimed)}/{len(touches)}",
            f"{sum(not outcome.silent for outcome in claimed)}",
            f"{sum(outcome.claimed for outcome in hovers)}/{len(hovers)}",
            f"{sum(outcome.sure for outcome in hovers)}",
            f"{np.mean(errors):.1f}" if errors else "-",
            f"{sum(outcome.silent and outcome.error_mm > LARGE_MM for outcome in claimed)}",
        ])  # fmt: skip
    return aligned(lines)
