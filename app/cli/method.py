"""What ``tactune run`` does with a frame: the pipeline, or another method behind the same interface."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

from ...core.contact.pipeline import ContactPatch, ContactPipeline
from ...core.errors import SourceError, TactuneError
from ...core.evaluation.metrics import method_area_mm2
from ...core.methods.method import MethodPatch
from ...core.methods.registry import make_method, method_names, needs_reference
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import Preset
from ...core.sources import FrameSource
from ...core.sources.registry import open_source
from .patch_record import patch_record

#: The preset's own pipeline, with whichever alignment it names.
FUSION: Final = "fusion"

#: What can be said of a frame, and its patch.
Step = Callable[[SensorFrame], tuple[dict[str, Any], ContactPatch | MethodPatch]]


def read_reference(method: str, name: str | None) -> SensorFrame | None:
    """Return the first frame of the source that ``--reference`` names.

    Raises
    ------
    TactuneError
        There is no such method, or it needs no reference; or the source cannot be opened or is empty.
    """
    known = (FUSION, *method_names())
    if method not in known:
        raise TactuneError(f"there is no method {method!r}; known are {', '.join(known)}")
    if name is None:
        return None
    if not needs_reference(method):
        raise TactuneError(f"{method} compares with no reference; leave --reference out")
    with open_source(name) as source:
        frame = source.next_frame()
    if frame is None:
        raise SourceError(f"the reference {name} gave no frame; check the source")
    return frame


def make_step(
    method: str,
    preset: Preset,
    preset_origin: str,
    source: FrameSource,
    reference: SensorFrame | None,
    warn: Callable[[str], None],
) -> Step:
    """Build what is done with each frame of a source.

    Parameters
    ----------
    method : str
    preset : Preset
    preset_origin : str
        As `load_preset` took it.
    source : FrameSource
    reference : SensorFrame or None
        From ``--reference``; without it the preset's own is taken, else the source's.
    warn : callable
        Told why the preset's own was not taken.

    Raises
    ------
    TactuneError
        The method needs a reference and there is none, or it cannot work with this preset and rig.
    """
    if method == FUSION:
        return _fusion_step(ContactPipeline(preset, source.rig))
    if needs_reference(method) and reference is None:
        from ...core.rig.untouched import find_reference  # what the pipeline alone need not wait for

        found_reference = find_reference(preset, preset_origin, source)
        for sentence in found_reference.warnings:
            warn(sentence)
        reference = found_reference.frame
        if reference is None:
            raise TactuneError(
                f"{method} compares with the untouched membrane, but neither the preset nor {source.name} keeps a "
                "reference; make one with tactune preset capture-reference, or give --reference a source or path "
                "whose first frame shows the membrane while nothing touches it"
            )
    found = make_method(method, preset, source.rig, reference)

    def step(frame: SensorFrame) -> tuple[dict[str, Any], MethodPatch]:
        started = time.perf_counter_ns()
        patch = found.find(frame)
        return _record(method, frame, patch, (time.perf_counter_ns() - started) / 1e6, source.rig), patch

    return step


def _fusion_step(pipeline: ContactPipeline) -> Step:
    def step(frame: SensorFrame) -> tuple[dict[str, Any], ContactPatch]:
        patch = pipeline.process(frame)
        return patch_record(patch) | {"method": FUSION, "failure": ""}, patch

    return step


def _record(method: str, frame: SensorFrame, patch: MethodPatch, ms: float, rig: Rig) -> dict[str, Any]:
    """Return the numbers of a patch, as `patch_record` names them."""
    points = patch.points
    return {
        "sequence": int(frame.sequence),
        "points": len(points),
        "area_mm2": method_area_mm2(patch, rig),
        "centroid_m": tuple(map(float, points.mean(axis=0, dtype="float64"))) if len(points) else None,
        "averaged_frames": patch.averaged_frames,
        "stage_ms": {method: round(ms, 4)},
        "method": method,
        "failure": patch.failure,
    }
