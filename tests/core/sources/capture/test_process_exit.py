"""The capture process ends whenever its parent ends; library users need no main guard."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import capture_sources
from commands import read_line

OPEN = f"""
import signal, sys, time
sys.path.append({str(Path(capture_sources.__file__).parent)!r})
from functools import partial
from pathlib import Path
from capture_sources import capture_pid, open_troubled
from tactune.core.sources.capture.process_source import ProcessSource
source = ProcessSource(partial(open_troubled, Path("/nonexistent")))
source.next_frame()
print(capture_pid(), flush=True)
"""


def alive(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.fixture
def start(tmp_path):
    """Start a program that opens a source and does something more; return it and its capture process."""
    started = []

    def run(more):
        program = tmp_path / "program.py"  # without a main guard
        program.write_text(OPEN + more)
        parent = subprocess.Popen(
            [sys.executable, program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        started.append(parent)
        assert parent.stdout is not None
        return parent, int(read_line(parent.stdout))

    yield run
    for parent in started:
        parent.kill()
        parent.communicate()


@pytest.mark.parametrize(
    "more",
    ["", "del source", *(f"import os; os.kill(os.getpid(), signal.{name})" for name in ("SIGKILL", "SIGINT"))],
)
def test_the_process_ends_with_its_parent(start, until, more):
    parent, pid = start(more)
    _, words = parent.communicate(timeout=300)
    assert words == "" or words.endswith("KeyboardInterrupt\n")
    assert "child.py" not in words
    until(lambda: not alive(pid))


def test_a_process_that_hangs_is_ended_with_its_source(start, until):
    parent, pid = start("import os, signal; os.kill(capture_pid(), signal.SIGSTOP); source.close()")
    _, words = parent.communicate(timeout=300)
    assert words == ""
    assert not alive(pid)


def test_ctrl_c_reaches_the_parent_only(start):
    parent, _ = start("""
try:
    print("ready", flush=True)
    time.sleep(60)
except KeyboardInterrupt:
    print(source.next_frame() is not None, source.health().message, flush=True)
""")
    assert parent.stdout is not None
    assert read_line(parent.stdout) == "ready\n"
    os.killpg(parent.pid, signal.SIGINT)  # as a terminal does
    answer, words = parent.communicate(timeout=300)
    assert (answer, words) == ("True \n", "")
