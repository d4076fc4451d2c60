"""The truth tab of a window, and a painted plate that fits the window's frame."""

from __future__ import annotations

import pytest

from truth_scene import open_plate, open_tab, write_plate


@pytest.fixture
def tab(qtbot, window):
    pytest.importorskip("trimesh")
    return open_tab(qtbot, window)


@pytest.fixture
def plate(tmp_path):
    return write_plate(tmp_path / "plate.ply")


@pytest.fixture
def ready(qtbot, tab, plate):
    open_plate(qtbot, tab, plate)
    return tab
