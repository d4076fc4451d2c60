"""The capture process dies, hangs, fails or sends invalid data: the source reports it and recovers by itself."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import capture_sources
from capture_sources import make_frame, make_rig, open_recorded, open_troubled
from commands import read_line
from tactune.core.errors import SourceError
from tactune.core.model.frames import SensorFrame
from tactune.core.sources.base import Health
from tactune.core.sources.capture import ProcessSource
from tactune.core.sources.capture.process import Patience
from tactune.core.sources.capture.protocol import FrameReady, Heartbeat, Opened

#: All that a troubled source sends.
MADE = [make_frame(make_rig(), number) for number in range(50)]

Until = Callable[[Callable[[], bool]], None]


def take(source: ProcessSource, count: int) -> list[SensorFrame]:
    frames = [source.next_frame() for _ in range(count)]
    assert None not in frames
    return [frame for frame in frames if frame is not None]


def is_whole(frame: SensorFrame) -> bool:
    """Whether all images of a frame are those of one and the same number."""
    return any(
        np.array_equal(frame.proximity_depth, made.proximity_depth)
        and np.array_equal(frame.tactile_depth, made.tactile_depth)
        and np.array_equal(frame.proximity_color, made.proximity_color)
        for made in MADE
    )


def kill(source: ProcessSource, sent: signal.Signals) -> None:
    assert source.capture_pid is not None
    os.kill(source.capture_pid, sent)


def order(words: str) -> Callable[[ProcessSource, Path], None]:
    def give(source: ProcessSource, folder: Path) -> None:
        (folder / "new.txt").write_text(words)
        (folder / "new.txt").rename(folder / "orders.txt")

    return give


@pytest.mark.parametrize(
    ("harm", "what"),
    [
        (lambda source, folder: kill(source, signal.SIGKILL), r"The capture process was ended by signal 9 \(SIGKILL\)"),
        (lambda source, folder: kill(source, signal.SIGSTOP), r"The capture process has given no sign of life for 1 s"),
        (order("segfault"), r"The capture process was ended by signal 11 \(SIGSEGV\)"),
        (order("hang"), r"The capture process has waited [\d.]+ s for its source"),
        (
            order("raise"),
            r"Capturing failed: troubled: frame \d+ is damaged; clean the lens\. The capture process",
        ),
    ],
    ids=["killed", "stopped", "segfault", "hang", "raise"],
)
def test_it_is_told_and_mended(
    nothing_left: None,
    tmp_path: Path,
    until: Until,
    harm: Callable[[ProcessSource, Path], None],
    what: str,
) -> None:
    with ProcessSource(partial(open_troubled, tmp_path)) as source:
        before = take(source, 30)
        source.set_option("tactile", "gain", 64.0)
        assert source.health().message == ""
        pid = source.capture_pid
        harm(source, tmp_path)
        until(lambda: source.health().stale)
        told = source.health()
        assert re.fullmatch(what + "( and)? (is being|has been) restarted\\.", told.message)
        assert not told.ok
        assert [camera.state for camera in told.cameras] in (["stalled"], ["streaming"])
        until(lambda: not source.health().stale)
        after = take(source, 30)
        assert source.capture_pid not in (None, pid)
        assert all(map(is_whole, before + after))
        numbers = [frame.sequence for frame in before + after]
        times_s = [frame.proximity_time_s for frame in before + after]
        assert numbers == sorted(set(numbers))
        assert times_s == sorted(set(times_s))
        health = source.health()
        assert health.ok
        assert re.fullmatch(what + "( and)? has been restarted\\.", health.message)
        assert source.options()[0].value == 64.0


def test_a_source_that_cannot_be_opened_again_is_tried_until_it_can(
    nothing_left: None, tmp_path: Path, until: Until
) -> None:
    with ProcessSource(partial(open_troubled, tmp_path)) as source:
        take(source, 3)
        (tmp_path / "refuse.txt").write_text("the tactile camera is not connected; plug it in")
        kill(source, signal.SIGKILL)
        until(lambda: "is not connected" in source.health().message)
        assert source.health().message == (
            "Capturing failed: the tactile camera is not connected; plug it in. The capture process is being restarted."
        )
        assert not source.wait(0.5) or source.next_frame() is not None
        (tmp_path / "refuse.txt").unlink()
        until(lambda: not source.health().stale)
        assert source.next_frame() is not None


def test_odd_frames_are_left_out_and_told(nothing_left: None, tmp_path: Path, until: Until) -> None:
    with ProcessSource(partial(open_troubled, tmp_path)) as source:
        order("size 25")(source, tmp_path)
        until(lambda: "tactile_depth is 10 x 7 pixels" in source.health().message)
        assert source.health().message.startswith("A frame was ignored: frame ")
        until(lambda: source.health().dropped >= 25 and not source.health().stale)
        assert {frame.tactile_depth.shape for frame in take(source, 20)} == {(14, 20)}


def test_another_rig_after_a_restart_ends_the_source(nothing_left: None, tmp_path: Path) -> None:
    with ProcessSource(partial(open_troubled, tmp_path)) as source:
        take(source, 3)
        (tmp_path / "rig.txt").write_text("24")
        kill(source, signal.SIGKILL)
        sentence = (
            "troubled: after a restart the tactile camera is D405 t1 with 24 x 14 pixels of 0.0001 m instead of "
            "D405 t1 with 20 x 14 pixels of 0.0001 m; open the source again"
        )
        with pytest.raises(SourceError, match=sentence):
            take(source, 1000)
        assert source.health().message == sentence
        assert source.health().stale


def test_a_lossless_source_says_that_it_cannot_go_on(nothing_left: None) -> None:
    rig = make_rig()
    frames = [make_frame(rig, number) for number in range(30)]
    with ProcessSource(partial(open_recorded, rig, frames), lossless=True) as source:
        take(source, 1)
        kill(source, signal.SIGKILL)
        with pytest.raises(SourceError, match=r"recorded: the capture process was ended by signal 9 \(SIGKILL\)"):
            take(source, 30)


def test_a_parent_that_was_stopped_itself_takes_no_process_for_dead(tmp_path: Path) -> None:
    program = f"""
