"""The commands ``tactune record`` and ``tactune convert``: any source to a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from ...core.errors import ExportError, PresetError, counted
from .common import (
    CliProgress,
    FrameCount,
    TopicsOption,
    find_rig,
    live_frames,
    number_of_frames,
    open_with_progress,
    refuse_existing,
    say,
    stop_on_signals,
    usable,
    warn,
    with_topics,
)

_Preset = Annotated[
    str | None, typer.Option("--preset", "-p", metavar="FILE|NAME", help="The preset to store in the recording.")
]


def record(
    *,
    source: Annotated[
        str,
        typer.Option("--source", "-s", metavar="SOURCE", help="cameras:, live:SOURCE, or any recording."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE.mcap", help="The new recording.")],
    topics: TopicsOption = None,
    preset: _Preset = None,
    frames: FrameCount = None,
) -> None:
    """Record into a ROS 2 bag (MCAP). Ctrl+C or SIGTERM ends the recording; so does the end of the source.

    All frames of a recording or of the simulator are written, at the speed of the disk. A live source does not wait:
    frames that the disk was too slow for are dropped and counted.
    """
    from ...core.output.writer import SessionWriter
    from ...core.rig.untouched import kept_untouched
    from ...core.sources.presets import load_preset

    if out.suffix != ".mcap":
        raise ExportError(f"--out is {out}, but a recording is a .mcap file; name it so")
    refuse_existing(out)
    kept = None if preset is None else load_preset(preset)
    with open_with_progress(with_topics(source, topics), kept) as opened:
        untouched, rate_hz = usable(kept_untouched(kept, preset, opened)), opened.frame_rate_hz
        live, total, done = opened.length is None, number_of_frames(opened, frames), 0
        with SessionWriter(out, opened.rig, preset=kept, frame_rate_hz=rate_hz, untouched=untouched) as writer:
            with CliProgress() as progress, stop_on_signals() as stopped:
                for frame in live_frames(opened, None, stopped):
                    done += writer.put(frame, wait=not live)  # a frame that the disk was too slow for does not count
                    status = writer.status()
                    dropped = f", {status.dropped} dropped" if status.dropped else ""
                    progress.frames(done, total, f"{status.bytes / 1e6:.0f} MB{dropped}, frames")
                    if status.error or done == total:
                        break
            with stop_on_signals():  # one more signal must not lose the frames that are queued
                status = writer.close()
        if status.error:
            kept_frames = f"; the file holds the {counted(status.frames, 'frame')} before" if status.frames else ""
            raise ExportError(status.error + kept_frames)
        if status.dropped:
            warn(f"{counted(status.dropped, 'frame')} dropped, because the disk was too slow; record to a faster one")
        size = f"{status.seconds:.1f} s, {status.bytes / 1e6:.1f} MB"
        say(f"recorded {counted(status.frames, 'frame')} of {opened.name}, {size}, into {out}")


#: What ``convert`` writes, by the ends of names; anything else is a folder of images.
_KINDS = {".mcap": "mcap", ".h5": "hdf5", ".hdf5": "hdf5", ".urdf": "urdf", ".xacro": "urdf", ".launch.yaml": "ros"}
_CALIBRATIONS = ("ros", "kalibr", "urdf")


def convert(
    *,
    source: Annotated[
        str, typer.Argument(metavar="SOURCE", help="A recording of any kind, or the simulator; a preset or rig.json.")
    ],
    target: Annotated[
        Path,
        typer.Argument(
            metavar="FILE|DIR",
            help="A recording as .mcap, as .h5, or as a new folder of PNG images; a calibration as .urdf, .xacro, "
            ".launch.yaml of static transforms, or camchain.yaml of Kalibr.",
        ),
    ],
    to: Annotated[
        Literal["mcap", "folder", "hdf5", "ros", "kalibr", "urdf"] | None,
        typer.Option(help="What to write, where the target's name does not tell."),
    ] = None,
    topics: TopicsOption = None,
    preset: _Preset = None,
    frames: FrameCount = None,
    share: Annotated[
        bool,
        typer.Option(
            "--share", help="Into .mcap: also the patch and the findings of each frame, by --preset or as tactune run."
        ),
    ] = False,
) -> None:
    """Convert recordings to MCAP, HDF5 or images, calibrations to URDF.

    A calibration is that of a preset or of a recording; Kalibr and ROS read it, too.
    """
    kind = to or _kind_of(target)
    if share and kind != "mcap":
        raise ExportError(f"--share writes one .mcap with all that belongs to a recording; {target} is none")
    if kind != "folder":
        refuse_existing(target)
    if kind in _CALIBRATIONS:
        _convert_calibration(with_topics(source, topics), target, kind, preset)
    else:
        _convert_recording(with_topics(source, topics), target, kind, preset, frames, share)


def _kind_of(target: Path) -> str:
    """Return what a target's name says that it is."""
    if "camchain" in target.name:
        return "kalibr"
    kind = next((kind for suffix, kind in _KINDS.items() if target.name.lower().endswith(suffix)), None)
    if kind is None and target.suffix in (".yaml", ".yml"):
        raise ExportError(f"{target} may be many things; add --to ros for static transforms, or --to kalibr")
    if kind is None and target.suffix[1:].isalnum() and not target.suffix[1:].isdigit():  # take.mp4 is meant as a file
        raise ExportError(
            f"convert writes no {target.suffix} files; end the name of {target} in {', '.join(_KINDS)}, "
            "or add --to folder for a folder of images"
        )
    return kind or "folder"


