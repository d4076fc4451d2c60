"""The settings of the cameras, which are stored in the preset."""

from __future__ import annotations

from dataclasses import replace

from PyQt6.QtCore import QObject

from ...core.preset import CamerasSection, Preset
from ...core.sources.base import CameraOption, CameraRole
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.messages import Severity
from ..context import Context
from ..worker.results import SourceInfo, SourceState
from .cameras_page import CAMERA_SCHEMES, CAMERAS
from .panel import DELAY_PATH, CameraPanel


class CameraControl(QObject):
    """Opens the settings panel.

    A setting is an undoable edit of the preset. Every change of the preset is sent to the cameras.

    """

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self._worker, self._document, self._messages = context.worker, context.document, context.messages
        self._cameras = self._document.preset.cameras
        self._options: tuple[CameraOption, ...] = ()
        self._source = ""
        self.panel = CameraPanel(context.window)
        self.panel.set_cameras(self._cameras)
        self.panel.optionEdited.connect(self._option_edited)
        self.panel.delayEdited.connect(lambda value, gesture: self._document.edit(DELAY_PATH, value, gesture))
        self._document.presetChanged.connect(self._preset_changed)
        self._worker.opened.connect(self._opened)
        self._worker.optionsChanged.connect(self._options_changed)
        self._worker.optionRefused.connect(
            lambda sentence: self._messages.show_message("camera option", Severity.WARNING, sentence)
        )
        self._worker.stateChanged.connect(self._state_changed)

    def show_panel(self) -> None:
        """Show the settings, or bring them to the front."""
        bring_up(self.panel)

    def close(self) -> None:
        """Close the panel."""
        self.panel.close()

    def _open_cameras(self) -> None:
        self._context.sourceRequested.emit(CAMERAS)

    def _option_edited(self, role: CameraRole, name: str, value: float, gesture: int) -> None:
        options = dict(getattr(self._document.preset.cameras, role).options)
        default = next((o.default for o in self._options if (o.camera, o.name) == (role, name)), None)
        if value == default:
            options.pop(name, None)
        else:
            options[name] = value
        self._document.edit(f"cameras.{role}.options", options, gesture)

    def _preset_changed(self, preset: Preset) -> None:
        """Send changed settings to the cameras."""
        before, self._cameras = self._cameras, preset.cameras
        if before == preset.cameras:
            return
        self._options = tuple(self._sent(option, before) for option in self._options)
        self.panel.set_options(self._options, preset.cameras)
        if _needs_reopening(before, preset.cameras) and self._source.startswith(CAMERA_SCHEMES):
            self._messages.show_message(
                "cameras",
                Severity.INFO,
                "The preset has other cameras or another delay. They take effect when the cameras are opened again.",
                offers=[("Open again", self._open_cameras)],
            )

    def _sent(self, option: CameraOption, before: CamerasSection) -> CameraOption:
        """Send an option whose value in the preset has changed; without a value, send the default."""
        kept = _kept(self._cameras, option)
        if kept == _kept(before, option):
            return option
        value = option.default if kept is None else kept
        self._worker.set_option(option.camera, option.name, value)
        return replace(option, value=value)

    def _opened(self, info: SourceInfo) -> None:
        self._source = info.name
        self.panel.set_health(())
        self._messages.clear("cameras")
        self._messages.clear("camera option")

    def _options_changed(self, options: tuple[CameraOption, ...]) -> None:
        self._options = options
        self.panel.set_options(options, self._document.preset.cameras)

    def _state_changed(self, state: SourceState) -> None:
        self.panel.set_health(state.health.cameras)


def _kept(cameras: CamerasSection, option: CameraOption) -> float | None:
    """Return a preset's value of an option, or None."""
    value: float | None = getattr(cameras, option.camera).options.get(option.name)
    return value


def _needs_reopening(before: CamerasSection, after: CamerasSection) -> bool:
    serials = [(cameras.proximity.serial, cameras.tactile.serial) for cameras in (before, after)]
    return serials[0] != serials[1] or before.tactile_delay_s != after.tactile_delay_s
