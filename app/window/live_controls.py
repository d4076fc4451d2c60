"""Everything of the window that is about live cameras and recordings, connected to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PyQt6.QtCore import QObject

from ..cameras.control import CAMERAS, CameraControl
from ..rig.check_launcher import CameraChecks
from .recording import RecordingControl

if TYPE_CHECKING:
    from .main_window import MainWindow


class LiveControls(QObject):
    """Owns the recording and the cameras' windows."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        actions, flows = window.actions_, window.file_flows
        self.recording = RecordingControl(
            window.worker,
            window.settings,
            window.messages,
            actions.record,
            window.recording_bar,
            lambda path: window.open_source(f"mcap:{path}"),
        )
        self.cameras = CameraControl(
            window.worker, window.document, window.messages, lambda: window.open_source(CAMERAS), window
        )
        self.checks = CameraChecks(window)
        actions.cameras.triggered.connect(self.cameras.choose)
        actions.camera_settings.triggered.connect(self.cameras.show_panel)
        actions.recordings_folder.triggered.connect(
            lambda: flows.recordings_folder_dialog(self.recording.folder, self.recording.use_folder)
        )

    def close(self) -> None:
        """Close the cameras' windows."""
        self.checks.close()
        self.cameras.close()
