"""Writes the patch of one frame to a file, off the GUI thread."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtCore import QObject, QRunnable, QThreadPool, pyqtSignal

from ...core.errors import TactuneError
from ...core.recording.cloud_files import patch_cloud, write_cloud
from ..worker.results import Result
from .message_bar import MessageBar, Severity


class _Report(QObject):
    written = pyqtSignal(str)
    failed = pyqtSignal(str)


class _Export(QRunnable):
    """Writes and reports; the report's signals arrive on the GUI thread."""

    def __init__(self, result: Result, path: Path, report: _Report) -> None:
        super().__init__()
        self._result, self._path, self._report = result, path, report

    def run(self) -> None:
        patch = self._result.patch
        assert patch is not None
        try:
            write_cloud(self._path, patch_cloud(patch, self._result.frame, self._result.source.rig))
        except TactuneError as error:
            self._report.failed.emit(str(error))
        else:
            number = self._result.frame_number
            self._report.written.emit(f"Frame {number}: {len(patch.points)} points written to {self._path}.")


def export_patch(result: Result, path: Path, messages: MessageBar) -> None:
    """Write the patch of a result in the background and say how it went."""
    report = _Report(messages)
    report.written.connect(lambda sentence: messages.show_message("export", Severity.INFO, sentence))
    report.failed.connect(lambda sentence: messages.show_message("export", Severity.ERROR, sentence))
    for signal in (report.written, report.failed):
        signal.connect(report.deleteLater)
    pool = QThreadPool.globalInstance()
    assert pool is not None
    pool.start(_Export(result, path, report))
