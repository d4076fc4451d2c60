"""RealSense recordings independent of the file format: cameras, lenses, poses, units, times."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from ...errors import SourceError
from ...model.arrays import Float64Array, Int64Array, Uint8Array, Uint16Array
from ...model.frames import DepthCamera, Matrix4, camera_pose
from ...model.intrinsics import Distortion, Intrinsics
from ..base import Progress
from ..cameras.camera import Calibration
from ..ros_image import DamagedFileError

HARDWARE_CLOCK = "Hardware Clock"


@dataclass(frozen=True, eq=False)
class Stream:
    """One image stream: its lens and time stamps.

    Attributes
    ----------
    topic : str
        Prefix of all its topics, such as ``"/device_0/sensor_0/Depth_0"``.
    clock : str
        Clock of ``stamps_s``, in librealsense's words; empty if unknown.
    stamps_s : float64, shape (N,)
        The images' own time stamps, seconds.
    recorded_s : float64, shape (N,)
        When each was recorded, seconds on the one clock of the whole recording.
    arrived_s : float64, shape (N,), or None
        When each reached the computer, seconds of its system time; None if the recording does not say.
    """

    topic: str
    intrinsics: Intrinsics
    rate_hz: float
    clock: str
    stamps_s: Float64Array
    recorded_s: Float64Array
    arrived_s: Float64Array | None

    def __len__(self) -> int:
        return len(self.stamps_s)


@dataclass(frozen=True, eq=False)
class Camera:
    """One device: its depth stream and, where recorded, its colour stream."""

    recording: Recording
    calibration: Calibration
    depth: Stream
    color: Stream | None

    @property
    def info(self) -> DepthCamera:
        """Model, serial number, lens and depth unit."""
        return self.calibration.depth


@dataclass(frozen=True, eq=False)
class ImageTimes:
    """Time stamps of the images of one stream as in the file; clock and arrival may be unknown.

    ``clocks`` is an empty string and ``arrived_ms`` is 0 where an image has none.
    """

    recorded_ns: Int64Array
    stamps_s: Float64Array
    clocks: Sequence[str]
    arrived_ms: Float64Array


@dataclass(frozen=True)
class Lens:
    """A lens as in the file, unchecked."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: str
    coefficients: tuple[float, ...]


