"""What ``tactune preset capture-reference`` does."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path

import typer

from ...core.contact.warmup import warm_up_if_needed
from ...core.errors import CalibrationError, PresetError
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import Preset, now
from ...core.preset.file import load_preset, save_preset
from ...core.preset.rig_check import check_rig
from ...core.rig.untouched import CapturedReference, average_untouched, load_reference, save_reference
from ...core.rig.untouched_check import touch_doubts
from ...core.rig.untouched_source import frames_to_average
from ...core.sources.base import FrameSource
from ...core.sources.simulator.source import SimulatorSource
from .progress import CliProgress
from .run import counted, open_with_progress, warn


def capture_into(path: Path, source_name: str, frames: int, *, force: bool) -> None:
    """Average frames of a source into a preset's reference; first the reference is written, then the preset.

    Raises
    ------
    CalibrationError
        The preset's own pipeline finds a contact patch on the membrane, unless ``force``.
    """
    if not path.is_file() or path.suffix == ".mcap":
        raise PresetError(
            f"{path} is no preset file that could keep a reference; make one with tactune preset new, "
            "or copy a shipped one with tactune preset show NAME > FILE"
        )
    preset = load_preset(path)
    with open_with_progress(source_name, preset.cameras) as source:
        for sentence in check_rig(preset, source.rig):
            warn(sentence)
        captured = average(source, frames)
        _check_untouched(preset, path, source.rig, captured.frame, force=force)
        unit_m = source.rig.tactile.depth_unit_m
    record = save_reference(captured.frame, captured.frames, path)
    save_preset(preset.model_copy(update={"reference": record, "modified": now()}), path)
    if captured.frames < frames:
        warn(f"{source.name} ended after {captured.frames} of the {frames} frames asked for")
    typer.echo(f"averaged {counted(captured.frames, 'frame')} of {source.name}{noise_words(captured, unit_m)}")
    typer.echo(f"wrote {path.parent / record.file}, named in {path}")


def average(source: FrameSource, frames: int) -> CapturedReference:
    """Average the next frames of a source, showing how far it is; the simulator takes its object away and says so."""
    if isinstance(source, SimulatorSource):
        warn(f"{source.name} is simulated: its object is taken away for this, so nothing can touch the membrane")
    with frames_to_average(source, frames) as shown, CliProgress() as progress:
        return average_untouched(_counted_out(shown, frames, progress))


def _check_untouched(preset: Preset, path: Path, rig: Rig, membrane: SensorFrame, *, force: bool) -> None:
    """Say what speaks against an untouched membrane, and refuse one that is surely touched."""
    with CliProgress() as progress:
        warm_up_if_needed(progress.preparing)
    for doubt in touch_doubts(preset, rig, membrane, _earlier(preset, path)):
        if doubt.certain and not force:
            raise CalibrationError(f"{doubt.sentence}, or keep it all the same with --force")
        warn(doubt.sentence)


def _earlier(preset: Preset, path: Path) -> SensorFrame | None:
    try:
        return None if preset.reference is None else load_reference(preset.reference, path)
    except PresetError:  # lost or damaged: the new one mends that
        return None


def noise_words(captured: CapturedReference, unit_m: float) -> str:
    """Say how much averaging helped, where that is known."""
    single, averaged = (1e3 * unit_m * counts for counts in captured.noise_counts)
    if math.isnan(single):
        return ""
    return f": noise of the tactile depth {single:.2f} mm in one frame, {averaged:.2f} mm in the reference"


def _counted_out(frames: Iterable[SensorFrame], total: int, progress: CliProgress) -> Iterator[SensorFrame]:
    for number, frame in enumerate(frames, start=1):
        yield frame
        progress.frames(number, total)
