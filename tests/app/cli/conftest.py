"""A tiny rig with a known contact, written as a folder that every command can read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tactune.app.cli.main import main
from tactune.core.model.frames import DepthCamera, GroundTruth, Rig, SensorFrame
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.sources import SeekableSource
from tactune.core.sources.folder import export_folder

UNIT_M = 0.00025


class SmallSource(SeekableSource):
    """A flat membrane at 300 mm; an object touches it in a square that grows from nothing, frame by frame."""

    def __init__(self, rig: Rig, *, with_truth: bool = True) -> None:
        super().__init__("small", rig, length=4)
        self._with_truth = with_truth

    def read(self, index: int) -> SensorFrame:
        shape = self.rig.proximity.intrinsics.shape
        contact = np.zeros(shape, bool)
        contact[8 : 8 + 8 * index, 8 : 8 + 8 * index] = True
        return SensorFrame(
            sequence=index,
            proximity_depth=np.rint(np.where(contact, 0.30, 0.36) / UNIT_M).astype(np.uint16),
            tactile_depth=np.full(shape, 3000, np.uint16),
            proximity_color=np.full((*shape, 3), 90, np.uint8),
            truth=GroundTruth(contact, np.full(shape, 0.3, np.float32)) if self._with_truth else None,
        )


def make_rig(serial: str, width: int) -> Rig:
    lens = Intrinsics(width=width, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
    return Rig(
        proximity=DepthCamera(model="near", serial=serial, intrinsics=lens, depth_unit_m=UNIT_M),
        tactile=DepthCamera(model="far", serial="T1", intrinsics=lens, depth_unit_m=0.0001),
        T_proximity_tactile=np.eye(4).tolist(),
    )


@pytest.fixture
def make_recording(tmp_path: Path) -> Callable[..., Path]:
    """Write a recording of four frames; the first has no contact, the last 24 x 24 pixels of it."""

    def make(name: str = "recording", *, serial: str = "P1", width: int = 64, with_truth: bool = True) -> Path:
        export_folder(SmallSource(make_rig(serial, width), with_truth=with_truth), tmp_path / name)
        return tmp_path / name

    return make


@pytest.fixture
def recording(make_recording: Callable[..., Path]) -> Path:
    return make_recording()


@dataclass(frozen=True)
class Finished:
    """How a command ended."""

    status: int
    out: str
    err: str

    @property
    def sentence(self) -> str:
        """The one sentence on standard error of a command that failed as it should."""
        assert self.status == 2
        assert self.out == ""
        assert self.err.startswith("tactune: ")
        assert self.err.count("\n") == 1
        return self.err


@pytest.fixture
def tactune(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., Finished]:
    """Run a command in this process, through the entry point of the installed one."""

    def run(*words: object) -> Finished:
        monkeypatch.setattr("sys.argv", ["tactune", *map(str, words)])
        status = main()
        captured = capsys.readouterr()
        return Finished(status, captured.out, captured.err)

    return run
