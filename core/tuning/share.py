"""One file for somebody else: frames, preset and untouched frame, and beside them each frame's patch and findings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ..contact.pipeline import ContactPipeline
from ..model.frames import SensorFrame
from ..output.messages import nanoseconds, patch_parts, text
from ..output.writer import export_mcap
from ..preset import Preset
from ..sources.base import FrameSource, Progress
from ..sources.ros.messages import Topic
from .advice.findings import EXAMINED_EVERY, Examiner


def share_mcap(
    source: FrameSource,
    path: Path | str,
    frames: int | None,
    preset: Preset,
    untouched: SensorFrame | None = None,
    *,
    progress: Progress | None = None,
    exclusive: bool = False,
) -> int:
    """Write at most ``frames`` of a source, from its present position, with what a preset makes of them."""
    untouched = source.untouched() if untouched is None else untouched
    pipeline, examiner = ContactPipeline(preset, source.rig, untouched), Examiner(source.rig)
    number, sentences = 0, ""

    def results(frame: SensorFrame) -> Mapping[str, bytes]:
        nonlocal number, sentences
        patch = pipeline.process(frame)
        if number % EXAMINED_EVERY == 0:
            found = examiner.findings(frame, patch, preset, untouched)
            sentences = "\n".join(finding.sentence for finding in found)
        number += 1
        return patch_parts(patch, nanoseconds(frame.proximity_time_s)) | {Topic.FINDINGS: text(sentences)}

    return export_mcap(
        source,
        path,
        frames,
        preset=preset,
        untouched=untouched,
        results=results,
        progress=progress,
        exclusive=exclusive,
    )
