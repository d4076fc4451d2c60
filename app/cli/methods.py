"""Frames of ``tactune run`` and ``tactune evaluate recording``: choose them, run a method, record numbers."""

from __future__ import annotations

import itertools
import re
import time
from collections.abc import Callable, Iterator
from typing import Any

from ...core.contact.pipeline import ContactPatch, ContactPipeline
from ...core.errors import SourceError, TactuneError
from ...core.evaluation.metrics import method_area_mm2
from ...core.methods.method import MethodPatch
from ...core.methods.registry import check_known, make_method, method_kinds, method_names, needs_untouched
from ...core.model.files import finite_or_none
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import Preset
from ...core.sources import FrameSource
from ...core.sources.registry import open_source
from .common import FUSION, warn

#: A function from a frame to its record (numbers for JSON) and its patch.
Step = Callable[[SensorFrame], tuple[dict[str, Any], ContactPatch | MethodPatch]]


def read_untouched(method: str, name: str | None) -> SensorFrame | None:
    """Return the first frame of the source that ``--untouched`` names.

    Raises
    ------
    TactuneError
        The method is unknown or needs no untouched frame, or the source cannot be opened or is empty.
    """
    known = (FUSION, *method_names())
    check_known([method], known)
    if name is None:
        return None
    if not needs_untouched(method):
        raise TactuneError(f"{method} needs no untouched frame; remove --untouched")
    with open_source(name) as source:
        frame = source.next_frame()
    if frame is None:
        raise SourceError(f"--untouched {name} gave no frame; check the source")
    return frame


def make_step(
    method: str,
    preset: Preset,
    preset_origin: str,
    source: FrameSource,
    untouched: SensorFrame | None,
) -> Step:
    """Return the function that processes each frame of a source; warn if the preset's untouched frame cannot be used.

    Parameters
    ----------
    method : str
    preset : Preset
    preset_origin : str
        As given to `load_preset`.
    source : FrameSource
    untouched : SensorFrame or None
        From ``--untouched``; None: the preset's own, else the source's.

    Raises
    ------
    TactuneError
        The method needs an untouched frame and there is none, or it cannot work with this preset and rig.
    """
    if method == FUSION:
        return _fusion_step(ContactPipeline(preset, source.rig))
    if needs_untouched(method) and untouched is None:
        from ...core.rig.untouched import find_untouched  # slow to import, and the pipeline does not need it

        looked_up = find_untouched(preset, preset_origin, source)
        warn(*looked_up.warnings)
        untouched = looked_up.frame
        if untouched is None:
            raise TactuneError(
                f"{method} needs a frame of the untouched membrane, but neither the preset nor {source.name} has "
                "one; capture it with tactune preset capture-untouched, or give --untouched a source or path "
                "whose first frame shows the membrane while nothing touches it"
            )
    found = make_method(method, preset, source.rig, untouched)

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


def patch_record(patch: ContactPatch) -> dict[str, Any]:
    """Return the numbers of a patch, ready for JSON (an empty patch has the centroid None)."""
    return {
        "sequence": int(patch.sequence),
        "points": len(patch.points),
        "area_mm2": finite_or_none(patch.area_mm2),
        "centroid_m": patch.centroid_m,
        "averaged_frames": patch.averaged_frames,
        "stage_ms": {stage: round(ms, 4) for stage, ms in patch.stage_ms.items()},
    }


def frame_range(frame: int | None, frames: str | None) -> tuple[int, int | None]:
    """Return the first and the last frame asked for; None means the source's last.

    Raises
    ------
    TactuneError
        ``--frames`` cannot be read, or ``--frame`` is given beside it.
    """
    if frames is None:
        return (0, None) if frame is None else (frame, frame)
    match = re.fullmatch(r"([0-9]{1,9}):([0-9]{1,9})", frames)
    if match is None or int(match[1]) > int(match[2]) or frame is not None:
        raise TactuneError(f"--frames is {frames!r}; give first:last, such as 0:9, and no --frame beside it")
    return int(match[1]), int(match[2])


def remembered_frames(method: str, preset: Preset) -> int:
    """Return how many frames a method averages: the judged one and those before it."""
    fields = {} if method == FUSION else method_kinds()[method].fields
    return 1 if fields is None else preset.with_values(dict(fields)).averaged_frames


def frames_between(source: FrameSource, first: int, last: int | None, before: int) -> Iterator[tuple[int, SensorFrame]]:
    """Yield (index, frame) from ``first`` to ``last``, preceded by up to ``before`` earlier frames.

    Raises
    ------
    SourceError
        The source ends before the last, or before the first.
    """
    if source.length is not None and max(first, last or 0) >= source.length:
        raise SourceError(f"{source.name} has no frame {max(first, last or 0)}; it has {source.length} frames")
    index = max(0, first - before)
    if source.length is not None:
        source.seek(index)
    else:
        for _ in itertools.islice(source, index):
            pass
    for frame in itertools.islice(source, None if last is None else last + 1 - index):
        yield index, frame
        index += 1
    if index <= first or (last is not None and index <= last):
        raise SourceError(f"{source.name} has no frame {max(first, index)}; it ended after {index} frames")
