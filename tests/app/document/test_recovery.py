import itertools

import pytest
from PyQt6.QtCore import QTimer

from tactune.app.document.document import Document
from tactune.app.document.keeping import Autosave, unsaved_work


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "unsaved"


@pytest.fixture
def document(qtbot, preset):
    return Document(preset)


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
