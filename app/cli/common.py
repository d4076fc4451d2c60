"""What several commands share: options, progress, stopping, ``--set``, opening a source, the untouched membrane.

Everything heavy is imported inside the functions, since ``tactune --help`` imports this file.
"""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ...core.errors import PresetError, SourceError, counted, printable

if TYPE_CHECKING:
    from ...core.calibration.snapshots import Snapshot
    from ...core.contact.pipeline import ContactPipeline
    from ...core.model.frames import Rig, SensorFrame
    from ...core.preset import Preset
    from ...core.rig.untouched import FoundUntouched
    from ...core.sources import FrameSource

#: The default source.
SOURCE = "sim"
#: Exit status after Ctrl+C or SIGTERM, as shells use it.
INTERRUPTED_STATUS = 130
#: Number of frames of the untouched membrane that are averaged.
AVERAGED = 15
#: Signals that come within this time are one, seconds.
_ONE_PRESS_S = 1.0
#: Interval at which a command that waits for a live source checks for Ctrl+C, seconds.
WAIT_S = 0.2

SourceOption = Annotated[
    str,
    typer.Option(
        "--source",
        "-s",
        metavar="SOURCE",
        help="Where frames come from: sim, sim:cube (options as in 'sim:cup?seed=3'), cameras:, ros2:, "
        "live:SOURCE, folder:PATH, bag:PATH, mcap:PATH, or a path.",
    ),
]
TopicsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--topics",
        metavar="SLOT=TOPIC,...",
        help="Topics of a ROS recording, or of live ones (ros2:): proximity.depth, proximity.color, proximity.info, "
        "and the same of tactile; may be repeated. They are kept beside a recording.",
    ),
]
UntouchedSource = Annotated[
    str, typer.Option("--source", "-s", metavar="SOURCE", help="Frames while nothing touches the membrane.")
]

PresetOption = Annotated[
    str | None,
    typer.Option(
        "--preset",
        "-p",
        metavar="FILE|NAME",
        help="A preset file or shipped name; default: the recording's own, simulator for sim, else default.",
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="FIELD=VALUE",
        help="Any preset field by its path, such as mask.hue=[150,170] or tolerance.t=0.01; may be repeated. Setting a "
        "field of mask, outliers, range or region turns that section on; one of a contact test chooses that test.",
    ),
]
TruthOption = Annotated[
    bool, typer.Option("--truth", help="Compare with the truth that the source knows, such as the simulator.")
]
FrameCount = Annotated[
    int | None, typer.Option("--frames", "-n", min=1, metavar="N", help="Stop after N frames; default: all.")
]


def chosen_preset(preset: str | None, source: str) -> tuple[Preset, str]:
    """Return the preset that ``--preset`` names, else the source's default, and its origin."""
    from ...core.sources.presets import default_preset, load_preset

    origin = default_preset(source) if preset is None else preset  # an empty name is wrong
    return load_preset(origin), origin


def table_text(records: Sequence[Mapping[str, object]]) -> str:
    """Return records as lines of text under their keys."""
    names = list(dict.fromkeys(name for record in records for name in record))
    rows = [names, *([_cell_text(record.get(name)) for name in names] for record in records)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.rjust, row, widths)) for row in rows)


