"""Searches in processes that are killed, or that run on a cluster: each trial counts once."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from long_search import LIMIT_S, POINTS, front_of, trials_of
from tactune.core.tuning.workers import local_workers


def test_killed_and_begun_again_with_two_processes_it_gives_the_front_of_one(long_search):
    process = long_search.start("--jobs", "2")
    process.kill()
    process.communicate(timeout=LIMIT_S)
    assert 5 <= long_search.measured() < POINTS
    out = long_search.finish("--jobs", "2")
    wait_for_the_end_of(process.pid)
    long_search.file.unlink()
    assert front_of(out) == front_of(long_search.finish("--jobs", "1"))


def test_a_worker_imports_nothing_from_the_working_folder(tmp_path, monkeypatch):
    for name in ("multiprocessing", "joblib", "numpy"):
        (tmp_path / f"{name}.py").write_text("import pathlib; pathlib.Path('harm').touch()")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    with local_workers(2) as workers:
        assert workers.submit(os.path.basename, "a/b").result(LIMIT_S) == "b"
    assert not (tmp_path / "harm").exists()


def test_ctrl_c_in_a_terminal_keeps_what_is_done_and_the_same_command_goes_on(long_search):
    process = long_search.start("--jobs", "2")
    os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to all processes
    _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert (
        f"{long_search.measured()} of {POINTS} trials are kept in {long_search.file}; the same command continues" in err
    )
    long_search.finish("--jobs", "1")


def test_ctrl_c_while_the_processes_start_ends_without_a_traceback(long_search):
    process = subprocess.Popen(
        [*long_search.command, "--jobs", "2"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    listed = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while not any(b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes() for child in listed.read_text().split()):
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert "the same command continues" in err


def test_a_line_that_a_crash_cut_off_is_dropped(tune, recording, tmp_path):
    journal = tmp_path / "cut.log"
    words = ("-s", recording, "--set", "tolerance.t=0.004:0.02:4", "--study", journal, "--json")
    first = trials_of(tune(*words).out)
    with journal.open("a") as file:
        file.write('{"op_code":4,"worker')
    assert len(first) == 4 and trials_of(tune(*words).out) == first
    assert all(json.loads(line) for line in journal.read_text().splitlines())


def wait_for_the_end_of(session: int) -> None:
    for _ in range(300):
        if not living(session):
            return
        time.sleep(0.1)
    raise AssertionError(f"processes are left: {living(session)}")


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


class DaskCluster:
    """A scheduler and its workers, each a process."""

    def __init__(self, folder: Path, protocol: str = "tcp") -> None:
        self._folder = folder
        self.scheduler = self._start(
            *("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", "about.json"),
            *("--protocol", protocol),
        )
        about = folder / "about.json"
        for _ in range(20 * LIMIT_S):
            if about.exists() and about.read_text().rstrip().endswith("}"):
                break
            time.sleep(0.05)
        self.address = json.loads(about.read_text())["address"]
        self.workers: list[subprocess.Popen[bytes]] = []

    def add_worker(self) -> None:
        """Start one more, with one thread."""
        name = f"worker{len(self.workers)}"
        words = ("worker", self.address, "--nthreads", "1", "--no-nanny", "--name", name, "--local-directory", name)
        self.workers.append(self._start(*words))

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", *words, "--no-dashboard"]
        return subprocess.Popen(command, cwd=self._folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def close(self) -> None:
        """End all processes."""
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[DaskCluster]:
    (tmp_path / "dask").mkdir()
    running = DaskCluster(tmp_path / "dask")
    try:
        yield running
    finally:
        running.close()


def test_a_dask_worker_killed_midway_loses_no_trial_and_doubles_none(long_search, cluster):
    cluster.add_worker()
    cluster.add_worker()
    process = long_search.start("--scheduler", cluster.address)
    cluster.workers[0].kill()
    at_the_kill = long_search.measured()
    out, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, err
    assert at_the_kill < POINTS
    assert "Traceback" not in err
    long_search.check(out)


@pytest.mark.long
def test_no_scheduler_and_no_worker_are_said_in_a_sentence(long_search, cluster):
    expected = {"tcp://127.0.0.1:1": "no Dask scheduler answers", cluster.address: "has no worker"}
    commands = {
        address: subprocess.Popen(
            [*long_search.command, "--scheduler", address], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for address in expected
    }
    for address, process in commands.items():
        out, err = process.communicate(timeout=LIMIT_S)
        assert (process.returncode, out) == (2, "")
        assert err.startswith("tactune: ") and expected[address] in err, err
        assert err.count("\n") == 1
