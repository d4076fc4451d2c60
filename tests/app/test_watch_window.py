"""The check for drift in the window: one message with its number, and what mends it one click away."""

from dataclasses import replace

import pytest
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QPushButton

from drifting import AVERAGED, Drift, drifted, untouched
from fakes import FakeCameras
from hands import LEFT, press, show_source
from tactune.core.preset.file import save_preset
from tactune.core.rig.drift import LOOKS
from tactune.core.rig.untouched import save_untouched
from tactune.core.sources.presets import load_preset

DRIFT = Drift("tactile", (0.002, 0.0, 0.0))
KEY = "watch"


class MovedCameras(FakeCameras):
    """Live cameras with a frame in ten seconds; the tactile one is moved by ``move``."""

    def __init__(self):
        self._rest, self._moved, self.is_moved = drifted(), drifted(DRIFT), False
        super().__init__(self._rest.rig)

    def move(self):
        self.is_moved = True

    def next_frame(self):
        number = len(self.given)
        if super().next_frame() is None:
            return None
        frame = (self._moved if self.is_moved else self._rest).read(AVERAGED + number % AVERAGED)
        time_s = 1000.0 + 10.0 * number
        self.given[-1] = replace(frame, sequence=number, proximity_time_s=time_s, tactile_time_s=time_s, truth=None)
        return self.given[-1]


@pytest.fixture(scope="module")
def reference():
    return untouched()


@pytest.fixture
def window(make_window, tmp_path, reference, qtbot):
    path = tmp_path / "kept.json"
    preset = load_preset("simulator").with_value("untouched", save_untouched(reference, AVERAGED, path).model_dump())
    save_preset(preset, path)
    made = make_window()
    made.file_flows.open_preset(path)
    return made


@pytest.fixture
def moving(window, qtbot):
    cameras = MovedCameras()
    cameras.release()
    show_source(qtbot, window, cameras)
    return cameras


def look(qtbot, window, cameras, count):
    """Show one frame after the other; each is due for a look, and the look has ended."""
    for _ in range(count):
        qtbot.waitUntil(lambda: not window.watch.job.busy, timeout=60_000)  # a frame during a look is not due
        newest = len(cameras.given)
        cameras.give(qtbot, 1)
        qtbot.waitUntil(lambda newest=newest: window.result.frame.sequence == newest, timeout=20_000)
    qtbot.waitUntil(lambda: not window.watch.job.busy, timeout=60_000)


def test_a_moved_camera_is_told_and_its_buttons_mend_and_show_it(window, moving, qtbot):
    look(qtbot, window, moving, 1)
    assert window.watch.first.state == "good"
    note = window.messages.by_key[KEY].sentence
    assert "Still good" in note and " px, membrane moved by " in note
    look(qtbot, window, moving, 2)
    moving.move()
    look(qtbot, window, moving, LOOKS - 1)
    assert window.messages.by_key[KEY].sentence == note
    look(qtbot, window, moving, 1)
    message = window.messages.by_key.get(KEY)
    assert "The tactile camera has moved by 2.0 mm" in message.sentence
    assert {"Calibrate…", "Capture untouched frame…"} <= {button.text() for button in message.findChildren(QPushButton)}
    press(message, "Show…")
    assert window.messages.by_key.get(KEY) is None
    shown = window.watch.window
    qtbot.waitUntil(lambda: shown.isVisible() and shown.found is not None and shown.found.state == "drifted")
    assert "The tactile camera has moved" in shown.sentence.text()
    QTest.mouseClick(shown.calibrate, LEFT)
    qtbot.waitUntil(lambda: window.calibration.wizard is not None)
    window.calibration.wizard.close()
    shown.close()


def test_a_frame_that_comes_as_the_window_closes_starts_no_look(window, moving, reference):
    window.close_without_asking()
    window.context.result = replace(window.result, untouched=replace(reference))
    window.context.frameShown.emit()
    assert not window.watch.job.busy


def test_it_is_switched_off_and_stays_off(window, moving, make_window, qtbot):
    action = window.actions_.watch_drift
    assert action.isChecked()
    action.trigger()
    assert not action.isChecked()
    moving.move()
    look(qtbot, window, moving, LOOKS)
    assert window.messages.by_key.get(KEY) is None
    window.close_without_asking()
    assert not make_window().actions_.watch_drift.isChecked()
