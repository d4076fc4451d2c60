"""The settings of the cameras: a row for each option that the devices report; their values are in the preset."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QCheckBox, QDialog, QDialogButtonBox, QLabel, QWidget

from ...core.preset import CamerasSection, Preset
from ...core.sources.base import CameraOption, CameraRole
from ...widgets.basics.controls import CollapsibleSection, dialog_buttons, wrapped_label
from ...widgets.basics.fields import FieldSpec, field_spec
from ...widgets.basics.layouts import STRETCH, holding, scrolling, vbox
from ...widgets.basics.messages import Severity
from ...widgets.parameters.form import Form, ParameterRow
from ..context import Context
from ..worker.results import SourceInfo
from .cameras_page import CAMERAS

DELAY_PATH = "cameras.tactile_delay_s"
_TITLES: dict[CameraRole, str] = {"proximity": "Proximity camera", "tactile": "Tactile camera"}
_NO_SETTINGS = (
    "There is no camera with settings here. Connect cameras (F3): their settings appear here with the preset's values."
)
#: Above this ratio of a range's ends, such as of exposure times, the slider is logarithmic.
_LOG_SPAN = 500.0


class OptionRow(ParameterRow):
    """The row of one option, in the device's units."""

    chosen = pyqtSignal(float, int)  # value, gesture

    def __init__(self, option: CameraOption, parent: QWidget | None = None) -> None:
        super().__init__(option_spec(option), parent)
        self.option = option
        if isinstance(self.widget, QCheckBox):
            self.widget.setText("on")
        self.set_reset_target(self._shown(option.default), "the camera's default")
        self.edited.connect(lambda _, shown, gesture: self.chosen.emit(self._number(shown), gesture))
        self.show_number(option.value)
        self.set_editable(not option.read_only)

    def show_number(self, value: float) -> None:
        """Show the device's value, unless the slider is being dragged."""
        slider = getattr(self.widget, "slider", None)
        if slider is None or not slider.clock.held:
            self.show_value(self._shown(value))

    def _shown(self, value: float) -> Any:
        if self.spec.kind == "choice":
            nearest = min(self.option.choices, key=lambda choice: abs(choice[0] - value))
            return nearest[1]
        if self.spec.kind == "flag":
            return value >= 0.5
        return round(value) if self.spec.integer else value

    def _number(self, shown: Any) -> float:
        if self.spec.kind == "choice":
            return next(value for value, name in self.option.choices if name == shown)
        return float(shown)


def option_spec(option: CameraOption) -> FieldSpec:
    title = option.name.replace("_", " ").replace("-", " ").capitalize()
    common: dict[str, Any] = {
        "path": f"cameras.{option.camera}.options.{option.name}",
        "title": title,
        "description": option.description or title,
    }
    if option.choices:
        names = tuple(name for _, name in option.choices)
        return FieldSpec(kind="choice", choices=names, default=names[0], **common)
    if (option.minimum, option.maximum, option.step) == (0.0, 1.0, 1.0):
        return FieldSpec(kind="flag", default=option.default >= 0.5, **common)
    integer = all(float(number).is_integer() for number in (option.minimum, option.maximum, option.step))
    log = option.minimum > 0 and option.maximum / option.minimum > _LOG_SPAN
    return FieldSpec(
        kind="number",
        default=option.default,
        unit=option.unit,
        suffix=f" {option.unit}" if option.unit else "",
        minimum=option.minimum,
        maximum=option.maximum,
        slider=(option.minimum, option.maximum),
        step=option.step or (option.maximum - option.minimum) / 200.0 or 1.0,
        integer=integer and option.step >= 1.0,
        log=log,
        **common,
    )


