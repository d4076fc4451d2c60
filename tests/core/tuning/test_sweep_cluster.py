"""A sweep on a local Dask cluster with a killed worker, and unusable clusters."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

LIMIT_S = 300


class DaskCluster:
    """A scheduler and its workers, each a process."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.scheduler = self._start(
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", "about.json"
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


def test_a_worker_killed_midway_loses_no_run_and_doubles_none(long_sweep, cluster):
    cluster.add_worker()
    cluster.add_worker()
    process = long_sweep.start("--scheduler", cluster.address)
    cluster.workers[0].kill()
    at_the_kill = len(long_sweep.keys())
    out, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, err
    assert at_the_kill < 200
    assert "Best 10 of 200 settings" in out
    assert "Traceback" not in err
    long_sweep.check()


@pytest.mark.long
def test_ctrl_c_on_a_cluster_keeps_what_is_done(long_sweep, cluster):
    cluster.add_worker()
    process = long_sweep.start("--scheduler", cluster.address)
    process.send_signal(2)
    _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 130
    assert "the same command continues" in err
    assert "Traceback" not in err
    assert 10 <= len(long_sweep.keys()) < 200


@pytest.mark.long
def test_a_scheduler_that_ends_is_said_in_a_sentence(long_sweep, cluster):
    cluster.add_worker()
    process = long_sweep.start("--scheduler", cluster.address)
    cluster.scheduler.kill()
    _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 2, err
    assert err.splitlines()[-1].startswith("tactune: the Dask scheduler is gone")
    assert "Traceback" not in err


def test_no_scheduler_and_no_worker_are_said_in_a_sentence(long_sweep, cluster):
    expected = {"tcp://127.0.0.1:1": "no Dask scheduler answers", cluster.address: "has no worker"}
    commands = {
        address: subprocess.Popen(
            [*long_sweep.command, "--scheduler", address], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for address in expected
    }
    for address, process in commands.items():
        out, err = process.communicate(timeout=LIMIT_S)
        assert (process.returncode, out) == (2, "")
        assert err.startswith("tactune: ") and expected[address] in err, err
        assert err.count("\n") == 1