class Recording(ABC):
    """An open recording: its cameras, by device number, and their images on demand.

    Subclasses read the parts of one file format; this class puts them together.

    Raises
    ------
    SourceError
        The file is damaged or no RealSense recording with depth.
    """

    def __init__(self, path: Path, progress: Progress | None) -> None:
        self.path = path
        self._progress = progress
        self.is_complete = True
        self._is_open = True
        try:
            with self._damage_told():
                self._open()
                self.cameras = self._find_cameras()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; twice is harmless."""
        self._is_open = False
        self._close()

    def depth_image(self, stream: Stream, index: int) -> Uint16Array:
        """Return raw counts: uint16, shape (H, W)."""
        with self._damage_told(f"image {index} of {stream.topic}"):
            return self._depth_image(stream, index)

    def color_image(self, stream: Stream, index: int) -> Uint8Array:
        """Return a colour image: RGB uint8, shape (H, W, 3)."""
        with self._damage_told(f"image {index} of {stream.topic}"):
            return self._color_image(stream, index)

    # A format implements these; each may raise DamagedFileError.

    @abstractmethod
    def _open(self) -> None: ...

    @abstractmethod
    def _close(self) -> None: ...

    @abstractmethod
    def _streams(self) -> dict[tuple[int, str], str]:
        """Return the topics of the streams with images by device number and ``"Depth"`` or ``"Color"``."""

    @abstractmethod
    def _times(self, topics: Sequence[str]) -> Mapping[str, ImageTimes]: ...

    @abstractmethod
    def _device_info(self, device: int) -> Mapping[str, str]: ...

    @abstractmethod
    def _rate_hz(self, topic: str) -> float: ...

    @abstractmethod
    def _lens(self, topic: str) -> Lens: ...

    @abstractmethod
    def _depth_unit_m(self, sensor: str) -> float | None: ...

    @abstractmethod
    def _poses(self, topic: str) -> Mapping[str, Float64Array]:
        """Return 4 x 4 matrices from a named reference to the stream, by the reference's name."""

    @abstractmethod
    def _depth_image(self, stream: Stream, index: int) -> Uint16Array: ...

    @abstractmethod
    def _color_image(self, stream: Stream, index: int) -> Uint8Array: ...

    def _find_cameras(self) -> list[Camera]:
        streams = self._streams()
        devices = sorted(device for device, kind in streams if kind == "Depth")
        if not devices:
            raise self._refusal("it holds no depth images")
        times = self._times(sorted(streams.values()))
        return [self._camera(device, streams, times) for device in devices]

    def _camera(self, device: int, streams: Mapping[tuple[int, str], str], times: Mapping[str, ImageTimes]) -> Camera:
        depth = self._stream(streams[device, "Depth"], times)
        sensor = "/".join(depth.topic.split("/")[:3])
        unit_m = self._depth_unit_m(sensor)
        if unit_m is None:
            raise self._refusal(f"the depth unit is missing (topic {sensor}/option/Depth_Units/value)")
        if not 1e-7 <= unit_m <= 1.0:
            raise self._refusal(f"the depth unit is {unit_m} m, but it must be above 0 and at most 1")
        names = self._device_info(device)
        info = DepthCamera(
            model=_plain(names.get("Name", "unknown")),
            serial=_plain(names.get("Serial Number", "")),
            intrinsics=depth.intrinsics,
            depth_unit_m=unit_m,
        )
        if (device, "Color") not in streams:
            return Camera(self, Calibration(info), depth, None)
        color = self._stream(streams[device, "Color"], times)
        return Camera(self, Calibration(info, color.intrinsics, self._pose(color, depth)), depth, color)

    def _stream(self, topic: str, times: Mapping[str, ImageTimes]) -> Stream:
        clock, stamps_s, arrived_s = on_one_clock(times[topic])
        return Stream(
            topic=topic,
            intrinsics=self._intrinsics(topic),
            rate_hz=self._rate_hz(topic),
            clock=clock,
            stamps_s=stamps_s,
            recorded_s=np.asarray(times[topic].recorded_ns * 1e-9, np.float64),
            arrived_s=arrived_s,
        )

    def _intrinsics(self, topic: str) -> Intrinsics:
        lens = self._lens(topic)
        try:
            distortion = Distortion(lens.model.lower().replace(" ", "_"))
        except ValueError as error:
            known = ", ".join(Distortion)
            raise self._refusal(f"{topic} has the lens model {_plain(lens.model)!r}; known are {known}") from error
        try:
            return Intrinsics(
                width=lens.width,
                height=lens.height,
                fx=lens.fx,
                fy=lens.fy,
                cx=lens.cx,
                cy=lens.cy,
                distortion=distortion,
                coefficients=lens.coefficients,
            )
        except ValidationError as error:
            field = ".".join(str(part) for part in error.errors()[0]["loc"])
            raise self._refusal(f"{topic}: {field} of the lens is out of range") from error

    def _pose(self, color: Stream, depth: Stream) -> Matrix4:
        """Return the transform from depth to colour coordinates, via a reference frame of both."""
        to_color, to_depth = self._poses(color.topic), self._poses(depth.topic)
        common = to_color.keys() & to_depth.keys()
        if not common:
            raise self._refusal(f"the pose of {color.topic} to {depth.topic} is missing (topics such as …/tf/0)")
        reference = min(common)
        try:
            return camera_pose(to_color[reference] @ np.linalg.inv(to_depth[reference]))
        except (ValueError, np.linalg.LinAlgError) as error:
            raise self._refusal(f"the pose of {color.topic} to {depth.topic} is damaged: {error}") from error

    def _refusal(self, what: str) -> SourceError:
        return SourceError(f"{self.path}: {what}; record it again with the RealSense viewer or rs-record")

    @contextmanager
    def _damage_told(self, where: str = "") -> Iterator[None]:
        """Turn damage into a `SourceError` of one sentence."""
        if not self._is_open:
            raise SourceError(f"{self.path} is closed; open it again")
        try:
            yield
        except DamagedFileError as error:
            detail = " ".join(str(error).split())
            what = f"{where} cannot be read" if where else "this is no readable RealSense recording"
            raise SourceError(f"{self.path}: {what} ({detail}); copy or record it again") from error
        except OSError as error:
            raise SourceError(f"cannot read {self.path}: {error.strerror or error}; check the disk") from error


def on_one_clock(times: ImageTimes) -> tuple[str, Float64Array, Float64Array | None]:
    """Return the clock of most images, the stamps of all on it, and their arrival in seconds, if known.

    The first images of a camera may be on its own clock, until the driver knows its offset to the computer's. Their
    stamps are estimated from their recording times.
    """
    clock = Counter(times.clocks).most_common(1)[0][0]
    recorded_s = times.recorded_ns * 1e-9
    stamps_s = times.stamps_s
    other = np.array([name != clock for name in times.clocks])
    if other.any():
        stamps_s = np.where(other, recorded_s + np.median((stamps_s - recorded_s)[~other]), stamps_s)
    arrived_s = times.arrived_ms * 1e-3
    return clock, stamps_s, arrived_s if (arrived_s > 0).all() else None


def milliseconds(text: str) -> float:
    """Return a time in text as a number; 0, which means unknown, where it is not a number."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if math.isfinite(value) else 0.0


def _plain(text: str) -> str:
    """Return a name from a file as one short printable line."""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())[:80]
