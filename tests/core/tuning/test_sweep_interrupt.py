"""A sweep of 200 runs in separate processes, interrupted and resumed: no run is lost or repeated."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest


def check_interrupted(process, long_sweep):
    """The command has ended with a sentence, and what it says is kept."""
    out, err = process.communicate(timeout=300)
    assert process.returncode == 130
    assert out == ""
    assert "Traceback" not in err
    done = len(long_sweep.keys())
    assert 10 <= done < 200
    assert f"{done} of 200 runs are kept in {long_sweep.journal}; the same command continues from there" in err
    assert not long_sweep.table.exists()


def test_a_signal_to_the_command_alone_ends_all(long_sweep):
    process = long_sweep.start("--jobs", "2")
    process.send_signal(signal.SIGINT)
    check_interrupted(process, long_sweep)


def test_ctrl_c_in_a_terminal_keeps_what_is_done_and_the_same_command_goes_on(long_sweep):
    process = long_sweep.start("--jobs", "2")
    os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to all processes
    check_interrupted(process, long_sweep)
    before = long_sweep.journal.read_text()
    long_sweep.finish("--jobs", "2")
    assert long_sweep.journal.read_text().startswith(before)


@pytest.mark.long
def test_a_killed_sweep_loses_only_what_was_running_and_leaves_no_process(long_sweep):
    process = long_sweep.start("--jobs", "2")
    process.kill()
    process.communicate(timeout=300)
    assert 10 <= len(long_sweep.keys()) < 200
    long_sweep.finish("--jobs", "2")
    for _ in range(300):
        if not living(process.pid):
            return
        time.sleep(0.1)
    raise AssertionError(f"processes are left: {living(process.pid)}")


def living(session: int) -> list[str]:
    """Return the processes of a session that have not ended."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] != "Z":
            found.append(folder.name)
    return found
