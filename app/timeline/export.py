"""Export of the frames between the in and out marks as a recording."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from PyQt6.QtCore import QObject

from ...core.output.writer import export_mcap
from ...core.sources.registry import open_source
from ...widgets.basics.controls import ProgressCard
from ...widgets.basics.messages import Severity
from ..context import TASK, Context
from ..worker.jobs import Job, Progress


class FrameExport(QObject):
    """Exports frames of the open recording, read from the file a second time, on a thread."""

    def __init__(self, context: Context, bar: ProgressCard) -> None:
        super().__init__(context)
        self._context = context
        self._job = Job(self)
        self._job.progress.connect(bar.show_share)
        self._job.busyChanged.connect(bar.setVisible)
        report = partial(context.messages.show_message, "export", subject=TASK)
        self._job.done.connect(partial(report, Severity.INFO))
        self._job.failed.connect(
            lambda sentence: report(Severity.ERROR if sentence else Severity.INFO, sentence or "Export cancelled.")
        )
        bar.cancel.clicked.connect(self._job.cancel)

    def ask(self) -> None:
        """Ask for a file, and export the frames with the present preset."""
        if self._context.result is not None and not self._job.busy:
            self._context.dialogs.save_file(
                "export", "Export recording", "part.mcap", ["Recording (*.mcap)"], self._export
            )

    def close(self) -> None:
        """Cancel; a file that is not complete goes."""
        self._job.stop()

    def _export(self, path: Path) -> None:
        result = self._context.result
        if result is None or result.source.length is None or self._job.busy:
            return
        name, preset = result.source.name, self._context.document.preset
        first, end = self._context.trim or (0, result.source.length)
        untouched = self._context.worker.recorder.untouched

        def work(progress: Progress) -> str:
            with open_source(name, progress) as source:
                source.seek(first)
                count = export_mcap(source, path, end - first, preset=preset, untouched=untouched, progress=progress)
            return f"Frames {first + 1} to {end} ({count}) written to {path}."

        self._context.messages.clear_subject(TASK)
        self._job.start(work)
