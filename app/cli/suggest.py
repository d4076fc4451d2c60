"""The commands ``tactune preset suggest`` and ``findings``: proposals for a preset, and what is wrong with it."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...core.errors import AdviceError
from .common import CliProgress, PresetOption, SourceOption, chosen_preset, open_with_progress, say, usable, warn
from .preset import check_target, save_changed

if TYPE_CHECKING:
    from ...core.model.frames import SensorFrame
    from ...core.sources import FrameSource
    from ...core.tuning.advice.proposal import Finding

#: Exit status of ``findings`` if there are findings.
FOUND_STATUS = 1
#: Number of frames up to the present one.
_RECENT = 4

FrameOption = Annotated[
    int | None, typer.Option(min=0, metavar="N", help="The present frame, from 0; default: the fourth.")
]


def suggest(
    *,
    source: SourceOption,
    preset: PresetOption = None,
    section: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SECTION",
            help="mask, contact_test, alignment, tolerance or pressure; may be repeated. Default: all that the "
            "contact test reads.",
        ),
    ] = None,
    frame: FrameOption = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="The preset file to write, with all suggestions.")
    ] = None,
) -> None:
    """Suggest values, with the evidence for each.

    Later ones are computed with the earlier ones applied. The evidence is the present frame, the three before it, and
    the untouched frame of the preset or the source. Nothing is written without --out.
    """
    if out is not None:
        check_target(out, preset)
    chosen, origin = chosen_preset(preset, source)
    with open_with_progress(source, chosen) as opened:
        from ...core.rig.untouched import find_untouched  # after a wrong source was told
        from ...core.tuning.advice.proposal import Evidence
        from ...core.tuning.advice.suggest import suggest_all
        from ...core.warmup import warm_up_if_needed

        frames = _recent_frames(opened, frame)
        with CliProgress() as progress:
            untouched = find_untouched(chosen, origin, opened, progress.preparing)
        evidence = Evidence(chosen, opened.rig, frames, usable(untouched))
    with CliProgress() as progress:
        warm_up_if_needed(progress.preparing)
        proposals = suggest_all(evidence, progress.preparing, section)
    if not proposals.parts:
        raise AdviceError("; ".join(proposals.refusals.values()))
    for part in proposals.parts:
        say(f"{part.section}: {part.label}")
        say("\n".join([f"  {part.evidence}", f"  {part.expected}", *_as_options(part.changes)]))
    warn(*proposals.refusals.values())
    if out is not None:
        save_changed(proposals.merged.apply(chosen), origin, out)
        say(f"wrote {out}")


def findings(
    *,
    source: SourceOption,
    preset: PresetOption = None,
    frame: FrameOption = None,
) -> None:
    """Say what is wrong with a preset on a frame.

    Also what mends it; the exit status is 1 if there are findings. The same as Findings in the window. The stored
    untouched frame of the preset or the recording is used too.
    """
    chosen, origin = chosen_preset(preset, source)
    with open_with_progress(source, chosen) as opened:
        from ...core.contact.pipeline import ContactPipeline  # after a wrong source was told
        from ...core.rig.untouched import kept_untouched
        from ...core.tuning.advice.findings import Examiner, unusable_test

        untouched = usable(kept_untouched(chosen, origin, opened))
        unusable = unusable_test(chosen, opened.rig, untouched)
        frames = _recent_frames(opened, frame) if unusable is None else ()
    found: tuple[Finding, ...] = () if unusable is None else (unusable,)
    if unusable is None:
        from ...core.warmup import warm_up_if_needed

        with CliProgress() as progress:
            warm_up_if_needed(progress.preparing, chosen)
        pipeline = ContactPipeline(chosen, opened.rig, untouched)
        patches = [pipeline.process(each) for each in frames]
        found = Examiner(opened.rig).findings(frames[-1], patches[-1], chosen, untouched)
    for finding in found:
        say(f"{finding.field}: {finding.sentence}")
        if finding.proposal is not None:
            say("\n".join([f"  {finding.proposal.evidence}", *_as_options(finding.proposal.changes)]))
        elif finding.action == "measure_noise":
            say("  measure the rig: tactune preset measure-rig")
    if not found:
        say("no findings")
    else:
        raise typer.Exit(FOUND_STATUS)


def _recent_frames(source: FrameSource, last: int | None) -> tuple[SensorFrame, ...]:
    first = 0 if last is None else max(last - _RECENT + 1, 0)
    if last is not None and source.length is not None and last >= source.length:
        raise AdviceError(f"{source.name}: there is no frame {last}; its frames run from 0 to {source.length - 1}")
    if first and source.length is not None:
        source.seek(first)
    elif first:  # cameras cannot seek
        deque(islice(source, first), maxlen=0)
    frames = tuple(islice(source, _RECENT if last is None else last + 1 - first))
    if not frames or (last is not None and len(frames) < last + 1 - first):
        raise AdviceError(f"{source.name}: there is no frame {last or 0}; choose another --frame or source")
    return frames


def _as_options(changes: Mapping[str, object]) -> list[str]:
    return [f"  --set {path}={json.dumps(value, separators=(',', ':'))}" for path, value in changes.items()]