def _convert_calibration(source: str, target: Path, kind: str, preset: str | None) -> None:
    """Write the calibration of a rig: as a preset states it, or the rig of a recording by itself."""
    from ...core.output.calibration_files import export_calibration
    from ...core.preset.file import shipped_presets
    from ...core.sources.presets import default_preset, load_preset

    origin = default_preset(source) if preset is None else preset
    path = Path(source)
    is_preset = source in shipped_presets() or (path.is_file() and path.suffix == ".json" and path.name != "rig.json")
    if is_preset and preset is None:
        origin = source
    chosen = load_preset(origin)
    rig = chosen.rig if is_preset else find_rig(source)
    if rig is None:
        raise PresetError(f"the preset {source} serves any rig and names none; give a recording, and --preset {source}")
    export_calibration(target, kind, rig, chosen, exclusive=True)
    own = chosen.alignment.rigid.T_proximity_tactile is not None
    say(f"wrote the pose of {f'the preset {chosen.name}' if own else 'the rig, which no preset replaces'}")
    say(f"wrote {target}")


def _convert_recording(
    source: str, target: Path, kind: str, preset: str | None, frames: int | None, share: bool
) -> None:
    """Write the frames of a source, without loss."""
    from ...core.output.hdf5 import export_hdf5
    from ...core.output.writer import export_mcap
    from ...core.rig.untouched import kept_untouched
    from ...core.sources.folder import export_folder
    from ...core.sources.presets import default_preset, load_preset
    from ...core.sources.tactune_files import McapSource
    from ...core.tuning.share import share_mcap

    if share and preset is None:
        preset = default_preset(source)
    kept = None if preset is None else load_preset(preset)
    with open_with_progress(source) as opened, CliProgress() as progress, stop_on_signals() as stopped:
        if kept is None and isinstance(opened, McapSource):
            kept = opened.preset()

        def show(share: float, _: str) -> None:
            if stopped.is_set():
                raise KeyboardInterrupt  # also for SIGTERM: the writers remove what is not complete
            progress.frames(round(share * 100), 100)

        untouched = None if kind == "folder" else usable(kept_untouched(kept, preset, opened))
        if kept is not None and share:
            count = share_mcap(opened, target, frames, kept, untouched, progress=show, exclusive=True)
        elif kind == "mcap":
            count = export_mcap(opened, target, frames, preset=kept, untouched=untouched, progress=show, exclusive=True)
        elif kind == "hdf5":
            count = export_hdf5(opened, target, frames, untouched=untouched, progress=show, exclusive=True)
        else:
            count = export_folder(opened, target, frames, show)
        if kept is not None and kind != "mcap":
            warn(
                f"{'a folder' if kind == 'folder' else 'an HDF5 file'} cannot hold a preset; {kept.name!r} was not "
                "written: give it by --preset to the commands that read the frames"
            )
        if opened.health().message:
            warn(opened.health().message)
    say(f"wrote {counted(count, 'frame')} of {opened.name} to {target}")
