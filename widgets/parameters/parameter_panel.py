"""The panel in which a preset is tuned, generated from the preset's model."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial
from itertools import pairwise

import numpy as np
from pydantic import BaseModel
from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtGui import QColor, QKeySequence, QPalette, QShortcut
from PyQt6.QtWidgets import QLabel, QScrollArea, QSizePolicy, QToolButton, QWidget

from ...core.preset import CONTACT_TESTS, Preset
from ..basics.colormaps import MASKED_RGB
from ..basics.controls import CollapsibleSection, keep_place, new_gesture, tool_button, wrapped_label
from ..basics.fields import FieldSpec, field_spec, section_fields
from ..basics.layouts import hbox, holding, vbox
from ..plots.histogram import GAP, RELATIVE_DIFFERENCE, LimitHistogram
from .form import Form, ParameterRow

#: The sections of the panel, top to bottom: part of the preset, title.
SECTIONS = (
    ("alignment", "Alignment"),
    ("mask", "Mask"),
    ("contact_test", "Contact"),
    *((section, section.capitalize()) for test in CONTACT_TESTS.values() for section in test.sections),
    ("range", "Range"),
    ("region", "Region"),
)

#: What the histogram below a field counts, whose lines are the field's value.
_HISTOGRAMS = {"tolerance.t": RELATIVE_DIFFERENCE, "membrane.gap_m": GAP}

_EYEDROPPERS = {
    "set": (
        "Pick",
        "Pick the colour of the membrane's prints: click one in the image, which also turns the mask on. Esc stops.",
    ),
    "expand": ("+", "Expand: click membrane that the mask misses, and the ranges widen to include it. Esc stops."),
}


class ParameterPanel(QScrollArea):
    """Shows and edits every tunable value of a preset.

    The panel holds no preset of its own: it shows the one given to `set_preset` and tells what a person does.
    Whoever listens answers with `set_preset`, or with `show_error` where the value is refused.
    """

    #: Path, value, gesture: all edits of one drag, one burst of keys or one typed number carry the
    #: same gesture number.
    valueEdited = pyqtSignal(str, object, int)
    #: Values, gesture: a section was reset: several fields at once.
    valuesEdited = pyqtSignal(object, int)
    eyedropperRequested = pyqtSignal(str)  # mode: "set", "expand", or "off"
    suggestRequested = pyqtSignal(str)  # section: a proposal for a section is wanted

    def __init__(self, suggestible: Collection[str] = ()) -> None:
        super().__init__()
        self._preset = Preset()
        self._median_m = float("nan")
        self.rows: dict[str, ParameterRow] = {}
        self.forms: dict[str, Form] = {}
        self.sections: dict[str, CollapsibleSection] = {}
        self.section_resets: dict[str, QToolButton] = {}
        self.suggests: dict[str, QToolButton] = {}
        self.eyedroppers: dict[str, QToolButton] = {}
        tip = "Tint what the mask covers in the colour image"
        self.show_mask = _bar_button("Show", tip, "Show mask")
        self.histograms: dict[str, LimitHistogram] = {}
        self.masked_share, self.alignment_info, self.tolerance_mm = (_note() for _ in range(3))
        self.one_camera = wrapped_label("The proximity camera is not used; other contact tests compare both cameras.")

        content = QWidget()
        self._column = vbox(within=content, margins=(4, 4, 0, 4), spacing=8)
        for name, title in SECTIONS:
            self._column.addWidget(self._make_section(name, title, name in suggestible))
        self._column.addStretch(1)
        for form in self.forms.values():
            form.align_columns()
        self._order_tabs()
        self.setWidget(content)
        self.setWidgetResizable(True)
        self.setFrameShape(QScrollArea.Shape.NoFrame)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setMinimumWidth(364)
        self.setAccessibleName("Parameters")

        self._escape = QShortcut(QKeySequence(Qt.Key.Key_Escape), self)
        self._escape.activated.connect(lambda: self.eyedropperRequested.emit("off"))
        self._escape.setEnabled(False)
        self.set_preset(self._preset)
        self.set_baseline(None)

    # What is shown

    def set_preset(self, preset: Preset) -> None:
        self._preset = preset
        for path, row in self.rows.items():
            row.show_value(preset.value(path))
        record = preset.alignment.calibration
        if record is not None:
            points = sum(pair.enabled for pair in record.points) - len(record.quality.excluded)
            self.alignment_info.setText(
                f"Calibrated {record.date:%Y-%m-%d}: {record.model}, {points} point{'' if points == 1 else 's'}, "
                f"expected error {record.quality.alignment_px:.2f} px, good for t from "
                f"{100 * record.quality.supported_tolerance:.2f} %"
            )
        self.alignment_info.setVisible(record is not None)
        self._refresh()

    def set_baseline(self, preset: Preset | None) -> None:
        """Say what the reset buttons go back to: the loaded or saved preset, or with None the defaults."""
        target, origin = (Preset(), "default") if preset is None else (preset, f"as in {preset.name}")
        for path, row in self.rows.items():
            row.set_reset_target(target.value(path), origin)
        self._refresh()

    def show_error(self, path: str, sentence: str) -> None:
        """Show why a value was refused, below its row, and put the row back to the preset's value."""
        row = self.rows[path]
        row.show_value(self._preset.value(path))
        row.refuse(sentence)
        self._unfold(path)
        self._refresh()

    def clear_errors(self) -> None:
        for row in self.rows.values():
            row.refuse("")

    def go_to(self, path: str) -> None:
        """Unfold the section of a field and give the field the focus."""
        self._unfold(path)
        row = self.rows[path]
        if not row.widget.isEnabled():  # the section is off: show its switch
            row = self.rows.get(f"{_section_of(path)}.enabled", row)
        self._column.activate()  # else the row has no place yet
        self.ensureWidgetVisible(row.widget)
        row.tab_stops[0].setFocus(Qt.FocusReason.ShortcutFocusReason)

    def show_findings(self, findings: Mapping[str, str]) -> None:
        """Mark the fields with which something is wrong, by path, with the sentence that says what."""
        for path, row in self.rows.items():
            row.show_finding(findings.get(path, ""))

    def _unfold(self, path: str) -> None:
        self.sections[_section_of(path)].button.fold(False)
        if self.rows[path].spec.advanced:
            self.forms[_section_of(path)].more.fold(False)

    def set_median_distance_m(self, distance_m: float) -> None:
        """Say at which distance the tolerance is also shown in millimetres; nan hides it."""
        if distance_m != self._median_m:
            self._median_m = distance_m
            self._show_tolerance_mm()

    def open_histograms(self) -> frozenset[str]:
        return frozenset(path for path in self.histograms if not self.sections[_section_of(path)].button.is_folded)

    def show_masked_share(self, share: float | None) -> None:
        """Say how much of the image has the mask's colour; None hides it."""
        self.masked_share.setVisible(share is not None)
        if share is not None:
            swatch = QColor(*MASKED_RGB).name()
            self.masked_share.setText(f'<font color="{swatch}">■</font> {100 * share:.1f} % of the colour image masked')

    def collapsed_sections(self) -> list[str]:
        return [name for name, section in self.sections.items() if section.button.is_folded]

    def set_collapsed_sections(self, names: list[str]) -> None:
        for name, section in self.sections.items():
            section.button.fold(name in names)

    def set_two_cameras(self, two: bool) -> None:
        self.sections["alignment"].setVisible(two)
        self.one_camera.setVisible(two)

    def enable_measuring(self, enabled: bool) -> None:
        for button in (*self.suggests.values(), self.eyedroppers["set"]):
            button.setEnabled(enabled)
        self._enable_eyedroppers()

    def set_eyedropper(self, mode: str) -> None:
        """Show which eyedropper is in use ("off" for none); never emits."""
        for name, button in self.eyedroppers.items():
            button.setChecked(name == mode)
        self._escape.setEnabled(mode != "off")

    # Building

    def _make_section(self, name: str, title: str, suggestible: bool) -> CollapsibleSection:
        section = self.sections[name] = CollapsibleSection(title)
        form = self.forms[name] = Form(title=title.lower())
        vbox(form, within=section.body, margins=0)
        if name == "pressure":
            form.add_line(self.one_camera)
        tip, name_of_reset = f"Reset everything in {title.lower()}", f"Reset section {title.lower()}"
        reset = self.section_resets[name] = tool_button("", tip, name_of_reset, icon_name="restore")
        reset.clicked.connect(lambda: self._reset_section(name))
        keep_place(reset)
        section.header.addWidget(reset)
        for spec in fields_of(name):
            row = self.rows[spec.path] = ParameterRow(spec, section)
            form.add(row)
            if row.in_header:
                section.header.addWidget(row.widget)
            if spec.path == "alignment.model":
                form.add_line(self.alignment_info)
            if spec.path == "tolerance.t":
                self.tolerance_mm.setAlignment(Qt.AlignmentFlag.AlignRight)
                form.add_line(self.tolerance_mm)
            if spec.path in _HISTOGRAMS:
                histogram = self.histograms[spec.path] = LimitHistogram(_HISTOGRAMS[spec.path], spec.default)
                histogram.limitEdited.connect(partial(self._histogram_dragged, spec.path))
                form.add_line(histogram)
        form.edited.connect(self._row_edited)
        if name == "mask":
            for mode, (text, tip) in _EYEDROPPERS.items():
                button = self.eyedroppers[mode] = _bar_button(text, tip, f"Eyedropper: {mode}")
                button.clicked.connect(lambda on, mode=mode: self.eyedropperRequested.emit(mode if on else "off"))
            self.show_mask.setChecked(True)
            buttons = (*self.eyedroppers.values(), self.show_mask)
            bar = hbox(*((button, 1) for button in buttons), margins=0, spacing=4)
            form.add_line(holding(bar), "Eyedropper")
            form.add_line(self.masked_share)
        if suggestible:
            tip = f"Measure {title.lower()} from the newest frames and the untouched frame, and propose values"
            suggest = self.suggests[name] = tool_button("Suggest", tip, f"Suggest {name.replace('_', ' ')}")
            suggest.clicked.connect(lambda: self.suggestRequested.emit(name))
            section.header.addWidget(suggest)
        return section

    def _order_tabs(self) -> None:
        """Let Tab go through the panel as one reads it."""
        chain: list[QWidget] = []
        for name, form in self.forms.items():
            rows = form.rows.values()
            header = [row.widget for row in rows if row.in_header]
            suggest = [self.suggests[name]] if name in self.suggests else []
            chain += [self.sections[name].button, self.section_resets[name], *header, *suggest]
            plain = [row for row in rows if not row.in_header and not row.spec.advanced]
            chain += [stop for row in plain for stop in (*row.tab_stops, row.reset)]
            if name == "mask":
                chain += [*self.eyedroppers.values(), self.show_mask]
            chain.append(form.more)
            chain += [stop for row in form.advanced for stop in (*row.tab_stops, row.reset)]
        for first, second in pairwise(chain):
            QWidget.setTabOrder(first, second)

    # Reacting

    def _row_edited(self, path: str, value: object, gesture: int) -> None:
        if value is True and self.rows[path].in_header:
            self.sections[_section_of(path)].button.fold(False)
        self._refresh()
        self.valueEdited.emit(path, value, gesture)

    def _histogram_dragged(self, path: str, limit: float, gesture: int) -> None:
        self.rows[path].show_value(limit)
        self._row_edited(path, limit, gesture)

    def _reset_section(self, name: str) -> None:
        changed = {path: row.reset_target for path, row in self.forms[name].rows.items() if row.differs()}
        for path, value in changed.items():
            self.rows[path].show_value(value)
        self._refresh()
        if changed:
            self.valuesEdited.emit(changed, new_gesture())

    def _value(self, path: str) -> object:
        return self.rows[path].editor.value()

    def _refresh(self) -> None:
        for name, form in self.forms.items():
            enabled = form.rows.get(f"{name}.enabled")
            for row in form.rows.values():
                if row is not enabled:
                    row.set_editable(enabled is None or bool(enabled.editor.value()))
            self.section_resets[name].setVisible(any(row.differs() for row in form.rows.values()))
            form.open_if_changed()
        model = self._value("alignment.model")
        for path, row in self.rows.items():
            if path.startswith(("alignment.rigid.", "alignment.homography.")):
                row.set_shown(path.split(".")[1] == model)
        matrix = self._value("alignment.homography.H_p_t")  # it has its own distance
        self.rows["alignment.homography.plane_distance_m"].set_editable(matrix is None)
        for name, test in CONTACT_TESTS.items():
            for section in test.sections:
                self.sections[section].setVisible(name == self._value("contact_test"))
        chosen = self.rows["contact_test"]
        chosen.widget.setToolTip(f"{chosen.spec.tooltip}\n{CONTACT_TESTS[chosen.editor.value()].note}")
        for path, histogram in self.histograms.items():
            histogram.set_limit(self.rows[path].editor.value())
        self._enable_eyedroppers()
        self._show_tolerance_mm()
        self._paint_mask_colors()

    def _enable_eyedroppers(self) -> None:
        """While the mask is off, enable only *Pick*; without a frame, none."""
        mask_on, pick = bool(self._value("mask.enabled")), self.eyedroppers["set"]
        self.show_mask.setEnabled(mask_on)
        expand = self.eyedroppers["expand"]
        expand.setEnabled(mask_on and pick.isEnabled())
        if not mask_on and expand.isChecked():
            self.eyedropperRequested.emit("off")

    def _show_tolerance_mm(self) -> None:
        known = np.isfinite(self._median_m) and self._median_m > 0
        t = self.rows["tolerance.t"].editor.value()
        self.tolerance_mm.setText(f"= {t * self._median_m * 1000:.1f} mm at {self._median_m:.3f} m" if known else "")
        self.tolerance_mm.setVisible(bool(known))

    def _paint_mask_colors(self) -> None:
        """Show on the mask's sliders the colours that their positions mean, at the centre of the other two ranges."""
        ranges = [self.rows[f"mask.{name}"].editor.value() for name in ("hue", "saturation", "value")]
        hue = 2 * ((ranges[0][0] + ((ranges[0][1] - ranges[0][0]) % 180) // 2) % 180)
        saturation, value = (sum(span) // 2 for span in ranges[1:])
        for name, colors in (
            ("hue", [QColor.fromHsv(min(h, 358), 230, 230) for h in range(0, 361, 30)]),
            ("saturation", [QColor.fromHsv(hue, s, max(value, 120)) for s in range(0, 256, 51)]),
            ("value", [QColor.fromHsv(hue, saturation, v) for v in range(0, 256, 51)]),
        ):
            self.rows[f"mask.{name}"].editor.slider.set_colors(colors)


def fields_of(section: str) -> list[FieldSpec]:
    model = Preset.model_fields[section].annotation
    if isinstance(model, type) and issubclass(model, BaseModel):
        return list(section_fields(model, section))
    return [field_spec(Preset, section)]


def _bar_button(text: str, tip: str, name: str) -> QToolButton:
    button = tool_button(text, tip, name, checkable=True)
    button.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
    return button


def _note() -> QLabel:
    label = wrapped_label()
    label.setForegroundRole(QPalette.ColorRole.PlaceholderText)
    keep_place(label)  # nothing below moves under the mouse
    label.hide()
    return label


def _section_of(path: str) -> str:
    return path.partition(".")[0]
