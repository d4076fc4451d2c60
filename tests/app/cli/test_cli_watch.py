"""``tactune run --watch``: the check for drift without a window."""

import json
import shlex

import pytest

from drifted import Drift
from drifting import drifted, record_looks


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    """A recording with a frame in ten seconds; after 40 s the tactile camera stands 2 mm beside its place."""
    path = tmp_path_factory.mktemp("moved") / "moved.mcap"
    record_looks(path, [drifted()] * 4 + [drifted(Drift("tactile", (0.002, 0.0, 0.0)))] * 4)
    return path


def test_a_moved_camera_is_logged_once_with_its_number_and_the_re_check(tactune, moved):
    finished = tactune("run", "--source", moved, "--watch", "--json")
    assert finished.status == 0
    said = ["cameras moved" in json.loads(line)["doubt"] for line in finished.out.splitlines()]
    assert not any(said[:4]) and said[-1]
    [line] = [line for line in finished.err.splitlines() if "moved" in line and "has moved" in line]
    assert "The tactile camera has moved by 2.0 mm" in line
    advised = tactune(*shlex.split(line.partition("Check with: tactune ")[2]))
    assert advised.status == 1  # it has moved
    assert "calibrate again" in advised.out
