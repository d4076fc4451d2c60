"""The panel in which a preset is tuned, generated from the preset's model."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel
from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtGui import QColor, QKeySequence, QPalette, QShortcut
from PyQt6.QtWidgets import (
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QScrollArea,
    QSizePolicy,
    QToolButton,
    QWidget,
)

from ...core.model.alignment import CalibrationRecord
from ...core.model.arrays import AnyArray
from ...core.preset import CONTACT_TESTS, Preset
from ..basics.colormaps import MASKED_RGB
from ..basics.controls import CollapsibleSection, tool_button, wrapped_label
from ..basics.fields import FieldSpec, field_spec, section_fields
from ..basics.gestures import new_gesture
from ..basics.layouts import hbox, vbox
from ..images.strip_render import MaskView
from ..plots.histogram import GAP, RELATIVE_DIFFERENCE, LimitHistogram
from .band_slider import RangeEditor, groove_colors
from .parameter_row import COLUMNS, AdvancedFold, ParameterRow, ShownFinding, align_columns

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
    "shrink": ("−", "Shrink: click what the mask wrongly covers, and one range is narrowed to exclude it. Esc stops."),
}


_MASK_VIEWS = {
    MaskView.COLOR: "Show the colour image as it is",
    MaskView.OVERLAY: "Tint what the mask covers in the colour image",
    MaskView.BLACK_WHITE: "Show what the mask covers in white, all else in black",
}


class ParameterPanel(QScrollArea):
    """Shows and edits every tunable value of a preset.

    The panel holds no preset of its own: it shows the one given to `set_preset` and tells what a person does.
    Whoever listens answers with `set_preset`, or with `show_error` where the value is refused.

    Parameters
    ----------
    suggestible : collection of str
        The sections that get a button *Suggest*.

    Signals
    -------
    valueEdited(path: str, value: object, gesture: int)
        All edits of one drag, one burst of keys or one typed number carry the same gesture number.
    valuesEdited(values: dict[str, object], gesture: int)
        A section was reset: several fields at once.
    eyedropperRequested(mode: str)
        "set", "expand", "shrink", or "off".
    maskViewChanged()
        Another way to show the mask was chosen.
    suggestRequested(section: str)
        A proposal for a section is wanted; ``"all"`` for all sections.
    remedyPressed(path: str)
        The button of the finding below a row was pressed.
    """

    valueEdited = pyqtSignal(str, object, int)
    valuesEdited = pyqtSignal(object, int)
    eyedropperRequested = pyqtSignal(str)
    maskViewChanged = pyqtSignal()
    suggestRequested = pyqtSignal(str)
    remedyPressed = pyqtSignal(str)

    def __init__(self, suggestible: Collection[str] = ()) -> None:
        super().__init__()
        self._preset = Preset()
        self._median_m = float("nan")
        self.rows: dict[str, ParameterRow] = {}
        self.sections: dict[str, CollapsibleSection] = {}
        self.section_resets: dict[str, QToolButton] = {}
        self.suggests: dict[str, QToolButton] = {}
        self.eyedroppers: dict[str, QToolButton] = {}
        self.mask_views: dict[MaskView, QToolButton] = {}
        self.masked_share = _note()
        self.alignment_info = _note()
        self._test_note = _note()
        self.tolerance_mm = _note()
        self.folds: dict[str, AdvancedFold] = {}
        self.histograms: dict[str, LimitHistogram] = {}

        content = QWidget()
        column = vbox(within=content, margins=4, spacing=8)
        if suggestible:
            column.addLayout(self._make_suggest_all())
        for name, title in SECTIONS:
            section = self._make_section(name, title)
            if name in suggestible:
                evidence = "the newest frames, the untouched frame and the examples"
                tip = f"Measure {title.lower()} from {evidence}, and propose values"
                section.add_header_widget(self._make_suggest(name, "Suggest", tip), before=self.section_resets[name])
            self.sections[name] = section
            column.addWidget(section)
        self._column = column
        column.addStretch(1)
        align_columns(self.rows.values())
        self._order_tabs()
        self.setWidget(content)
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setMinimumWidth(360)
        self.setAccessibleName("Parameters")

        self._escape = QShortcut(QKeySequence(Qt.Key.Key_Escape), self)
        self._escape.activated.connect(lambda: self._choose_eyedropper("off"))
        self._escape.setEnabled(False)
        self.set_preset(self._preset)
        self.set_baseline(None)

    # --- what is shown -----------------------------------------------------------------------------------------

    def set_preset(self, preset: Preset) -> None:
        """Show a preset; never emits."""
        self._preset = preset
        for path, row in self.rows.items():
            row.show_value(preset.value(path))
        self._show_calibration(preset.alignment.calibration)
        self._refresh()

    def set_baseline(self, preset: Preset | None) -> None:
        """Say what the reset buttons go back to: the loaded or saved preset, or with None the defaults."""
        for path, row in self.rows.items():
            if preset is None:
                row.set_reset_target(Preset().value(path), "default")
            else:
                row.set_reset_target(preset.value(path), f"as in {preset.name}")
        self._refresh()

    def show_error(self, path: str, sentence: str) -> None:
        """Show why a value was refused, below its row, and put the row back to the preset's value."""
        row = self.rows[path]
        row.show_value(self._preset.value(path))
        row.message.show_sentence(sentence)
        self.sections[_section_of(path)].set_collapsed(False)
        self._unfold(path)
        self._refresh()

    def go_to(self, name: str) -> None:
        """Unfold a section, scroll it to the top and give its first control the focus."""
        section = self.sections[name]
        section.set_collapsed(False)
        bar = self.verticalScrollBar()
        if bar is not None:
            bar.setValue(section.y())
        first = next(row for path, row in self.rows.items() if _section_of(path) == name)
        first.tab_stops[0].setFocus(Qt.FocusReason.OtherFocusReason)

    def clear_errors(self) -> None:
        """Remove the sentences on refused values."""
        for row in self.rows.values():
            row.message.show_sentence("")

    def show_findings(self, findings: Mapping[str, ShownFinding]) -> None:
        """Show findings below the rows of their fields, by dotted path, and none below the others."""
        for path, row in self.rows.items():
            if path in findings and not row.finding.sentence:
                self._unfold(path)
            row.finding.show_finding(findings.get(path))

    def _unfold(self, path: str) -> None:
        """Open the fold of an advanced field."""
        if self.rows[path].spec.advanced:
            self.folds[_section_of(path)].set_open(True)

    def set_median_distance_m(self, distance_m: float) -> None:
        """Say at which distance the tolerance is also shown in millimetres; nan hides it."""
        if distance_m != self._median_m:
            self._median_m = distance_m
            self._show_tolerance_mm()

    def set_histogram(
        self, path: str, counts: AnyArray, edges: npt.NDArray[np.floating], limit: float, known: int
    ) -> None:
        """Show what a field limits in the latest frame.

        Parameters
        ----------
        path : str
            The field: ``"tolerance.t"`` or ``"membrane.gap_m"``.
        counts : array, shape (N,)
        edges : array, shape (N + 1,)
            In the unit of the field.
        limit : float
            The value in force; a line that is being dragged stays with the mouse.
        known : int
            Number of all values, with those beyond the edges.
        """
        self.histograms[path].set_data(counts, edges, limit, known)

    def open_histograms(self) -> frozenset[str]:
        """Return the fields whose histograms are not folded away."""
        return frozenset(path for path in self.histograms if not self.sections[_section_of(path)].collapsed)

    def mask_view(self) -> MaskView:
        """Return how the colour image shows the mask."""
        return next(view for view, button in self.mask_views.items() if button.isChecked())

    def show_masked_share(self, share: float | None) -> None:
        """Say how much of the image has the mask's colour; None hides it."""
        self.masked_share.setVisible(share is not None)
        if share is not None:
            swatch = QColor(*MASKED_RGB).name()
            self.masked_share.setText(f'<font color="{swatch}">■</font> {100 * share:.1f} % of the colour image masked')

    def add_section(self, name: str, section: CollapsibleSection) -> None:
        """Append a section that edits no preset field; its fold is remembered with the others."""
        self.sections[name] = section
        self._column.insertWidget(self._column.count() - 1, section)

    def collapsed_sections(self) -> list[str]:
        """Return which sections are folded, to be remembered."""
        return [name for name, section in self.sections.items() if section.collapsed]

    def set_collapsed_sections(self, names: list[str]) -> None:
        """Fold these sections and unfold the others."""
        for name, section in self.sections.items():
            section.set_collapsed(name in names)

    def open_folds(self) -> list[str]:
        """Return the sections whose advanced fields are shown, to be remembered."""
        return [name for name, fold in self.folds.items() if fold.is_open]

    def set_open_folds(self, names: list[str]) -> None:
        """Show the advanced fields of these sections too."""
        for name, fold in self.folds.items():
            fold.set_open(fold.is_open or name in names)

    def enable_measuring(self, enabled: bool) -> None:
        """Enable what looks at a frame: the suggestions and the eyedroppers."""
        for button in (*self.suggests.values(), self.eyedroppers["set"]):
            button.setEnabled(enabled)
        self._enable_eyedroppers()

    def set_eyedropper(self, mode: str) -> None:
        """Show which eyedropper is in use ("off" for none); never emits."""
        for name, button in self.eyedroppers.items():
            button.setChecked(name == mode)
        self._escape.setEnabled(mode != "off")

    def _show_calibration(self, record: CalibrationRecord | None) -> None:
        """Say below the choice of the alignment's model what it comes from and how good it was."""
        if record is not None:
            points = sum(pair.enabled for pair in record.points) - len(record.quality.excluded)
            self.alignment_info.setText(
                f"Calibrated {record.date:%Y-%m-%d}: {record.model}, {points} point{'' if points == 1 else 's'}, "
                f"expected error {record.quality.alignment_px:.2f} px, good for t from "
                f"{100 * record.quality.supported_tolerance:.2f} %"
            )
        self.alignment_info.setVisible(record is not None)

    # --- building ----------------------------------------------------------------------------------------------

    def _make_section(self, name: str, title: str) -> CollapsibleSection:
        section = CollapsibleSection(title)
        grid = QGridLayout(section.body)
        grid.setContentsMargins(8, 4, 4, 4)
        grid.setHorizontalSpacing(4)
        grid.setVerticalSpacing(4)
        grid.setColumnStretch(1, 1)
        for spec in fields_of(name):
            self._add_row(ParameterRow(spec, section), section, grid)
        if name in self.folds:
            grid.addWidget(self.folds[name], grid.rowCount(), 0, 1, COLUMNS)
        if name == "contact_test":
            grid.addWidget(self._test_note, grid.rowCount(), 0, 1, COLUMNS)
        if name == "mask":
            for words, bar in (("Eyedropper", self._make_eyedropper_bar()), ("Show", self._make_mask_view_bar())):
                line = grid.rowCount()
                grid.addWidget(QLabel(words), line, 0)
                grid.addWidget(bar, line, 1, 1, COLUMNS - 1)
            grid.addWidget(self.masked_share, grid.rowCount(), 1, 1, COLUMNS - 1)
        tip, name_of_reset = f"Reset everything in {title.lower()}", f"Reset section {title.lower()}"
        reset = tool_button("", tip, name_of_reset, icon_name="restore")
        reset.clicked.connect(lambda: self._reset_section(name))
        section.add_header_widget(reset)
        self.section_resets[name] = reset
        return section

    def _add_row(self, row: ParameterRow, section: CollapsibleSection, grid: QGridLayout) -> None:
        """Place a row, and below it what belongs to its field."""
        path = row.spec.path
        row.edited.connect(self._row_edited)
        row.finding.pressed.connect(lambda: self.remedyPressed.emit(path))
        self.rows[path] = row
        if row.in_header:
            section.add_header_widget(row.widget)
            grid.addWidget(row.message, grid.rowCount(), 0, 1, COLUMNS)
            grid.addWidget(row.finding, grid.rowCount(), 0, 1, COLUMNS)
        elif row.spec.advanced:
            name = _section_of(path)
            if name not in self.folds:
                fold = self.folds[name] = AdvancedFold(section.title)
                fold.grid.setHorizontalSpacing(grid.horizontalSpacing())
                fold.grid.setVerticalSpacing(grid.verticalSpacing())
                fold.grid.setColumnStretch(1, 1)
            self.folds[name].add(row)
        else:
            row.add_to(grid)
        if path == "alignment.model":
            grid.addWidget(self.alignment_info, grid.rowCount(), 0, 1, COLUMNS)
        if path == "tolerance.t":
            self.tolerance_mm.setAlignment(Qt.AlignmentFlag.AlignRight)
            grid.addWidget(self.tolerance_mm, grid.rowCount(), 0, 1, COLUMNS - 1)
        if path in _HISTOGRAMS:
            histogram = self.histograms[path] = LimitHistogram(_HISTOGRAMS[path], row.spec.default)
            histogram.limitEdited.connect(lambda limit, gesture: self._histogram_dragged(path, limit, gesture))
            grid.addWidget(histogram, grid.rowCount(), 0, 1, COLUMNS)

    def _make_suggest(self, name: str, text: str, tip: str) -> QToolButton:
        button = tool_button(text, tip, text if name == "all" else f"{text} {name.replace('_', ' ')}")
        button.clicked.connect(lambda: self.suggestRequested.emit(name))
        self.suggests[name] = button
        return button

    def _make_suggest_all(self) -> QHBoxLayout:
        title = QLabel("Parameters")
        title.setForegroundRole(QPalette.ColorRole.PlaceholderText)
        button = self._make_suggest("all", "Suggest all", "Propose values for all sections, each with its evidence")
        return hbox((title, 1), button, margins=(4, 0, 4, 0))

    def _make_eyedropper_bar(self) -> QWidget:
        for mode, (text, tooltip) in _EYEDROPPERS.items():
            button = self.eyedroppers[mode] = _bar_button(text, tooltip, f"Eyedropper: {mode}")
            button.clicked.connect(lambda checked, mode=mode: self._choose_eyedropper(mode if checked else "off"))
        return _bar(self.eyedroppers.values())

    def _make_mask_view_bar(self) -> QWidget:
        for view, tooltip in _MASK_VIEWS.items():
            button = self.mask_views[view] = _bar_button(view.value, tooltip, f"Show mask: {view.value}")
            button.clicked.connect(lambda _, view=view: self._choose_mask_view(view))
        self.mask_views[MaskView.OVERLAY].setChecked(True)
        return _bar(self.mask_views.values())

    def _order_tabs(self) -> None:
        """Let Tab go through the panel as one reads it."""
        chain: list[QWidget] = [self.suggests["all"]] if self.suggests else []
        for name, section in self.sections.items():
            rows = [row for path, row in self.rows.items() if _section_of(path) == name]
            header = [row.widget for row in rows if row.in_header]
            suggest = [self.suggests[name]] if name in self.suggests else []
            chain += [section.button, *header, *suggest, self.section_resets[name]]
            for row in sorted(rows, key=lambda row: row.spec.advanced):
                if row.spec.advanced and self.folds[name].button not in chain:
                    chain.append(self.folds[name].button)
                if not row.in_header:
                    chain += [*row.tab_stops, row.reset, row.finding.button]
            if name == "mask":
                chain += [*self.eyedroppers.values(), *self.mask_views.values()]
        for first, second in pairwise(chain):
            QWidget.setTabOrder(first, second)

    # --- reacting ----------------------------------------------------------------------------------------------

    def _row_edited(self, path: str, value: object, gesture: int) -> None:
        self._refresh()
        self.valueEdited.emit(path, value, gesture)

    def _histogram_dragged(self, path: str, limit: float, gesture: int) -> None:
        row = self.rows[path]
        row.show_value(limit)
        row.message.show_sentence("")
        self._row_edited(path, limit, gesture)

    def _reset_section(self, name: str) -> None:
        changed = {
            path: row.reset_target
            for path, row in self.rows.items()
            if _section_of(path) == name and row.editor.value() != row.reset_target
        }
        for path, value in changed.items():
            self.rows[path].show_value(value)
            self.rows[path].message.show_sentence("")
        self._refresh()
        if changed:
            self.valuesEdited.emit(changed, new_gesture())

    def _choose_mask_view(self, chosen: MaskView) -> None:
        for view, button in self.mask_views.items():
            button.setChecked(view is chosen)
        self.maskViewChanged.emit()

    def _choose_eyedropper(self, mode: str) -> None:
        self.set_eyedropper(mode)
        self.eyedropperRequested.emit(mode)

    def _refresh(self) -> None:
        """Bring everything that depends on other values up to date."""
        for name in self.section_resets:
            self._refresh_section(name)
        self._show_alignment_model()
        self._enable_eyedroppers()
        self._show_contact_test(str(self.rows["contact_test"].editor.value()))
        for path, histogram in self.histograms.items():
            histogram.set_limit(float(self.rows[path].editor.value()))
        for fold in self.folds.values():
            fold.open_if_changed()
        self._show_tolerance_mm()
        self._paint_mask_colors()

    def _refresh_section(self, name: str) -> None:
        """Disable a section that is off, and show its reset button where a value differs."""
        rows = [row for path, row in self.rows.items() if _section_of(path) == name]
        enabled = self.rows.get(f"{name}.enabled")
        on = enabled is None or bool(enabled.editor.value())
        for row in rows:
            if row is not enabled:
                row.set_editable(on)
        self.section_resets[name].setVisible(any(row.editor.value() != row.reset_target for row in rows))

    def _show_alignment_model(self) -> None:
        """Show the rows of the chosen model; a homography has its own distance."""
        model = self.rows["alignment.model"].editor.value()
        for path, row in self.rows.items():
            if path.startswith(("alignment.rigid.", "alignment.homography.")):
                row.set_shown(path.split(".")[1] == model)
        matrix = self.rows["alignment.homography.H_p_t"].editor.value()
        self.rows["alignment.homography.plane_distance_m"].set_editable(matrix is None)

    def _show_contact_test(self, chosen: str) -> None:
        for name, test in CONTACT_TESTS.items():
            for section in test.sections:
                self.sections[section].setVisible(name == chosen)
        self._test_note.setText(CONTACT_TESTS[chosen].note)
        self._test_note.show()

    def _enable_eyedroppers(self) -> None:
        """While the mask is off, enable only *Pick*; without a frame, none."""
        mask_on, pick = bool(self.rows["mask.enabled"].editor.value()), self.eyedroppers["set"]
        for button in self.mask_views.values():
            button.setEnabled(mask_on)
        for mode in ("expand", "shrink"):
            button = self.eyedroppers[mode]
            button.setEnabled(mask_on and pick.isEnabled())
            if not mask_on and button.isChecked():
                self._choose_eyedropper("off")

    def _show_tolerance_mm(self) -> None:
        known = np.isfinite(self._median_m) and self._median_m > 0
        t = float(self.rows["tolerance.t"].editor.value())
        self.tolerance_mm.setText(f"= {t * self._median_m * 1000:.1f} mm at {self._median_m:.3f} m" if known else "")
        self.tolerance_mm.setVisible(bool(known))

    def _paint_mask_colors(self) -> None:
        """Show on the mask's sliders the colours that their positions mean."""
        ranges = {name: self.rows[f"mask.{name}"].editor.value() for name in ("hue", "saturation", "value")}
        for name, stops in groove_colors(**ranges).items():
            widget = self.rows[f"mask.{name}"].widget
            if isinstance(widget, RangeEditor):
                widget.set_colors(stops)


def fields_of(section: str) -> list[FieldSpec]:
    """Return the fields that a section of the panel edits."""
    model = Preset.model_fields[section].annotation
    if isinstance(model, type) and issubclass(model, BaseModel):
        return list(section_fields(model, section))
    return [field_spec(Preset, section)]


def _bar_button(text: str, tip: str, name: str) -> QToolButton:
    button = tool_button(text, tip, name, checkable=True)
    button.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
    return button


def _bar(buttons: Iterable[QToolButton]) -> QWidget:
    """Put buttons side by side."""
    bar = QWidget()
    hbox(*((button, 1) for button in buttons), within=bar, margins=0, spacing=4)
    return bar


def _note() -> QLabel:
    """Make an empty line of secondary text."""
    label = wrapped_label()
    label.setForegroundRole(QPalette.ColorRole.PlaceholderText)
    label.hide()
    return label


def _section_of(path: str) -> str:
    return path.partition(".")[0]
