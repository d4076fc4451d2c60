"""Starting the window: presets, screenshots, signals, and the message about compiling."""

import os
import signal
import subprocess
import sys
from threading import Event

import pytest
from PyQt6.QtGui import QImage

from fakes import FakeSource
from hands import press
from tactune.app.gui import run_gui, show_window
from tactune.app.settings import Settings
from tactune.app.worker import background
from tactune.app.worker.results import CloudName
from tactune.core.contact import CONTACT_TESTS
from tactune.core.errors import ExportError
from tactune.core.preset import Preset
from tactune.core.preset.file import save_preset
from tactune.core.sources.folder import export_folder


@pytest.fixture
def recording(tmp_path):
    export_folder(FakeSource(length=3), tmp_path / "recording")
    return f"folder:{tmp_path / 'recording'}"


def test_a_screenshot_is_a_picture_of_the_window(qapp, recording, tmp_path):
    picture = tmp_path / "window.png"
    assert run_gui(recording, "default", picture, after=2) == 0
    assert QImage(str(picture)).width() > 700
    assert sorted(path.name for path in tmp_path.iterdir()) == ["recording", "window.png"]


def test_no_picture_without_a_source(qapp, tmp_path):
    with pytest.raises(ExportError, match="nowhere"):
        run_gui(f"folder:{tmp_path / 'nowhere'}", "default", tmp_path / "window.png", after=1)
    assert not (tmp_path / "window.png").exists()


@pytest.fixture
def start(qapp, qtbot, tmp_path):
    """Start a window as ``tactune gui`` does; what it remembers is in one place."""

    def make(source=None, preset=None):
        window, name = show_window(source, preset, Settings(tmp_path / "window.json"), tmp_path / "data")
        window.open_source(name)
        qtbot.addWidget(window, before_close_func=lambda window: window.close_without_asking())
        return window

    return make


def test_the_last_source_and_preset_open_again_unless_others_are_named(start, recording, tmp_path, qtbot):
    own = tmp_path / "own.json"
    save_preset(Preset(name="own"), own)
    first = start(recording, str(own))
    qtbot.waitUntil(lambda: first.result is not None)
    first.close()
    again = start()
    qtbot.waitUntil(lambda: again.result is not None)
    assert (again.result.source.name, again.document.path) == (recording, own)
    again.close()
    other = start(preset="default")
    qtbot.waitUntil(lambda: other.result is not None)
    assert (other.result.source.name, other.document.path) == (recording, None)
    other.actions_.reopen.trigger()
    other.close()
    assert Settings(tmp_path / "window.json").last_opened() == ("", "")
    assert not start("folder:nowhere").actions_.reopen.isChecked()


def test_what_is_not_there_any_more_is_said_with_a_way_on(start, recording, tmp_path, qtbot):
    own = tmp_path / "own.json"
    save_preset(Preset(name="own"), own)
    first = start(recording, str(own))
    qtbot.waitUntil(lambda: first.result is not None)
    first.close()
    own.unlink()
    (tmp_path / "recording").rename(tmp_path / "elsewhere")
    again = start()
    qtbot.waitUntil(lambda: again.messages.by_key.get("source") is not None)
    assert again.messages.by_key.get("file") is not None
    (tmp_path / "elsewhere").rename(tmp_path / "recording")
    press(again.messages.by_key.get("source"), "Try again")
    qtbot.waitUntil(lambda: again.result is not None)


INTERRUPT = """
import os, signal, sys
from PyQt6.QtCore import QTimer
from tactune.app import gui
from tactune.app.window.main_window import MainWindow

show = MainWindow.show
def interrupt(window):
    if not window.document.dirty:
        window.document.edit("tolerance.t", 0.07)
        end = window.worker.shut_down
        window.worker.shut_down = lambda: (print("ended"), end())
        QTimer.singleShot(0, lambda: [os.kill(os.getpid(), int(sys.argv[2])) for _ in range(2)])
def watched(window):
    window.context.frameShown.connect(lambda: interrupt(window))
    show(window)
MainWindow.show = watched
sys.exit(gui.run_gui(sys.argv[1], "simulator", None, 1))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")
@pytest.mark.parametrize("sent", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_a_signal_ends_the_window_once_and_keeps_unsaved_work(recording, tmp_path, sent):
    homes = {name: str(tmp_path / name) for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME")}
    environment = os.environ | homes | {"QT_QPA_PLATFORM": "offscreen"}
    command = [sys.executable, "-c", INTERRUPT, recording, str(int(sent))]
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment, timeout=300)
    assert done.returncode == 128 + sent
    assert done.stdout == "ended\n"
    assert "Traceback" not in done.stderr
    (kept,) = (tmp_path / "XDG_DATA_HOME").rglob("unsaved-*.json")
    assert '"t": 0.07' in kept.read_text()


def test_clouds_are_shown_while_the_contact_test_is_compiled(monkeypatch, watched, qtbot):
    words, go_on = "Compiling the tolerance test for this computer, once: 3 of 11", Event()

    def compile_slowly(progress, preset):
        assert preset.contact_test == "tolerance"
        progress(0.2, words)
        assert go_on.wait(60)

    monkeypatch.setattr(background, "is_compiled", lambda preset: False)
    monkeypatch.setattr(background, "warm_up_if_needed", compile_slowly)
    watched.open(FakeSource(length=1))
    qtbot.waitUntil(lambda: watched.last is not None and watched.last.rendered.no_contact == words)
    shown = watched.last
    assert shown.patch is None
    assert not shown.problem
    assert shown.rendered.clouds[CloudName.PROXIMITY].point_count > 0
    go_on.set()
    qtbot.waitUntil(lambda: watched.last.patch is not None)
    assert len(watched.last.patch.points) > 0


def test_the_patch_of_the_old_test_stays_while_another_is_compiled(monkeypatch, window, qtbot):
    """It is marked, and its preset is that of its own test; the other tests are compiled behind those in use."""
    asked, go_on = [], Event()

    def compile_slowly(progress, preset):
        asked.append(preset.contact_test)
        progress(0.2, "Compiling")
        assert go_on.wait(60)

    shown = window.views.views[CloudName.PATCH]
    old = len(window.result.patch.points)
    monkeypatch.setattr(background, "is_compiled", lambda preset: False)
    monkeypatch.setattr(background, "warm_up_if_needed", compile_slowly)
    window.worker._compiler._ready = {("tolerance", False)}
    window.document.edit("contact_test", "membrane")
    qtbot.waitUntil(lambda: "tolerance" in shown.badge.text())
    assert window.result.preset.contact_test == "tolerance" and len(window.result.patch.points) == old > 0
    go_on.set()
    qtbot.waitUntil(lambda: window.result.preset.contact_test == "membrane")
    qtbot.waitUntil(lambda: not shown.badge.text())
    qtbot.waitUntil(lambda: sorted([*asked, "tolerance"]) == sorted(CONTACT_TESTS))


def test_a_window_can_be_closed_while_a_contact_test_is_compiled(monkeypatch, watched, qtbot):
    told = Event()

    def compile_for_ever(progress, preset):
        while True:
            progress(0.5, "Compiling")
            told.set()

    monkeypatch.setattr(background, "is_compiled", lambda preset: False)
    monkeypatch.setattr(background, "warm_up_if_needed", compile_for_ever)
    watched.open(FakeSource(length=1))
    qtbot.waitUntil(told.is_set)
    watched.worker.shut_down()
    assert watched.worker.isFinished()