def _cell_text(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def with_topics(source: str, topics: list[str] | None) -> str:
    """Return the name of a source with the topics that its images are on."""
    if not topics:
        return source
    from ...core.sources.registry import opens_by_name
    from ...core.sources.ros.topics import parse_topics

    named = ",".join(f"{slot}={topic}" for slot, topic in parse_topics(",".join(topics)).items())
    colon = ":" if ":" not in source and opens_by_name(source) else ""
    return f"{source}{colon}?{named}"


def refuse_existing(path: Path) -> None:
    from ...core.model.files import check_writable, taken

    if path.exists():
        raise taken(path)
    check_writable(path)


def say(text: str, *, err: bool = False) -> None:
    """Print text on standard output or error, without the control characters that names may hold."""
    typer.echo(printable(text), err=err)


def warn(*sentences: str) -> None:
    for sentence in sentences:
        say(f"tactune: {sentence}", err=True)


def tell_notes(preset: Preset) -> None:
    """Say on standard error what works in a preset but is probably not intended."""
    from ...core.contact.checks import preset_notes

    for sentence in preset_notes(preset):
        say(f"note: {sentence}", err=True)


class CliProgress(Progress):
    """Progress on standard error: a bar on a terminal, elsewhere one sentence before a long preparation."""

    def __init__(self, quiet: bool = False) -> None:
        on_terminal = sys.stderr.isatty()
        # The bar must not use standard output, which may be a pipe or a file with JSON lines.
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
            disable=quiet or not on_terminal,
        )
        self._shown = self.add_task("", visible=False)
        self._announced = on_terminal

    def preparing(self, share: float, what: str) -> None:
        """Show the share of a preparation that is done, 0 to 1."""
        if 0 < share < 1 and not self._announced:
            self._announced = True
            warn(f"{what} ...")
        self.update(
            self._shown, description=printable(what), completed=round(100 * share), total=100, visible=share < 1
        )

    def frames(self, done: int, total: int | None, what: str = "frames") -> None:
        self.update(self._shown, description=printable(what), completed=done, total=total, visible=True)


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """Yield an event that the first Ctrl+C, SIGTERM or closed terminal sets; the second acts as usual.

    One that follows at once is part of the first, and cuts nothing short. After the block all act as usual.
    """
    stopped, first_s = threading.Event(), math.inf
    ends = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # nohup goes on
        ends.append(signal.SIGHUP)
    usual = {number: signal.getsignal(number) for number in ends}

    def restore() -> None:
        for number, handler in usual.items():
            signal.signal(number, handler)

    def press(number: int, _: object) -> None:
        nonlocal first_s
        if not stopped.is_set():
            first_s = time.monotonic()
            stopped.set()
        elif time.monotonic() - first_s > _ONE_PRESS_S:
            restore()
            signal.raise_signal(number)

    for number in ends:
        signal.signal(number, press)
    try:
        yield stopped
    finally:
        restore()


def parse_settings(texts: Sequence[str] | None) -> dict[str, Any]:
    """Return the preset fields that ``FIELD=VALUE`` texts set; a value is JSON or a bare word.

    A value turns its section on, and chooses the contact test if all values belong to one; the user's own words win.
    """
    from ...core.preset import CONTACT_TESTS
    from ...core.preset.preset import json_or_word, preset_paths

    values: dict[str, Any] = {}
    for text in texts or ():
        path, separator, value = text.partition("=")
        if not separator:
            raise PresetError(f"--set {text}: there is no =; write FIELD=VALUE, such as tolerance.t=0.01")
        values[path.strip()] = json_or_word(value)
    sections = {path.partition(".")[0] for path in values}
    switches: dict[str, Any] = {f"{name}.enabled": True for name in sections if f"{name}.enabled" in preset_paths()}
    chosen = [test.name for test in CONTACT_TESTS.values() if sections & set(test.sections)]
    if len(chosen) == 1:
        switches["contact_test"] = chosen[0]
    return switches | values


@contextmanager
def open_with_progress(name: str, preset: Preset | None = None, *, compiles: bool = False) -> Iterator[FrameSource]:
    """Open a source, live cameras as a preset says; warn where preset and rig do not match, and of lost frames.

    With ``compiles`` what the preset's first frame would wait for is compiled; frames count as lost from then on.
    """
    from ...core.sources.registry import open_source

    with CliProgress() as progress:
        source = open_source(name, progress.preparing, None if preset is None else preset.cameras)
    from ...core.contact.checks import (
        check_rig,
        check_test,
    )  # not above: a wrong name is told before this loads the compiler

    with source:
        if preset is not None:
            warn(*check_rig(preset, source.rig))
        if preset is not None and compiles:
            check_test(preset, source.rig)  # before it compiles for a quarter of a minute
            from ...core.warmup import warm_up_if_needed

            with CliProgress() as progress:
                warm_up_if_needed(progress.preparing, preset)
        lost_before = source.health().dropped
        try:
            yield source
        finally:
            if lost := source.health().dropped - lost_before:
                warn(f"{counted(lost, 'frame')} lost before they got here; end what else uses this computer or its USB")


