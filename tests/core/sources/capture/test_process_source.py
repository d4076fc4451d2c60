"""A source in a process of its own gives the same frames and errors as in this one, and recovers by itself."""

import gc
import os
import re
import signal
import threading
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_sources import (
    capture_pid,
    make_frame,
    make_rig,
    open_for_ever,
    open_nothing,
    open_recorded,
    open_troubled,
    same_frame,
)
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.app.worker.reading import SourceRequest
from tactune.core.errors import MissingExtraError, SourceError
from tactune.core.preset import Preset
from tactune.core.sources.capture.child import create_memory, read_frame, write_frame
from tactune.core.sources.capture.process_source import ProcessSource
from tactune.core.sources.registry import open_source
from tactune.widgets.basics.messages import Message

sizes = st.tuples(st.integers(1, 40), st.integers(1, 30))
rigs = st.builds(make_rig, sizes, sizes, st.none() | sizes)


@given(rig=rigs, number=st.integers(0, 1000), color=st.booleans(), truth=st.booleans(), depth=st.booleans())
def test_a_slot_gives_back_the_frame_that_was_put_in(rig, number, color, truth, depth):
    frame = make_frame(rig, number, tactile_color=color, truth=truth, truth_depth=depth)
    memory = create_memory(rig)
    try:
        ready = write_frame(memory, 1, frame)
        write_frame(memory, 0, make_frame(rig, number + 1))
        out = read_frame(memory, ready)
        write_frame(memory, 1, make_frame(rig, number + 2))  # what is written later does not reach it
    finally:
        memory.close()
        memory.unlink()
    assert same_frame(out, frame)
    assert not out.proximity_depth.flags.writeable
    if out.truth is not None:
        assert not out.truth.contact.flags.writeable


def test_a_slow_caller_of_a_live_source_gets_new_frames_and_the_number_of_lost_ones(nothing_left, tmp_path, until):
    with ProcessSource(partial(open_troubled, tmp_path)) as source:
        first = source.next_frame()
        until(lambda: source.health().unmatched >= 6)  # one for each ten frames
        after = [source.next_frame() for _ in range(10)]
        numbers = [frame.sequence for frame in after if frame is not None]
        assert numbers == sorted(set(numbers))
        missing = numbers[-1] - first.sequence - len(numbers)
        assert missing > 20
        assert source.health().dropped >= missing
        assert numbers[1] - numbers[0] == 1


def test_names_rate_untouched_frame_and_progress(nothing_left):
    rig = make_rig()
    told = []

    def progress(share, words):
        assert threading.current_thread() is threading.main_thread()
        told.append((share, words))

    with ProcessSource(partial(open_recorded, rig, [make_frame(rig, 0)]), progress) as source:
        assert (source.name, source.length, source.frame_rate_hz, source.rig) == ("live:recorded", None, 30.0, rig)
        untouched = source.untouched()
        assert untouched is not None
        assert same_frame(untouched, make_frame(rig, 999, truth=True, truth_depth=True))
        with pytest.raises(SourceError, match="a live source cannot seek"):
            source.seek(0)
    assert (0.5, "half way") in told


def test_the_last_frame_ends_the_source(nothing_left, tmp_path):
    (tmp_path / "orders.txt").write_text("end")
    with ProcessSource(partial(open_troubled, tmp_path)) as source:
        assert len(list(source)) <= 19
        assert source.next_frame() is None


def test_options_go_through(nothing_left, tmp_path):
    with ProcessSource(partial(open_troubled, tmp_path)) as source:
        source.set_option("tactile", "gain", 32.0)
        (gain,) = source.options()
        assert (gain.name, gain.value, gain.maximum) == ("gain", 32.0, 248)
        with pytest.raises(SourceError, match="gain of the tactile camera cannot be 999"):
            source.set_option("tactile", "gain", 999)
        assert source.options()[0].value == 32.0


@pytest.mark.parametrize(
    ("opener", "kind", "sentence"),
    [
        (partial(open_nothing, "extra"), MissingExtraError, r"^the camera driver is not installed; install tactune"),
        (partial(open_nothing, "slip"), SourceError, r"failed unexpectedly \(ZeroDivisionError: a slip\)"),
        (partial(open_nothing, "die"), SourceError, r"ended with status -11 while opening"),
        (lambda progress: None, SourceError, r"cannot be sent to the capture process .*use a function of a module"),
    ],
)
def test_what_cannot_be_opened_says_so_as_without_the_process(nothing_left, opener, kind, sentence):
    with pytest.raises(kind, match=sentence) as caught:
        ProcessSource(opener)
    assert type(caught.value) is kind
    assert "\n" not in str(caught.value)


def test_opening_is_left_by_an_exception_of_the_progress(nothing_left):
    def progress(share, words):
        if words == "solving":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ProcessSource(open_for_ever, progress)


def test_a_forgotten_source_ends_its_process(nothing_left, tmp_path):
    source = ProcessSource(partial(open_troubled, tmp_path))
    assert source.next_frame() is not None
    del source
    gc.collect()


#: All that a troubled source sends.
MADE = [make_frame(make_rig(), number) for number in range(50)]


