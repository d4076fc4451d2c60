"""Sources for the capture process, which imports this module by its top-level name."""

from __future__ import annotations

import ctypes
import multiprocessing
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import folder_scenes
from fakes import FakeSource
from tactune.core.errors import MissingExtraError, SourceError
from tactune.core.model.frames import ColorCamera, DepthCamera, GroundTruth, Rig, SensorFrame
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.sources.base import CameraHealth, CameraOption, CameraRole, FrameSource, Health, Progress
from tactune.core.sources.play_as_live import PlayAsLive

Size = tuple[int, int]

POSE = tuple(tuple(float(row == column) for column in range(4)) for row in range(4))


def capture_pid() -> int:
    """The number of the only capture process of this one."""
    (pid,) = (child.pid for child in multiprocessing.active_children() if child.name == "tactune capture")
    assert pid is not None
    return pid


def make_rig(proximity: Size = (16, 12), tactile: Size = (20, 14), color: Size | None = None) -> Rig:
    """A rig whose images have these widths and heights, with lenses that a window can draw."""

    def lens(size: Size) -> Intrinsics:
        return Intrinsics(width=size[0], height=size[1], fx=50, fy=50, cx=3, cy=3)

    return Rig(
        proximity=DepthCamera(model="L515", serial="p1", intrinsics=lens(proximity), depth_unit_m=0.00025),
        tactile=DepthCamera(model="D405", serial="t1", intrinsics=lens(tactile), depth_unit_m=0.0001),
        proximity_color=ColorCamera(intrinsics=lens(color), T_color_depth=POSE) if color else None,
    )


def make_frame(
    rig: Rig, number: int, *, tactile_color: bool = False, truth: bool = False, truth_depth: bool = False
) -> SensorFrame:
    """Frame ``number``: random images that differ from those of any other number."""
    time_s = number / 30 + 0.1
    made = folder_scenes.make_frame(
        number, rig, sequence=number, proximity_time_s=time_s, tactile_time_s=time_s + 0.0021
    )
    assert made.truth is not None
    depth_m, pose = (made.truth.depth_m, POSE) if truth_depth else (None, None)
    return replace(
        made,
        tactile_color=made.tactile_color if tactile_color else None,
        truth=GroundTruth(made.truth.contact, depth_m, T_proximity_object=pose) if truth else None,
    )


def same_frame(one: SensorFrame, other: SensorFrame) -> bool:
    """Whether two frames agree in every number and every bit."""

    def facts(frame: SensorFrame) -> dict[str, object]:
        arrays = {"truth": frame.truth is not None}
        images = {
            "proximity_depth": frame.proximity_depth,
            "tactile_depth": frame.tactile_depth,
            "proximity_color": frame.proximity_color,
            "tactile_color": frame.tactile_color,
            "contact": frame.truth.contact if frame.truth else None,
            "depth_m": frame.truth.depth_m if frame.truth else None,
        }
        for name, image in images.items():
            arrays[name] = None if image is None else (image.dtype, image.shape, image.tobytes())
        true_pose = frame.truth.T_proximity_object if frame.truth else None
        return arrays | {"pose": true_pose, "times": (frame.sequence, frame.proximity_time_s, frame.tactile_time_s)}

    return facts(one) == facts(other)


def recorded(rig: Rig, frames: Sequence[SensorFrame], rate_hz: float = 30.0) -> FakeSource:
    """A recording of frames that were made before."""
    untouched = make_frame(rig, 999, truth=True, truth_depth=True)
    return FakeSource(frames=frames, rig=rig, name="recorded", rate_hz=rate_hz, untouched=untouched)


def open_recorded(rig: Rig, frames: Sequence[SensorFrame], progress: Progress) -> PlayAsLive:
    """Open a recording that is played live."""
    progress(0.5, "half way")
    time.sleep(0.3)
    return PlayAsLive(recorded(rig, frames))


class Troubled(FrameSource):
    """A live source at 100 Hz that does what the file says, once, when its frame 20 is due.

    Words: ``raise``, ``size`` (a frame of another size), ``end``.
    """

    def __init__(self, orders: Path, rig: Rig) -> None:
        self.name = "troubled"
        self._orders = orders
        self._rig = rig
        self._count = 0
        self._gain = 16.0
        self._begun_s = time.monotonic()

    @property
    def rig(self) -> Rig:
        return self._rig

    def wait(self, timeout_s: float) -> bool:
        due_in_s = self._begun_s + self._count / 100 - time.monotonic()
        time.sleep(max(0.0, min(due_in_s, timeout_s)))
        return due_in_s <= timeout_s

    def next_frame(self) -> SensorFrame | None:
        self._count += 1
        if self._count >= 20 and self._orders.exists():
            word = self._orders.read_text()
            self._orders.unlink()
            if word == "raise":
                raise SourceError(f"troubled: frame {self._count} is damaged; clean the lens")
            if word == "end":
                return None
            if word == "size":
                return make_frame(make_rig(tactile=(10, 7)), self._count)
        time_s = time.time()
        made = make_frame(self._rig, self._count % 50)
        return replace(made, sequence=self._count, proximity_time_s=time_s, tactile_time_s=time_s + 0.0021)

    def health(self) -> Health:
        return Health(cameras=(CameraHealth("tactile", "streaming", "D405", "t1"),), unmatched=self._count // 10)

    def options(self) -> tuple[CameraOption, ...]:
        return (CameraOption("tactile", "gain", "Gain", 16, 248, 1, 16, self._gain),)

    def set_option(self, camera: CameraRole, name: str, value: float) -> None:
        if (camera, name) != ("tactile", "gain") or not 16 <= value <= 248:
            raise SourceError(f"troubled: {name} of the {camera} camera cannot be {value}; 16 to 248")
        self._gain = value


def open_troubled(folder: Path, progress: Progress) -> Troubled:
    """Open it; ``rig.txt`` in the folder holds another width, ``refuse.txt`` why it cannot be opened."""
    refusal, width = folder / "refuse.txt", folder / "rig.txt"
    if refusal.exists():
        raise SourceError(refusal.read_text())
    size = (int(width.read_text()), 14) if width.exists() else (20, 14)
    return Troubled(folder / "orders.txt", make_rig(tactile=size))


def open_nothing(kind: str, progress: Progress) -> FrameSource:
    if kind == "extra":
        raise MissingExtraError("the camera driver is not installed; install tactune[realsense]")
    if kind == "die":
        ctypes.string_at(0)
    raise ZeroDivisionError("a slip")


def open_for_ever(progress: Progress) -> FrameSource:
    while True:
        progress(0.25, "solving")
        time.sleep(0.01)
