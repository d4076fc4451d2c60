"""The capture process dies, hangs, fails or sends invalid data: the source reports it and recovers by itself."""

import os
import re
import signal
from functools import partial

import numpy as np
import pytest

from capture_sources import capture_pid, make_frame, make_rig, open_troubled
from tactune.core.errors import SourceError
from tactune.core.sources.capture.source import ProcessSource

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
