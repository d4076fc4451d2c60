"""A source in a separate process gives the same frames, errors and replies as in this process."""

import gc
import threading
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_sources import (
    make_frame,
    make_rig,
    open_for_ever,
    open_nothing,
    open_recorded,
    open_troubled,
    same_frame,
)
from tactune.core.errors import MissingExtraError, SourceError
from tactune.core.sources.capture.child import create_memory, read_frame, write_frame
from tactune.core.sources.capture.source import ProcessSource

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
