"""Export of many frames: a recording or a patch file for each, of the frames between the in and out marks."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from PyQt6.QtCore import QObject

from ...core.contact.pipeline import ContactPipeline
from ...core.errors import SourceError
from ...core.model.frames import note_number
from ...core.output.cloud_files import patch_cloud, write_cloud
from ...core.output.writer import export_mcap
from ...core.preset import Preset
from ...core.sources.base import FrameSource
from ...core.sources.registry import open_source
from ...widgets.basics.controls import ProgressCard
from ...widgets.basics.messages import Severity
from ..context import TASK, Context
from ..worker.jobs import Job, Progress

#: Exports the frames of a range from an open source, and returns what was written as a sentence.
_Export = Callable[[FrameSource, range, Progress], str]


class FrameExport(QObject):
    """Exports frames of the open recording, read from the file a second time, on a thread."""

    def __init__(self, context: Context, bar: ProgressCard) -> None:
        super().__init__(context)
        self._context, self._bar = context, bar
        self._job = Job(self)
        self._job.progress.connect(bar.show_share)
        self._job.busyChanged.connect(bar.setVisible)
        self._job.done.connect(
            lambda sentence: context.messages.show_message("export", Severity.INFO, sentence, subject=TASK)
        )
        self._job.failed.connect(
            lambda sentence: context.messages.show_message(
                "export",
                Severity.ERROR if sentence else Severity.INFO,
                sentence or "The export was cancelled.",
                subject=TASK,
            )
        )
        bar.cancel.clicked.connect(self._job.cancel)

    def ask_recording(self) -> None:
        """Ask for a file, and export the frames as a recording with the present preset."""
        preset, untouched = self._context.document.preset, self._context.worker.recorder.untouched

        def write(path: Path, source: FrameSource, frames: range, progress: Progress) -> str:
            count = export_mcap(source, path, len(frames), preset=preset, untouched=untouched, progress=progress)
            return f"{_counted(count, frames)} written to {path}."

        if self._frames() is not None:
            self._context.dialogs.save_file(
                "export",
                "Export recording",
                "part.mcap",
                ["Recording (*.mcap)"],
                lambda path: self._start(partial(write, path)),
            )

    def ask_patches(self) -> None:
        """Ask for a folder, and export the patch of each frame as a PLY file."""
        preset = self._context.document.preset

        def chosen(folder: Path) -> None:
            self._start(lambda source, frames, progress: _write_patches(source, frames, preset, folder, progress))

        if self._frames() is not None:
            self._context.dialogs.open_folder("export", "Export patches into a folder", chosen)

    def close(self) -> None:
        """Cancel; a file that is not complete goes."""
        self._job.stop()

    def _frames(self) -> range | None:
        """Return the frames between the marks, or all; None if there is nothing to export or an export runs."""
        result = self._context.result
        if result is None or result.source.length is None or self._job.busy:
            return None
        return range(*(self._context.trim or (0, result.source.length)))

    def _start(self, export: _Export) -> None:
        result, frames = self._context.result, self._frames()
        if result is None or frames is None:
            return
        name = result.source.name

        def work(progress: Progress) -> str:
            with open_source(name, progress) as source:
                source.seek(frames.start)
                return export(source, frames, progress)

        self._context.messages.clear_subject(TASK)
        self._job.start(work)


def _write_patches(source: FrameSource, frames: range, preset: Preset, folder: Path, progress: Progress) -> str:
    pipeline = ContactPipeline(preset, source.rig)
    seen: set[int] = set()
    for done, index in enumerate(frames):
        progress(done / len(frames), f"Patch {done + 1} of {len(frames)}, into {folder}")
        frame = source.next_frame()
        if frame is None:
            raise SourceError(f"{source.name} ends before frame {index + 1}; {done} patches were written to {folder}")
        note_number(seen, frame)
        cloud = patch_cloud(pipeline.process(frame), frame, source.rig)
        write_cloud(folder / f"patch_{frame.sequence:06d}.ply", cloud)
    return f"{_counted(len(frames), frames)} written as patches to {folder}."


def _counted(count: int, frames: range) -> str:
    where = f" {frames.start + 1} to {frames.stop}" if count > 1 else f" {frames.start + 1}"
    return f"Frame{'s' if count > 1 else ''}{where} ({count})"
