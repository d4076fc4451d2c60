"""Recordings with a known contact, written as folders that every command can read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from small_recordings import GrowingPress, small_rig
from tactune.core.sources.folder import export_folder


@pytest.fixture
def make_recording(tmp_path: Path) -> Callable[..., Path]:
    """Write a recording of four frames; the first has no contact, the last 24 x 24 pixels of it."""

    def make(name: str = "recording", *, serial: str = "1", width: int = 64, with_truth: bool = True) -> Path:
        export_folder(GrowingPress(small_rig(width, serial), 4, with_truth), tmp_path / name)
        return tmp_path / name

    return make


@pytest.fixture
def recording(make_recording: Callable[..., Path]) -> Path:
    return make_recording()