class CameraPanel(QDialog):
    """Shows the settings of both cameras; stays open beside the main window.

    A setting is an undoable edit of the preset, and every change of the preset is sent to the cameras.
    """

    def __init__(self, context: Context) -> None:
        super().__init__(context.window)
        self.setWindowTitle("Camera settings")
        self._context = context
        self._worker, self._document, self._messages = context.worker, context.document, context.messages
        self._cameras = self._document.preset.cameras
        self._options: tuple[CameraOption, ...] = ()
        self._source = ""
        self.rows: dict[tuple[CameraRole, str], OptionRow] = {}
        self.delay = ParameterRow(field_spec(Preset, DELAY_PATH))
        self._sections = {role: CollapsibleSection(title) for role, title in _TITLES.items()}
        self._bodies: dict[CameraRole, QWidget] = {}
        timing = CollapsibleSection("Timing")
        vbox(Form([self.delay]), within=timing.body, margins=0)
        column = holding(vbox(*self._sections.values(), timing, STRETCH, margins=4))
        for role, section in self._sections.items():
            vbox(within=section.body, margins=0)
            self._rebuild(role, [])
        buttons = dialog_buttons(QDialogButtonBox.StandardButton.Close)
        buttons.rejected.connect(self.close)
        vbox((scrolling(column), 1), buttons, within=self)
        self.resize(460, 620)
        self.delay.edited.connect(lambda _, value, gesture: self._document.edit(DELAY_PATH, float(value), gesture))
        self._document.presetChanged.connect(self._preset_changed)
        self._worker.opened.connect(self._opened)
        self._worker.optionsChanged.connect(self._show_options)
        self._worker.optionRefused.connect(
            lambda sentence: self._messages.show_message("camera option", Severity.WARNING, sentence)
        )
        self._show_options(())

    def _show_options(self, options: tuple[CameraOption, ...]) -> None:
        """Show the preset's values; an option without one shows the camera's value."""
        before, self._options, cameras = self._options, options, self._document.preset.cameras
        for role in _TITLES:
            present, former = ([each for each in some if each.camera == role] for some in (options, before))
            if [replace(option, value=0.0) for option in present] != [replace(option, value=0.0) for option in former]:
                self._rebuild(role, present)
        self.delay.show_value(cameras.tactile_delay_s)
        for option in options:
            row, kept = self.rows[option.camera, option.name], _kept(cameras, option)
            row.option = option
            row.show_number(option.value if kept is None else kept)

    def _rebuild(self, role: CameraRole, options: list[CameraOption]) -> None:
        rows = {(role, option.name): OptionRow(option) for option in options}
        for (_, name), row in rows.items():
            row.chosen.connect(partial(self._edit, role, name))
        self.rows = {key: row for key, row in self.rows.items() if key[0] != role} | rows
        if (old := self._bodies.get(role)) is not None:
            old.hide()
            old.deleteLater()
        body = self._bodies[role] = Form(rows.values()) if rows else _note(_NO_SETTINGS)
        layout = self._sections[role].body.layout()
        assert layout is not None
        layout.addWidget(body)

    def _edit(self, role: CameraRole, name: str, value: float, gesture: int) -> None:
        options = dict(getattr(self._document.preset.cameras, role).options)
        default = next((o.default for o in self._options if (o.camera, o.name) == (role, name)), None)
        if value == default:
            options.pop(name, None)
        else:
            options[name] = value
        self._document.edit(f"cameras.{role}.options", options, gesture)

    def _preset_changed(self, preset: Preset) -> None:
        before, self._cameras = self._cameras, preset.cameras
        if before == preset.cameras:
            return
        self._show_options(tuple(self._sent(option, before) for option in self._options))
        opened_with = [
            (cameras.proximity.serial, cameras.tactile.serial, cameras.tactile_delay_s)
            for cameras in (before, preset.cameras)
        ]
        if opened_with[0] != opened_with[1] and self._source.startswith(CAMERAS):
            self._messages.show_message(
                "cameras",
                Severity.INFO,
                "The preset has other cameras or another delay. They take effect when the cameras are opened again.",
                offers=[("Open again", partial(self._context.sourceRequested.emit, CAMERAS))],
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
        self._messages.clear("cameras")
        self._messages.clear("camera option")


def _note(text: str) -> QLabel:
    label = wrapped_label(text)
    label.setContentsMargins(8, 4, 8, 8)
    return label


def _kept(cameras: CamerasSection, option: CameraOption) -> float | None:
    """Return a preset's value of an option, or None."""
    value: float | None = getattr(cameras, option.camera).options.get(option.name)
    return value
