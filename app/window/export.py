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
        name = path.name.lower()
        kind = next((kind for suffix, (_, kind) in _CALIBRATIONS.items() if name.endswith(suffix)), None)
        if kind is not None:
            return self._calibration(result, path, kind)
        if path.suffix.lower() in (".mcap", ".h5"):
            return self._recording(result, path)
        if path.suffix.lower() in animation.SUFFIXES:
            frames = self._frames(result)
            return self._animation.work(path, range(*frames), result)
        return self._patch(result, path)

    def _frames(self, result: Result) -> tuple[int, int]:
        """Return the first frame between the marks, or of all, and the one behind the last."""
        if result.source.length is None:
            raise ExportError("a live source is recorded with Record (F9), not exported")
        return self._context.trim or (0, result.source.length)

    def _patch(self, result: Result, path: Path) -> Work:
        def work(_: Progress) -> str:
            if path.suffix.lower() not in SUFFIXES:
                known = ", ".join((*SUFFIXES, ".mcap", ".h5", *animation.SUFFIXES, *_CALIBRATIONS))
                raise ExportError(f"{path.name} does not say what to export; choose one of {known}")
            if result.patch is None:
                raise ExportError("this frame has no patch")
            write_cloud(path, patch_columns(result.patch, result.frame, result.source.rig))
            points = counted(len(result.patch.points), "point")
            return f"Frame {result.frame_number}: {points} written to {path}."

        return work

    def _calibration(self, result: Result, path: Path, kind: str) -> Work:
        preset = self._context.document.preset

        def work(_: Progress) -> str:
            export_calibration(path, kind, result.source.rig, preset)
            return f"The calibration of the cameras was written to {path}."

        return work

    def _recording(self, result: Result, path: Path) -> Work:
        """Return the work that reads the frames between the marks from the file a second time."""
        preset, untouched = self._context.document.preset, result.untouched
        first, end = self._frames(result)

        def work(progress: Progress) -> str:
            with open_source(result.source.name, progress) as source:
                source.seek(first)
                if path.suffix.lower() == ".h5":
                    count = export_hdf5(source, path, end - first, untouched=untouched, progress=progress)
                elif result.patch is None:  # this preset finds none with this rig
                    count = export_mcap(
                        source, path, end - first, preset=preset, untouched=untouched, progress=progress
                    )
                else:
                    count = share_mcap(source, path, end - first, preset, untouched, progress=progress)
            return f"Frames {first} to {end - 1} ({count}) written to {path}."

        return work
