"""The window's preset: edits, undo, notes, what is kept for a crash, and its untouched frame."""

import itertools
import shutil

import pytest
from PyQt6.QtCore import Qt, QTimer
from PyQt6.QtTest import QTest

from fakes import tiny_frame, tiny_rig
from hands import press, text_of
from tactune.app.document.document import Document, UntouchedStore
from tactune.app.document.recovery import Autosave, unsaved_work
from tactune.core.errors import PresetError
from tactune.core.output.writer import SessionWriter
from tactune.core.preset import Preset, now
from tactune.core.rig.untouched import load_untouched
from tactune.core.sources.presets import load_preset


@pytest.fixture
def document(qtbot, preset):
    return Document(preset)


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


def test_a_refused_value_changes_nothing_and_says_why(document, preset):
    said = []
    document.refused.connect(lambda *what: said.append(what))
    assert not document.edit("mask.saturation", (200, 100))
    assert document.preset is preset
    assert document.undo_stack.count() == 0
    assert said[0][0] == "mask.saturation"
    assert "swap" in said[0][1]


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


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "unsaved"


def crash(autosave):
    """End as a killed process does: the file stays, the lock is free."""
    autosave.flush()
    autosave.close(keep=True)


def test_it_is_kept_while_a_person_edits_without_a_pause(document, folder, qtbot):
    autosave = Autosave(document, folder)
    values = itertools.cycle([0.01, 0.02, 0.03])
    timer = QTimer()
    timer.timeout.connect(lambda: document.edit("tolerance.t", next(values)))
    timer.start(50)
    qtbot.waitUntil(autosave.file.exists)
    assert timer.isActive()
    timer.stop()
    autosave.close()


def test_nothing_is_left_after_saving_undoing_or_a_normal_end(document, folder, tmp_path):
    autosave = Autosave(document, folder)
    document.edit("tolerance.t", 0.01)
    autosave.flush()
    document.save(tmp_path / "mine.json")
    crash(autosave)
    assert unsaved_work(folder) == []

    autosave = Autosave(document, folder)
    document.edit("tolerance.t", 0.02)
    autosave.flush()
    autosave.close()
    assert unsaved_work(folder) == []


def test_restored_work_is_kept_anew_before_the_old_file_goes(document, folder, preset):
    autosave = Autosave(document, folder)
    document.edit("tolerance.t", 0.01)
    crash(autosave)
    [work] = unsaved_work(folder)
    second = Document(preset)
    again = Autosave(second, folder)
    second.restore(work.preset, work.path)
    again.take_over(work)
    crash(again)
    assert not work.file.exists()
    assert [kept.preset.tolerance.t for kept in unsaved_work(folder)] == [0.01]


RIG = tiny_rig()


@pytest.fixture
def store(tmp_path):
    return UntouchedStore(tmp_path / "store")


@pytest.fixture
def captured(qapp, store):
    """A new preset with a captured untouched frame, not saved yet."""
    made = Document(Preset(name="new"))
    made.untouched_store = store
    made.edit("untouched", store.keep(tiny_frame(0, RIG), 15).model_dump())
    return made


def kept_beside(path):
    return load_untouched(load_preset(path).untouched, path).tactile_depth


# Saving


def test_the_untouched_frame_goes_wherever_the_preset_is_saved(captured, tmp_path):
    first, renamed, elsewhere = (tmp_path / name for name in ("a/one.json", "a/two.json", "b/three.json"))
    for path in (first, renamed, elsewhere):
        captured.save(path)
        assert (kept_beside(path) == tiny_frame(0, RIG).tactile_depth).all()
        assert captured.untouched_home == path
    assert len(list(first.parent.glob("*.npz"))) == 1
    opened = Document()
    opened.open(first)
    opened.save(tmp_path / "c" / "four.json")  # without a store, as from a script
    assert kept_beside(tmp_path / "c" / "four.json").any()


def test_a_lost_untouched_frame_is_a_warning_when_saving(captured, tmp_path):
    warnings = []
    captured.warned.connect(warnings.append)
    for file in (tmp_path / "store").glob("*.npz"):
        file.unlink()
    captured.save(tmp_path / "mine.json")
    assert load_preset(tmp_path / "mine.json").untouched is not None
    assert "mine.json was saved without its untouched frame" in warnings[0]
    with pytest.raises(PresetError, match="missing"):
        kept_beside(tmp_path / "mine.json")


# The window


def capture(qtbot, window):
    window.actions_.capture_untouched.trigger()
    step = window.set_up.untouched.work
    step.wanted = 3
    QTest.mouseClick(step.start, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: window.document.preset.untouched is not None)


def test_a_captured_untouched_frame_outlives_a_crash(qtbot, window, make_window, tmp_path):
    capture(qtbot, window)
    record = window.document.preset.untouched
    window.autosave.flush()
    qtbot.waitUntil(window.autosave.file.exists)
    shutil.copy(window.autosave.file, window.context.data_folder / "unsaved-0.json")  # as of a window that has died
    after = make_window()
    after.file_flows.offer_unsaved_work()
    press(after.messages.by_key.get("recovery"), "Restore")
    assert after.document.preset.untouched == record and after.document.dirty
    assert after.messages.by_key.get("recovery") is None
    qtbot.waitUntil(lambda: not (window.context.data_folder / "unsaved-0.json").exists())
    qtbot.waitUntil(after.autosave.file.exists)
    after.document.save(tmp_path / "rescued.json")
    assert kept_beside(tmp_path / "rescued.json").any()


def test_the_untouched_frame_of_a_recorded_preset_is_saved_from_the_recording(qtbot, window, store, tmp_path):
    frame = tiny_frame(1, RIG)
    recorded = Preset(name="recorded", untouched=store.keep(frame, 7))
    for file in (tmp_path / "store").iterdir():
        file.unlink()
    with SessionWriter(tmp_path / "both.mcap", RIG, preset=recorded, untouched=frame) as writer:
        writer.put(frame, wait=True)
    window.open_source(f"mcap:{tmp_path / 'both.mcap'}")
    qtbot.waitUntil(lambda: window.messages.by_key.get("recorded preset") is not None)
    press(window.messages.by_key.get("recorded preset"), "Use them")
    qtbot.waitUntil(lambda: window.document.untouched_home is not None)
    window.document.save(tmp_path / "saved" / "mine.json")
    assert (kept_beside(tmp_path / "saved" / "mine.json") == frame.tactile_depth).all()
    for file in (*tmp_path.rglob("*.npz"), *window.context.data_folder.rglob("*.npz")):
        file.unlink(missing_ok=True)
    window.open_source(f"mcap:{tmp_path / 'both.mcap'}")
    qtbot.waitUntil(lambda: "is missing; put it there" in text_of(window.rail))
