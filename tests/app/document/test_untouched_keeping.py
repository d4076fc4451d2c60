"""The untouched frame of the window's preset: saved, recovered after a crash, recorded, read from recordings."""

import shutil

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import tiny_frame, tiny_rig
from hands import press
from tactune.app.document.document import Document, UntouchedStore
from tactune.core.errors import PresetError
from tactune.core.output.writer import SessionWriter
from tactune.core.preset import Preset
from tactune.core.rig.untouched import load_untouched
from tactune.core.sources.presets import load_preset

RIG = tiny_rig()


@pytest.fixture
def store(tmp_path):
    return UntouchedStore(tmp_path / "store")


@pytest.fixture
def document(qapp, store):
    """A new preset with a captured untouched frame, not saved yet."""
    made = Document(Preset(name="new"))
    made.untouched_store = store
    made.edit("untouched", store.keep(tiny_frame(0, RIG), 15).model_dump())
    return made


def kept_beside(path):
    record = load_preset(path).untouched
    assert record is not None
    return load_untouched(record, path).tactile_depth


# Saving


def test_the_untouched_frame_goes_wherever_the_preset_is_saved(document, tmp_path):
    first, renamed, elsewhere = (tmp_path / name for name in ("a/one.json", "a/two.json", "b/three.json"))
    for path in (first, renamed, elsewhere):
        document.save(path)
        assert (kept_beside(path) == tiny_frame(0, RIG).tactile_depth).all()
        assert document.untouched_home == path
    assert len(list(first.parent.glob("*.npz"))) == 1
    opened = Document()
    opened.open(first)
    opened.save(tmp_path / "c" / "four.json")  # without a store, as from a script
    assert kept_beside(tmp_path / "c" / "four.json").any()


def test_a_lost_untouched_frame_is_a_warning_when_saving(document, tmp_path):
    warnings = []
    document.warned.connect(warnings.append)
    for file in (tmp_path / "store").glob("*.npz"):
        file.unlink()
    document.save(tmp_path / "mine.json")
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
    qtbot.waitUntil(lambda: window.untouched.frame is not None)
    window.document.save(tmp_path / "saved" / "mine.json")
    assert (kept_beside(tmp_path / "saved" / "mine.json") == frame.tactile_depth).all()