def take(source, count):
    frames = [source.next_frame() for _ in range(count)]
    assert None not in frames
    return [frame for frame in frames if frame is not None]


def is_whole(frame):
    """Whether all images of a frame are those of one and the same number."""
    return any(
        np.array_equal(frame.proximity_depth, made.proximity_depth)
        and np.array_equal(frame.tactile_depth, made.tactile_depth)
        and np.array_equal(frame.proximity_color, made.proximity_color)
        for made in MADE
    )


def kill(sent):
    os.kill(capture_pid(), sent)


def order(words):
    def give(source, folder):
        (folder / "new.txt").write_text(words)
        (folder / "new.txt").rename(folder / "orders.txt")

    return give


@pytest.mark.parametrize(
    ("harm", "what"),
    [
        (lambda source, folder: kill(signal.SIGKILL), "The capture process ended with status -9"),
        (lambda source, folder: kill(signal.SIGSTOP), "The capture process has given no sign of life for 6 s"),
        (order("raise"), r"Capturing failed: troubled: frame \d+ is damaged; clean the lens"),
        (order("size"), "Capturing failed: frame .* tactile_depth is 10 x 7 pixels.*"),
    ],
    ids=["killed", "stopped", "raise", "size"],
)
def test_it_is_told_and_mended(nothing_left, tmp_path, until, harm, what):
    with ProcessSource(partial(open_troubled, tmp_path)) as source:
        before = take(source, 30)
        source.set_option("tactile", "gain", 64.0)
        assert source.health().message == ""
        pid = capture_pid()
        harm(source, tmp_path)
        until(lambda: source.health().stale)
        told = source.health()
        assert re.fullmatch(what + r"\. It is started again\.", told.message)
        assert not told.ok
        assert [camera.state for camera in told.cameras] in (["stalled"], ["streaming"])
        until(lambda: not source.health().stale)
        after = take(source, 30)
        assert capture_pid() != pid
        assert all(map(is_whole, before + after))
        numbers = [frame.sequence for frame in before + after]
        times_s = [frame.proximity_time_s for frame in before + after]
        assert numbers == sorted(set(numbers))
        assert times_s == sorted(set(times_s))
        health = source.health()
        assert health.ok
        assert re.fullmatch(what + r"\. It is started again\.", health.message)
        assert source.options()[0].value == 64.0


def test_a_source_that_cannot_be_opened_again_is_tried_until_it_can(nothing_left, tmp_path, until):
    with ProcessSource(partial(open_troubled, tmp_path)) as source:
        take(source, 3)
        (tmp_path / "refuse.txt").write_text("the tactile camera is not connected; plug it in")
        kill(signal.SIGKILL)
        until(lambda: "is not connected" in source.health().message)
        assert source.health().message == (
            "Capturing failed: the tactile camera is not connected; plug it in. It is started again."
        )
        assert not source.wait(0.5) or source.next_frame() is not None
        (tmp_path / "refuse.txt").unlink()
        until(lambda: not source.health().stale)
        assert source.next_frame() is not None


def test_another_rig_after_a_restart_ends_the_source(nothing_left, tmp_path):
    with ProcessSource(partial(open_troubled, tmp_path)) as source:
        take(source, 3)
        (tmp_path / "rig.txt").write_text("24")
        kill(signal.SIGKILL)
        sentence = "troubled: after a restart it has other cameras than before; open it again"
        with pytest.raises(SourceError, match=sentence):
            take(source, 1000)
        assert source.health().message == sentence
        assert source.health().stale


def test_the_window_stays_responsive_says_it_and_goes_on(qtbot, tmp_path):
    preset = Preset.model_validate({"name": "tiny", "outliers": {"enabled": False}})
    window = MainWindow(preset, Settings(tmp_path / "window.json"), tmp_path, native_dialogs=False)
    qtbot.addWidget(window, before_close_func=lambda window: window.close_without_asking())
    worker, states, ends, what = window.worker, [], [], "ended with status -9"
    worker.stateChanged.connect(states.append)
    worker.recordingEnded.connect(lambda *end: ends.append(end))
    window.show()
    opener = partial(open_troubled, tmp_path)
    window.open_request(SourceRequest("watched", lambda progress: ProcessSource(opener, progress)))
    qtbot.waitUntil(lambda: window.result is not None)
    worker.start_recording(tmp_path / "session.mcap")
    qtbot.waitUntil(lambda: (status := worker.recorder.status()) is not None and status.frames > 10)

    os.kill(capture_pid(), signal.SIGKILL)
    qtbot.waitUntil(lambda: any(state.stale and what in state.health.message for state in states))
    qtbot.waitUntil(lambda: any(what in message.sentence for message in window.findChildren(Message)))
    qtbot.waitUntil(lambda: not states[-1].stale)
    shown = window.result.processed
    qtbot.waitUntil(lambda: window.result.processed > shown + 10)
    worker.stop_recording()
    qtbot.waitUntil(lambda: bool(ends))
    [(status, reason)] = ends
    assert (reason, status.error, status.dropped) == ("", "", 0)
    with open_source(str(tmp_path / "session.mcap")) as recording:
        frames = list(recording)
    assert len(frames) == status.frames > 10
    assert np.all(np.diff([frame.proximity_time_s for frame in frames]) > 0)
