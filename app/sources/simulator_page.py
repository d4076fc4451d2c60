"""The page *Simulator*: the parts of a simulator's name as fields."""

from __future__ import annotations

from PyQt6.QtCore import QSignalBlocker
from PyQt6.QtWidgets import QComboBox, QDoubleSpinBox, QFormLayout

from ...core.errors import SourceError
from ...core.sources.simulator.names import (
    NAME_FIELDS,
    NameField,
    changed_values,
    is_accepted,
    read_name,
    write_name,
)
from ...widgets.basics.controls import caption
from .pages import SourcePage

#: What an empty choice means, by its field.
_EMPTY = {"press": "moving", "move": "as the scene does"}


class SimulatorPage(SourcePage):
    """Offers every scene with its options. What the chosen scene does not have is disabled."""

    title = "Simulator"

    def __init__(self) -> None:
        super().__init__()
        self.values = read_name("")
        self.editors: dict[str, QComboBox | QDoubleSpinBox] = {}
        form = QFormLayout(self)
        form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        for field in NAME_FIELDS:
            editor = self._combo(field) if field.choices else self._number(field)
            editor.setAccessibleName(field.title)
            self.editors[field.key] = editor
            form.addRow(caption(field.title, editor), editor)
        self._show()

    def show_name(self, name: str) -> bool:
        """Move the fields to a simulator's name."""
        scheme, _, rest = name.partition(":")
        if scheme != "sim":
            return False
        self.values = read_name(rest)
        self._show()
        return True

    def _combo(self, field: NameField) -> QComboBox:
        combo = QComboBox()
        combo.setToolTip(field.about)
        for value, about in field.choices.items():
            word = value or _EMPTY[field.key]
            combo.addItem(f"{word} – {about}" if about else word, value)
        combo.setMinimumContentsLength(24)
        combo.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        combo.activated.connect(lambda index: self._edited(field.key, combo.itemData(index)))
        return combo

    def _number(self, field: NameField) -> QDoubleSpinBox:
        box = QDoubleSpinBox()
        box.setRange(0.0, field.maximum)
        box.setDecimals(field.decimals)
        box.setSuffix(f" {field.unit}" if field.unit else "")
        box.setSingleStep(1.0)
        box.setKeyboardTracking(False)
        box.setToolTip(f"{field.about} (0 to {field.maximum:,.0f}{box.suffix()})")
        box.valueChanged.connect(lambda value: self._edited(field.key, f"{value:.10g}"))
        return box

    def _edited(self, key: str, value: str) -> None:
        try:
            self.values = changed_values(self.values, key, value)
        except SourceError as error:
            self._show()
            self._choose(self.name, str(error))
            return
        self._show()
        self.changed.emit()

    def _show(self) -> None:
        """Show the values, and disable what the scene does not have."""
        self.name, self.note = write_name(self.values), ""
        for field in NAME_FIELDS:
            editor, value = self.editors[field.key], self.values[field.key]
            with QSignalBlocker(editor):
                if isinstance(editor, QComboBox):
                    editor.setCurrentIndex(editor.findData(value))
                    editor.setEnabled(any(self._goes(field.key, other) for other in field.choices if other != value))
                else:
                    editor.setValue(float(value))
                    editor.setEnabled(self._goes(field.key, f"{field.maximum:.10g}"))

    def _goes(self, key: str, value: str) -> bool:
        """Return whether a value can be chosen; a scene always can, since other fields follow it."""
        return key == "scene" or is_accepted(self.values | {key: value})
