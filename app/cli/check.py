"""The command ``tactune preset check``: what is wrong with a preset on a frame of a source."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from .common import PresetOption, SourceOption, default_preset, open_with_progress, warn
from .suggest import FrameOption, recent_frames

if TYPE_CHECKING:
    from ...core.tuning.advice.proposal import Finding

#: Exit status if there are findings.
FOUND_STATUS = 1


def check(
    *,
    source: SourceOption,
    preset: PresetOption = None,
    frame: FrameOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as a JSON list.")] = False,
) -> None:
    """Say what is wrong with a preset on a frame, and what mends it; the exit status is 1 if there are findings.

    The same as Findings in the window. The stored untouched frame of the preset or the recording is used too.
    """
    from ...core.contact.pipeline import ContactPipeline
    from ...core.rig.untouched import kept_untouched
    from ...core.sources.presets import load_preset
    from ...core.tuning.advice.findings.registry import Examiner

    origin = preset or default_preset(source)
    chosen = load_preset(origin)
    with open_with_progress(source, chosen.cameras) as opened:
        pipeline = ContactPipeline(chosen, opened.rig)
        warn(*pipeline.warnings)
        frames = recent_frames(opened, frame)
        stored = kept_untouched(chosen, origin, opened)
        warn(*stored.warnings)
        patches = [pipeline.process(each) for each in frames]
        findings = Examiner(opened.rig).findings(frames[-1], patches[-1], chosen, stored.frame)
    if as_json:
        typer.echo(json.dumps([_record(finding) for finding in findings], indent=2))
    else:
        _print(findings)
    if findings:
        raise typer.Exit(FOUND_STATUS)


def _print(findings: tuple[Finding, ...]) -> None:
    for finding in findings:
        typer.echo(f"{finding.field}: {finding.sentence}")
        if finding.proposal is not None:
            typer.echo(f"  {finding.proposal.evidence}")
            for path, value in finding.proposal.changes.items():
                typer.echo(f"  --set {path}={json.dumps(value, separators=(',', ':'))}")
        elif finding.action == "measure_noise":
            typer.echo("  measure the rig: tactune preset measure-rig")
    if not findings:
        typer.echo("no findings")


def _record(finding: Finding) -> dict[str, object]:
    return {
        "name": finding.name,
        "field": finding.field,
        "sentence": finding.sentence,
        "changes": dict(finding.proposal.changes) if finding.proposal is not None else {},
    }
