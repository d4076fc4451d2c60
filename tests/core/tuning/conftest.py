"""Recordings of small images, and presets that find their contact."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from pyarrow import parquet

from commands import Finished
from small_recordings import NoisyPress, small_rig
from tactune.core.preset.file import save_preset
from tactune.core.sources.folder import export_folder
from tactune.core.sources.presets import load_preset

LIMIT_S = 240


@pytest.fixture
def make_recording(tmp_path: Path) -> Callable[..., str]:
    """Write a recording and return its source's name."""

    def make(name: str = "rec", *, seed: int = 0, frames: int = 3, width: int = 64, with_truth: bool = True) -> str:
        export_folder(NoisyPress(seed, small_rig(width), frames, with_truth), tmp_path / name)
        return f"folder:{tmp_path / name}"

    return make


@pytest.fixture
def recording(make_recording: Callable[..., str]) -> str:
    return make_recording()


@pytest.fixture
def sweep(tactune: Callable[..., Finished], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., Finished]:
    """Run ``tactune sweep`` in this process, in a folder of its own, without further processes.

    Without a preset it starts from one with the tolerance test, ``tolerance.json`` beside the folder.
    """
    usual = tolerance_preset(tmp_path)

    def run(*words: object) -> Finished:
        if not {"-p", "--file"} & set(words):
            words = (*words, "-p", usual)
        (tmp_path / "work").mkdir(exist_ok=True)
        monkeypatch.chdir(tmp_path / "work")
        jobs = [] if {"--jobs", "--scheduler"} & set(words) else ["--jobs", "1"]
        return tactune("sweep", *words, *jobs)

    return run


def tolerance_preset(folder: Path) -> Path:
    """Write the paper's preset with the tolerance test; return its path."""
    path = folder / "tolerance.json"
    if not path.exists():
        save_preset(load_preset("default").with_value("contact_test", "tolerance"), path)
    return path


class LongSweep:
    """A sweep of 200 runs as a command of its own; a piece of work holds at most 25 of them."""

    def __init__(self, recording: str, folder: Path) -> None:
        self.table, self.journal = folder / "s.parquet", folder / "s.runs.jsonl"
        grid = ("--set", "tolerance.t=0.004:0.02:20", "--set", "outliers.k=5:24:10")
        self.command = [sys.executable, "-m", "tactune.app", "sweep", "-s", recording, *grid]
        self.command += ["-p", str(tolerance_preset(folder)), "-o", str(self.table)]

    def keys(self) -> list[str]:
        """Return the keys of the runs that are kept, in order."""
        lines = self.journal.read_text().splitlines()[1:] if self.journal.exists() else []
        return [json.loads(line)["key"] for line in lines]

    def start(self, *words: str) -> subprocess.Popen[str]:
        """Start it in a session of its own, and wait until some runs are kept."""
        process = subprocess.Popen(
            [*self.command, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        for _ in range(20 * LIMIT_S):
            if self.journal.exists() and self.journal.read_bytes().count(b"\n") > 10:
                return process
            assert process.poll() is None, process.communicate()
            time.sleep(0.05)
        raise AssertionError("no run was finished")

    def check(self) -> None:
        """All 200 runs are in the table, and each was done once."""
        rows = parquet.read_table(self.table).to_pylist()
        assert len(rows) == 200
        assert len({(row["tolerance.t"], row["outliers.k"]) for row in rows}) == 200
        assert all(row["failure"] == "" and row["frames"] == 12 and row["rmse_mm"] > 0 for row in rows)
        keys = self.keys()
        assert len(keys) == len(set(keys)) == 200, "a run was done twice"
        assert set(keys) == {row["key"] for row in rows}

    def finish(self, *words: str) -> None:
        """Give the command again, to its end."""
        done = subprocess.run([*self.command, *words], check=False, capture_output=True, text=True, timeout=LIMIT_S)
        assert done.returncode == 0, done.stderr
        self.check()


@pytest.fixture
def long_sweep(make_recording: Callable[..., str], tmp_path: Path) -> LongSweep:
    return LongSweep(make_recording(frames=12), tmp_path)
