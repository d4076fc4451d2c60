"""What ``tactune tune --json`` prints, and a search that takes long enough to be killed."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

LIMIT_S = 240
POINTS = 32
TOLERANCES = "tolerance.t=0.004,0.006,0.008,0.010,0.012,0.014,0.017,0.020"


def lines_of(text: str) -> list[dict[str, Any]]:
    """Return the lines of ``--json``."""
    return [json.loads(line) for line in text.splitlines()]


def trials_of(text: str) -> dict[int, dict[str, Any]]:
    """Return the trials of ``--json`` by number; each is told once."""
    trials = [line for line in lines_of(text) if "number" in line]
    numbers = [trial["number"] for trial in trials]
    assert len(numbers) == len(set(numbers)), "a trial was told twice"
    return dict(zip(numbers, trials, strict=True))


def front_of(text: str) -> list[dict[str, Any]]:
    """Return the values of the last front."""
    trials = trials_of(text)
    last = [line for line in lines_of(text) if "front" in line][-1]
    return [trials[number]["values"] for number in last["front"]]


class LongSearch:
    """A grid of `POINTS` points as a command of its own; its objectives do not depend on the time."""

    def __init__(self, recording: str, folder: Path, preset: Path) -> None:
        self.file = folder / "long.log"
        grid = ("--set", TOLERANCES, "--set", "outliers.k=5,9,17,24", "--objective", "iou,rmse")
        self.words = ["-s", recording, *grid, "-p", str(preset), "--json"]
        self.command = [sys.executable, "-m", "tactune.app", "tune", *self.words, "--study", str(self.file)]

    def start(self, *words: str) -> subprocess.Popen[str]:
        """Start it in a session of its own, and wait until some trials are measured."""
        process = subprocess.Popen(
            [*self.command, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        for _ in range(200 * LIMIT_S):
            if self.measured() > 5:
                return process
            assert process.poll() is None, process.communicate()
            time.sleep(0.005)  # a trial takes some milliseconds
        raise AssertionError("no trial was measured")

    def measured(self) -> int:
        """Return the number of trials with a result in the file."""
        journal = self.file.read_text() if self.file.exists() else ""
        return len(re.findall(r'\{"op_code":6,[^\n]*"state":1,', journal))

    def check(self, out: str) -> None:
        """All points were measured, and each counts once."""
        trials = trials_of(out).values()
        assert all(trial["failure"] == "" for trial in trials)
        points = [(trial["values"]["tolerance.t"], trial["values"]["outliers.k"]) for trial in trials]
        assert (len(points), len(set(points))) == (POINTS, POINTS)