import sys, time
sys.path.append({str(Path(capture_sources.__file__).parent)!r})
from functools import partial
from pathlib import Path
from capture_sources import open_troubled
from tactune.core.sources.capture import ProcessSource
with ProcessSource(partial(open_troubled, Path({str(tmp_path)!r}))) as source:
    source.next_frame()
    pid = source.capture_pid
    print("ready", flush=True)
    sys.stdin.readline()
    for _ in range(100):
        source.next_frame()
    print(source.capture_pid == pid, source.health().message)
"""
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        assert read_line(parent.stdout) == "ready\n"
        parent.send_signal(signal.SIGSTOP)
        time.sleep(3.0)  # longer than the source waits for its process
        parent.send_signal(signal.SIGCONT)
        answer, _ = parent.communicate("go\n", timeout=300)
    assert answer == "True \n"


def test_a_machine_that_is_too_busy_is_no_silence_of_the_process() -> None:
    patience = Patience()
    patience.heard(Opened("x", make_rig(), 30.0, Health(), "memory"))
    for _ in range(100):
        patience.silent(waited_s=0.4)
    assert patience.problem == ""
    for _ in range(10):
        patience.silent(waited_s=0.1)
    assert patience.problem == "has given no sign of life for 1 s"


def test_what_has_come_back_after_long_is_no_hang() -> None:
    """Opening may take longer than a first frame, and a first frame longer than the others."""
    patience = Patience()
    patience.heard(Heartbeat(Health(), 60.0))
    patience.heard(Opened("a", make_rig(), 30.0, Health(), "memory"))
    assert patience.problem == ""
    patience.heard(Heartbeat(Health(), 5.0))
    assert patience.problem == ""
    patience.heard(FrameReady(0, b"", ()))
    assert patience.problem == ""
    patience.heard(Heartbeat(Health(), 5.0))
    assert "has waited 5.0 s for its source" in patience.problem
