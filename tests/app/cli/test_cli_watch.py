"""``tactune run --watch``: the check for drift without a window."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drifted import Drift
from drifting import drifted, record_looks

Tactune = Callable[..., Any]


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with a frame in ten seconds; after 40 s the tactile camera stands 2 mm beside its place."""
    path = tmp_path_factory.mktemp("moved") / "moved camera.mcap"  # a shell needs quotes
    record_looks(path, [drifted()] * 4 + [drifted(Drift("tactile", (0.002, 0.0, 0.0)))] * 4)
    return path


def test_a_moved_camera_is_logged_once_with_its_number_and_the_re_check(tactune: Tactune, moved: Path) -> None:
    finished = tactune("run", "--source", moved, "--watch")
    assert finished.status == 0
    [line] = [line for line in finished.err.splitlines() if "moved" in line and "has moved" in line]
    assert "The tactile camera has moved by 2.0 mm" in line
    assert shlex.split(line.partition("Check with: ")[2])[:4] == ["tactune", "recheck", "--preset", str(moved)]


def test_json_lines_hold_what_each_look_measured(tactune: Tactune, moved: Path) -> None:
    lines = [json.loads(line) for line in tactune("run", "--source", moved, "--watch", "--json").out.splitlines()]
    looks = [line["watch"] for line in lines]
    assert [round(look["measured"]["tactile_mm"]) for look in looks] == [0] * 4 + [2] * 4
    assert [look["told"] for look in looks] == [[]] * 6 + [["camera"]] * 2
    assert [look["state"] for look in looks] == [None] * 6 + ["told"] + [None]


def test_without_a_reference_it_says_what_to_do(tactune: Tactune, recording: Path) -> None:
    finished = tactune("run", "--source", recording, "--watch")
    assert finished.status == 2
    assert "no untouched frame" in finished.err
