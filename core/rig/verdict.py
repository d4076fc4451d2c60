"""The verdict on a rig that was set up: how far the boundary of a patch is off, and which measurement limits it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..contact.pipeline import ContactPipeline
from ..errors import CalibrationError
from ..model.clouds import valid_depth
from ..model.frames import Rig, SensorFrame
from ..model.rig_noise import Link, RigNoise, Verdict
from ..preset import Preset, now

#: Standard deviation of a bias that is as good as known, metres.
_KNOWN_BIAS_M = 0.0001


def _edge_error_mm(pipeline: ContactPipeline, noise: RigNoise, rig: Rig, pressed: SensorFrame) -> float:
    """Return how far the edge of a patch moves if the membrane's depth is off by the noise of a pixel."""
    step = max(round(noise.tactile.total_m / rig.tactile.depth_unit_m), 1)
    counts, radii_mm = pressed.tactile_depth.astype(np.int64), []
    for shift in (-step, step):
        shifted = np.where(valid_depth(pressed.tactile_depth), np.clip(counts + shift, 1, 65534), counts)
        patch = pipeline.process(replace(pressed, tactile_depth=shifted.astype(np.uint16)))
        radii_mm.append(math.sqrt(patch.area_mm2 / math.pi))
    return abs(radii_mm[1] - radii_mm[0]) / 2


def judge_rig(preset: Preset, rig: Rig, pressed: SensorFrame, untouched: SensorFrame | None) -> Verdict:
    """Judge a preset on a frame in which an object is pressed into the membrane."""
    pipeline = ContactPipeline(preset, rig, untouched)
    patch = pipeline.process(pressed)
    if not len(patch.points):
        raise CalibrationError("the preset finds no contact in the frame; press an object in and judge again")
    links: dict[Link, float] = {}
    record = preset.alignment.calibration if rig.has_proximity else None
    if record is not None:  # judged apart from the rest
        links["alignment"] = record.quality.boundary_error_mm
        preset = preset.with_value("alignment.calibration", None)
        pipeline.update(preset)
    doubt = pipeline.process(pressed).doubt
    if math.isfinite(doubt.boundary_error_mm):
        rest_mm = doubt.boundary_error_mm
        if preset.noise is not None and patch.membrane is not None:
            # how much smaller the error would be with a known bias
            known = preset.noise.model_copy(update={"bias_sigma_m": _KNOWN_BIAS_M})
            pipeline.update(preset.model_copy(update={"noise": known}))
            rest_mm = min(rest_mm, pipeline.process(pressed).doubt.boundary_error_mm)
            links["bias"] = math.sqrt(doubt.boundary_error_mm**2 - rest_mm**2)
        links["missing depth" if "too little depth" in doubt.reasons else "noise"] = rest_mm
    elif preset.noise is not None:
        links["noise"] = _edge_error_mm(pipeline, preset.noise, rig, pressed)
    if not links:
        raise CalibrationError("nothing tells the boundary's error; measure the noise or calibrate the alignment")
    return Verdict(links_mm=links, reasons=doubt.reasons, judged=now())
