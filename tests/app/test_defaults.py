"""Which shipped preset a source gets where nobody says."""

from __future__ import annotations

import pytest

from tactune.app.document.defaults import default_preset


@pytest.mark.parametrize(
    ("source", "preset"),
    [("sim", "simulator"), ("sim:cup?seed=3", "simulator"), ("live:sim", "simulator"), ("live:sim:cube", "simulator"),
     ("folder:sim", "default"), ("realsense:", "default"), ("live:folder:x", "default"), ("similar.bag", "default")],
)  # fmt: skip
def test_the_simulator_has_a_preset_of_its_own(source: str, preset: str) -> None:
    assert default_preset(source) == preset