@contextmanager
def open_pipeline(name: str, preset: Preset, origin: str) -> Iterator[tuple[FrameSource, ContactPipeline]]:
    """Open a source for a preset of this origin, and compile what the first frame would wait for."""
    with open_with_progress(name, preset, compiles=True) as source:
        from ...core.contact.pipeline import ContactPipeline

        yield source, ContactPipeline(preset, source.rig, untouched_for(preset, origin, source))


def untouched_for(preset: Preset, origin: str, source: FrameSource) -> SensorFrame | None:
    """Return the untouched frame that is kept, or that the contact test needs."""
    from ...core.rig.untouched import find_untouched, kept_untouched

    return usable((find_untouched if preset.test.needs_untouched else kept_untouched)(preset, origin, source))


def usable(found: FoundUntouched) -> SensorFrame | None:
    """Return the untouched frame that was found; warn of one that cannot be used."""
    warn(*found.warnings)
    return found.frame


def number_of_frames(source: FrameSource, asked: int | None) -> int | None:
    """Return how many frames a command will read; None if that is unknown."""
    known = [count for count in (source.length, asked) if count is not None]
    return min(known, default=None)


def tell_of_stop(source: FrameSource, done: int, asked: int | None) -> None:
    """After a signal, report the frames done and exit as interrupted, unless all are done or the source is live."""
    total = number_of_frames(source, asked)
    if not done or total not in (None, done):
        warn("stopped after " + (f"{done} of {counted(total, 'frame')}" if total else counted(done, "frame")))
        raise typer.Exit(INTERRUPTED_STATUS)


def live_frames(source: FrameSource, total: int | None, stopped: threading.Event) -> Iterator[SensorFrame]:
    """Yield frames until there are ``total``, the source ends or ``stopped`` is set; `SourceError` if none comes.

    Warns of what happens to the source, and of a depth unit that puts the membrane where it cannot be.
    """
    from ...core.tuning.advice.findings import wrong_unit

    said, count = "", 0
    while count != total and not stopped.is_set():
        if source.health().message != said and (said := source.health().message):
            warn(said)
        if not source.wait(WAIT_S):
            continue
        frame = source.next_frame()
        if frame is None and not count:
            raise SourceError(f"{source.name} gave no frames; check the source")
        if frame is None:
            return
        if not count and (finding := wrong_unit(frame, source.rig)) is not None:
            warn(finding.sentence)
        yield frame
        count += 1


def find_rig(name: str) -> Rig:
    """Return the rig of a rig file, of a preset or of a source of frames."""
    from ...core.model.rig_file import load_rig, read_json_object
    from ...core.sources.presets import load_preset

    path = Path(name)
    if path.is_file() and path.suffix == ".json":
        if "schema" not in read_json_object(path):
            return load_rig(path)
        rig = load_preset(path).rig
        if rig is None:
            raise SourceError(f"the preset {path} serves any rig and names none; give a rig.json or a source of frames")
        return rig
    with open_with_progress(name) as source:
        return source.rig


def measured_elsewhere(preset: Preset, rig: Rig) -> str:
    """Return what a preset holds of measurements on its own rig, in words, if that has other cameras; else nothing."""
    from ...core.contact.checks import for_rig

    here = for_rig(preset, rig)
    parts = {
        "untouched frame": preset.untouched != here.untouched,
        "noise": preset.noise != here.noise,
        "inflation": preset.pressure != here.pressure,
    }
    return ", ".join(name for name, differs in parts.items() if differs)


def average_frames(source: FrameSource) -> Snapshot:
    """Average frames of the untouched membrane; the simulator removes its object, with a warning."""
    from ...core.rig.untouched import average_untouched, frames_to_average
    from ...core.sources.simulator.simulator_source import SimulatorSource

    if isinstance(source, SimulatorSource):
        warn(f"{source.name} is simulated: its object is removed for this, so nothing touches the membrane")
    with frames_to_average(source, AVERAGED) as shown, CliProgress() as progress:
        return average_untouched(counted_out(shown, AVERAGED, progress))


def counted_out(frames: Iterable[SensorFrame], total: int, progress: CliProgress) -> Iterator[SensorFrame]:
    for number, frame in enumerate(frames, start=1):
        yield frame
        progress.frames(number, total)
