"""Every kind of file while its writer is killed, beside a second writer, and on a full disk."""

import multiprocessing
import random
import shutil
import sys
import time
from pathlib import Path

import pytest

import kinds
from kinds import KINDS, keep_writing, set_values, write_once
from tactune.app.settings import Settings

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(sys.platform == "win32", reason="kills, and limits the size of files, as POSIX does"),
]
KILLS, SECONDS_BESIDE, MOST_S, HUNG_S = 12, 1.0, 60.0, 120.0
#: What a window reads only when it opens: a state beside those that another window is replacing.
READ_AT_START = ("unsaved preset", "alignment", "calibration")
#: Written under a new name each time: what was checked once need not be read again.
NAMED_ANEW = ("rig", "folder", "recording")
OURS = [name for name, kind in KINDS.items() if kind.ours]


@pytest.fixture(scope="module")
def start():
    """Start a function in a process of its own, which has imported everything already."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(kinds.__file__).parent))
        patch.setenv("OPENBLAS_NUM_THREADS", "1")  # a process with threads must not fork: locks stay locked
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["kinds"])

        def run(function, *words):
            ours, theirs = context.Pipe(duplex=False)
            process = context.Process(target=function, args=(theirs, *words), daemon=True)
            process.start()
            theirs.close()
            return process, ours

        yield run


def heard(said, name):
    """What a writer says next; a writer that says nothing hangs, or is refused for ever."""
    assert said.poll(HUNG_S), f"a writer of {name} said nothing in {HUNG_S:.0f} s"
    return said.recv()


def check(kind, folder):
    begun = time.process_time()  # not by the clock, since the machine may be busy
    assert kind.read is None or kind.read(folder) is not False
    assert time.process_time() - begun < MOST_S


def visible(folder):
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file() and not file.name.endswith(".lock")
    }


@pytest.mark.parametrize("name", OURS)
def test_a_killed_writer_leaves_whole_files(name, tmp_path, start, qapp):
    rng = random.Random(name)
    for _ in range(KILLS):
        writer, said = start(keep_writing, name, tmp_path, rng.randrange(2))
        heard(said, name)
        time.sleep(rng.uniform(0, 0.05))
        writer.kill()
        writer.join(HUNG_S)
        check(KINDS[name], tmp_path)
        if name in NAMED_ANEW:
            shutil.rmtree(tmp_path)
            tmp_path.mkdir()


@pytest.mark.parametrize("name", OURS)
def test_two_writers_leave_whole_files(name, tmp_path, start, qapp):
    writers = [start(keep_writing, name, tmp_path, n) for n in range(2)]
    for _, said in writers:
        heard(said, name)
    end = time.monotonic() + SECONDS_BESIDE
    while time.monotonic() < end and name not in READ_AT_START:
        check(KINDS[name], tmp_path)
    time.sleep(0.3)
    for writer, _ in writers:
        assert writer.is_alive()
        writer.kill()
        writer.join(HUNG_S)
    check(KINDS[name], tmp_path)


def test_two_windows_forget_no_value_of_each_other(tmp_path, start, qapp):
    windows = [start(set_values, tmp_path / "window.json", who) for who in range(2)]
    for window, _ in windows:
        window.join(HUNG_S)
    settings = Settings(tmp_path / "window.json")
    assert all(settings.text(f"{who}/{number}") == str(number) for who in range(2) for number in range(50))


@pytest.mark.parametrize("name", OURS)
def test_a_full_disk_is_said_and_nothing_is_lost(name, tmp_path, start, qapp):
    kind = KINDS[name]
    kind.write(tmp_path, 0)
    before = visible(tmp_path)
    refused = 0
    for share in (0, 0.001, 0.05, 0.3, 0.7, 0.99, 1.3, 1.5):
        limit = int(share * max(map(len, before.values())))
        writer, said = start(write_once, name, tmp_path, limit)
        error = heard(said, name)
        writer.join(HUNG_S)
        assert isinstance(error, str), f"{limit} bytes: {error!r}"
        assert "\n" not in error
        refused += bool(error)
        after = visible(tmp_path)
        check(kind, tmp_path)
        if error and not kind.grows:
            assert before.items() <= after.items(), f"{limit} bytes"
            assert not any(left.startswith(".") for left in after), f"{limit} bytes"
        if error and name == "patches":
            assert ("; the file holds the " in error) == (len(after) > len(before))
        before = visible(tmp_path)
    assert refused or kind.silent
