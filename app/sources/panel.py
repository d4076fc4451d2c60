"""The cameras' settings: a row for each option that the devices report, and the delay between them."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import (
    QCheckBox,
    QDialog,
    QDialogButtonBox,
    QLabel,
    QWidget,
)

from ...core.preset import CamerasSection, Preset
from ...core.sources.base import CameraHealth, CameraOption, CameraRole
from ...widgets.basics.controls import CollapsibleSection, dialog_buttons, wrapped_label
from ...widgets.basics.fields import FieldSpec, field_spec
from ...widgets.basics.layouts import STRETCH, scrolling, vbox
from ...widgets.parameters.form import Form, ParameterRow

DELAY_PATH = "cameras.tactile_delay_s"
_TITLES: dict[CameraRole, str] = {"proximity": "Proximity camera", "tactile": "Tactile camera"}
_NOT_CONNECTED = (
    "This camera is not connected, or has no settings. When it is connected, its settings appear here with the "
    "preset's values."
)
_NO_CAMERAS = (
    "The current source is a recording or the simulator, without camera settings. Connect cameras (F3): their "
    "settings appear here with the preset's values."
)
#: Above this ratio of a range's ends, such as of exposure times, the slider is logarithmic.
_LOG_SPAN = 500.0


class OptionRow(ParameterRow):
    """The row of one option. Its values are in the device's units, whatever the editor shows.

    Signals
    -------
    chosen(value: float, gesture: int)
    """

    chosen = pyqtSignal(float, int)

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
        if slider is None or not slider.is_held():
            self.show_value(self._shown(value))

    def number(self) -> float:
        """Return the displayed value in the device's units."""
        return self._number(self.editor.value())

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
    """Return the description of an option for its row."""
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

    Signals
    -------
    optionEdited(camera: str, name: str, value: float, gesture: int)
    delayEdited(seconds: float, gesture: int)
    """

    optionEdited = pyqtSignal(str, str, float, int)
    delayEdited = pyqtSignal(float, int)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Camera settings")
        self.rows: dict[tuple[CameraRole, str], OptionRow] = {}
        self.delay = ParameterRow(field_spec(Preset, DELAY_PATH))
        self._options: tuple[CameraOption, ...] = ()
        self._cameras: dict[CameraRole, CameraHealth] = {}
        self._sections = {role: CollapsibleSection(title) for role, title in _TITLES.items()}
        self._bodies: dict[CameraRole, QWidget] = {}
        timing, column = CollapsibleSection("Timing"), QWidget()
        vbox(Form([self.delay]), within=timing.body, margins=0)
        vbox(*self._sections.values(), timing, STRETCH, within=column, margins=4)
        for role, section in self._sections.items():
            vbox(within=section.body, margins=0)
            self._replace_body(role, _note(_NO_CAMERAS))
        buttons = dialog_buttons(QDialogButtonBox.StandardButton.Close)
        buttons.rejected.connect(self.close)
        vbox((scrolling(column), 1), buttons, within=self)
        self.delay.edited.connect(lambda _, value, gesture: self.delayEdited.emit(float(value), gesture))
        self.resize(460, 620)

    def set_cameras(self, cameras: CamerasSection) -> None:
        """Show the preset's values; an option without one shows the camera's value."""
        self.delay.show_value(cameras.tactile_delay_s)
        for (role, name), row in self.rows.items():
            row.show_number(getattr(cameras, role).options.get(name, row.option.value))

    def set_options(self, options: tuple[CameraOption, ...], cameras: CamerasSection) -> None:
        """Show the options that the devices report now."""
        before, self._options = self._options, options
        for role in _TITLES:
            present, former = ([each for each in some if each.camera == role] for some in (options, before))
            if [replace(option, value=0.0) for option in present] != [replace(option, value=0.0) for option in former]:
                self._rebuild(role, present)
        for option in options:
            self.rows[option.camera, option.name].option = option
        self.set_cameras(cameras)

    def set_health(self, cameras: tuple[CameraHealth, ...]) -> None:
        """Show which devices have the two roles; a source without cameras has none."""
        self._cameras = {camera.role: camera for camera in cameras}
        for role, title in _TITLES.items():
            camera = self._cameras.get(role)
            device = "" if camera is None else camera.model
            serial = f"(serial {camera.serial})" if camera is not None and camera.serial else ""
            self._sections[role].button.setText(" ".join(filter(None, (title, device, serial))))
            body = self._bodies[role]
            if isinstance(body, QLabel):
                body.setText(self._why_nothing(role))

    def _rebuild(self, role: CameraRole, options: list[CameraOption]) -> None:
        self.rows = {key: row for key, row in self.rows.items() if key[0] != role}
        rows = {(role, option.name): OptionRow(option) for option in options}
        for (_, name), row in rows.items():
            row.chosen.connect(partial(self.optionEdited.emit, role, name))
        self.rows |= rows
        self._replace_body(role, Form(rows.values()) if rows else _note(self._why_nothing(role)))

    def _why_nothing(self, role: CameraRole) -> str:
        return _NOT_CONNECTED if role in self._cameras else _NO_CAMERAS

    def _replace_body(self, role: CameraRole, body: QWidget) -> None:
        if (old := self._bodies.get(role)) is not None:
            old.hide()
            old.deleteLater()
        self._bodies[role] = body
        layout = self._sections[role].body.layout()
        assert layout is not None
        layout.addWidget(body)


def _note(text: str) -> QLabel:
    label = wrapped_label(text)
    label.setContentsMargins(8, 4, 8, 8)
    return label
