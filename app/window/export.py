"""Export of what the window shows: the patch, frames or views between the marks, or the calibration, by one dialog."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from PyQt6.QtCore import QObject

from ...core.errors import ExportError, counted
from ...core.output.calibration_files import export_calibration
from ...core.output.cloud_files import SUFFIXES, patch_columns, write_cloud
from ...core.output.hdf5 import export_hdf5
from ...core.output.writer import export_mcap
from ...core.preset import Preset
from ...core.sources.base import split_topics
from ...core.sources.registry import open_source
from ...core.tuning.share import share_mcap
from ...widgets.basics.controls import ProgressCard
from ...widgets.basics.messages import Severity
from ..context import TASK, Context
from ..worker.jobs import Job, Progress, Work
from ..worker.results import Result
from . import animation
from .animation import Animation
from .files import file_name
from .view_area import ViewArea

_PATCH = ["Patch, PLY (*.ply)", "Patch, NumPy (*.npz)", "Patch, table (*.csv)"]
_RECORDING = ["Recording to share: frames, preset, patches (*.mcap)", "Recording, HDF5 (*.h5)"]
_ANIMATION = ["Animation of the views (*.gif)", "Animation of the views (*.mp4)"]
_CALIBRATIONS = {
    ".urdf": ("Calibration, URDF (*.urdf)", "urdf"),
    ".launch.yaml": ("Calibration, static transforms (*.launch.yaml)", "ros"),
    ".camchain.yaml": ("Calibration, Kalibr (*.camchain.yaml)", "kalibr"),
}


class Export(QObject):
    """Exports on a thread; the chosen filter, or the end of a typed name, decides what is written."""

    def __init__(self, context: Context, bar: ProgressCard, views: ViewArea) -> None:
        super().__init__(context)
        self._context, self._animation = context, Animation(context, views)
        self._job = Job(self, partial(self._report, Severity.INFO), partial(self._report, Severity.ERROR))
        self._job.progress.connect(bar.show_share)
        self._job.busyChanged.connect(bar.setVisible)
        bar.cancel.clicked.connect(self._job.cancel)

    def kinds(self) -> list[str]:
        """Return what can be exported now, as filters of names; what the window does not show is not offered."""
        result = self._context.result
        if result is None:
            return []
        two = result.source.rig.has_proximity  # else there is no transform to publish
        calibrations = [title for title, kind in _CALIBRATIONS.values() if two or kind != "ros"]
        recording = [] if result.source.length is None else _RECORDING + _ANIMATION
        return [*([] if result.patch is None else _PATCH), *recording, *calibrations]

    def ask(self, kind: str = "") -> None:
        """Ask for a file, at first of one kind."""
        result = self._context.result
        if result is None:
            return
        filters = sorted(self.kinds(), key=lambda each: each != kind)
        suggestion = f"{file_name(Path(split_topics(result.source.name)[0]).stem)}_{result.frame_number}"
        self._context.dialogs.save_file("export", "Export", suggestion, filters, partial(self._export, result))

    def close(self) -> None:
        """Cancel; a file that is not complete goes."""
        self._job.stop()

    def _report(self, severity: Severity, sentence: str) -> None:
        """Tell how an export ended; an empty sentence: it was cancelled."""
        shown = severity if sentence else Severity.INFO
        self._context.messages.show_message("export", shown, sentence or "Export cancelled.", subject=TASK)

    def _export(self, result: Result, path: Path) -> None:
        self._context.messages.clear_subject(TASK)
        try:
            if self._job.busy:  # a second one would change what an animation is made of
                raise ExportError("an export is running; wait for its end, or cancel it")
            self._job.start(self._work(result, path))
        except ExportError as error:
            self._job.failed.emit(str(error))

    def _work(self, result: Result, path: Path) -> Work:
        name, preset = path.name.lower(), self._context.document.preset
        kind = next((kind for suffix, (_, kind) in _CALIBRATIONS.items() if name.endswith(suffix)), None)
        if kind is not None:
            return partial(_write_calibration, result, path, kind, preset)
        if path.suffix.lower() in (".mcap", ".h5"):
            return partial(_write_recording, result, path, self._frames(result), preset)
        if path.suffix.lower() in animation.SUFFIXES:
            return self._animation.work(path, self._frames(result), result)
        return partial(_write_patch, result, path)

    def _frames(self, result: Result) -> range:
        """Return the frames between the marks, or all."""
        if result.source.length is None:
            raise ExportError("a live source is recorded with Record (F9), not exported")
        return range(*(self._context.trim or (0, result.source.length)))


# On the thread of the job


def _write_patch(result: Result, path: Path, _: Progress) -> str:
    if path.suffix.lower() not in SUFFIXES:
        known = ", ".join((*SUFFIXES, ".mcap", ".h5", *animation.SUFFIXES, *_CALIBRATIONS))
        raise ExportError(f"{path.name} does not say what to export; choose one of {known}")
    if result.patch is None:
        raise ExportError("this frame has no patch")
    write_cloud(path, patch_columns(result.patch, result.frame, result.source.rig))
    return f"Frame {result.frame_number}: {counted(len(result.patch.points), 'point')} written to {path}."


def _write_calibration(result: Result, path: Path, kind: str, preset: Preset, _: Progress) -> str:
    export_calibration(path, kind, result.source.rig, preset)
    return f"The calibration of the cameras was written to {path}."


def _write_recording(result: Result, path: Path, frames: range, preset: Preset, progress: Progress) -> str:
    """Read the frames from the file a second time, and write them."""
    untouched, wanted = result.untouched, len(frames)
    with open_source(result.source.name, progress) as source:
        source.seek(frames.start)
        if path.suffix.lower() == ".h5":
            count = export_hdf5(source, path, wanted, untouched=untouched, progress=progress)
        elif result.patch is None:  # this preset finds none with this rig
            count = export_mcap(source, path, wanted, preset=preset, untouched=untouched, progress=progress)
        else:
            count = share_mcap(source, path, wanted, preset, untouched, progress=progress)
    return f"Frames {frames[0]} to {frames[-1]} ({count}) written to {path}."
