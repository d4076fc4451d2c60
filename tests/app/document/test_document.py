import pytest

from tactune.app.document.document import Document
from tactune.core.preset import now
from tactune.core.sources.presets import load_preset


@pytest.fixture
def document(qtbot, preset):
    return Document(preset)


def test_an_edit_is_one_step_and_undo_brings_back_the_very_same(document, preset):
    seen = []
    document.presetChanged.connect(seen.append)
    assert document.edit("tolerance.t", 0.01)
    assert document.preset.tolerance.t == 0.01
    assert document.undo_stack.undoText() == "Tolerance t 1 %"
    document.undo_stack.undo()
    assert document.preset is preset
    document.undo_stack.redo()
    assert document.preset.tolerance.t == 0.01
    assert [shown.tolerance.t for shown in seen] == [0.01, 0.03, 0.01]


def test_one_drag_is_one_step_and_two_drags_are_two(document):
    for value in (0.01, 0.02, 0.05):
        document.edit("tolerance.t", value, gesture=7)
    document.edit("tolerance.t", 0.06, gesture=8)
    assert document.undo_stack.count() == 2
    document.edit("outliers.k", 5, gesture=8)  # another field
    document.edit("outliers.k", 5)  # the value that it has
    assert document.undo_stack.count() == 3
    document.undo_stack.undo()
    document.undo_stack.undo()
    assert document.preset.tolerance.t == 0.05
    assert document.undo_stack.undoText() == "Tolerance t 5 %"
    document.undo_stack.undo()
    assert document.preset.tolerance.t == 0.03
    for value in (0.04, 0.03):
        document.edit("tolerance.t", value, gesture=9)
    assert document.undo_stack.count() == 0, "a drag that ends where it began is no step"


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("tolerance.t", 2.0, "tolerance.t"),
        ("mask.saturation", (200, 100), "swap"),
        ("mask.huee", 3, "mask.hue"),
        ("outliers.k", "many", "outliers.k"),
    ],
)
def test_a_refused_value_changes_nothing_and_says_why(document, preset, path, value, words):
    said = []
    document.refused.connect(lambda *what: said.append(what))
    assert not document.edit(path, value)
    assert document.preset is preset
    assert document.undo_stack.count() == 0
    assert said[0][0] == path
    assert words in said[0][1]


def test_notes_date_what_was_changed_and_those_that_hold_no_longer_go(tmp_path):
    shipped = load_preset("simulator")
    document = Document(shipped.with_value("notes", f"{shipped.notes}\n\nLamp at the left."))
    document.edit("tolerance.t", 0.01)
    document.save(tmp_path / "own.json")
    today = f"{now():%Y-%m-%d}"
    assert document.preset.notes == f"Lamp at the left.\n\ntolerance: {today}"
    document.edit("mask.enabled", False)
    document.edit("tolerance.t", 0.02)
    document.save(tmp_path / "own.json")
    assert load_preset(tmp_path / "own.json").notes == f"Lamp at the left.\n\nmask: {today}\n\ntolerance: {today}"
