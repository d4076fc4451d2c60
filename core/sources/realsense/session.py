"""A device while it streams: opened, read image by image, closed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from ...errors import SourceError
from ...model.arrays import AnyArray
from .calibration import Calibration, Stream, find_streams, read_calibration
from .devices import DeviceInfo
from .driver import load_driver

Kind = Literal["depth", "color"]

#: Images that wait in the driver's queue, a second of both streams; then the oldest is dropped. The queue is one
#: that keeps its frames: others count against the driver's pool of 16, and a full pool silently stops the stream.
_QUEUE: Final = 60
_BUSY = ("busy", "in use", "is streaming", "already opened", "errno=16", "power state")
_FORBIDDEN = ("permission", "errno=13", "access")


@dataclass(frozen=True, eq=False)
class Image:
    """One image, copied out of the driver.

    Attributes
    ----------
    pixels : uint16, shape (H, W), or uint8, shape (H, W, 3)
        Raw counts or RGB.
    stamp_s : float
        The camera's time stamp, seconds.
    on_host_clock : bool
        Whether the driver says that it counts on the computer's clock.
    """

    kind: Kind
    number: int
    pixels: AnyArray
    stamp_s: float
    on_host_clock: bool


class Session:
    """Depth and colour of one device, streaming from the moment that this is made until `close`.

    The sensors are opened directly, without the driver's pipeline: that waits for devices by itself, pairs
    by itself and drops what it cannot pair. The driver puts images into its own queue, so none of its
    threads ever waits for Python.

    Raises
    ------
    SourceError
        The device lacks a mode, is in use, may not be used or does not answer.
    """

    def __init__(self, device: Any, info: DeviceInfo) -> None:
        self.info = info
        self._driver = load_driver()
        try:
            streams = find_streams(device, info)
            self.calibration: Calibration = read_calibration(streams, info)
            self.depth_sensor = streams["depth"].sensor
            self._sensors = _by_sensor(streams)
            for sensor, _ in self._sensors:
                self._use_host_clock(sensor)
        except RuntimeError as error:
            raise SourceError(_explain(info, error)) from error
        self._queue = self._driver.frame_queue(_QUEUE, True)
        self._opened: list[Any] = []

    def start(self) -> None:
        """Let the images come; settings that should hold from the first one on are made before."""
        try:
            for sensor, profiles in self._sensors:
                sensor.open(profiles)
                self._opened.append(sensor)
                sensor.start(self._queue)
        except RuntimeError as error:
            self.close()
            raise SourceError(_explain(self.info, error)) from error

    def read(self, timeout_s: float) -> Image | None:
        """Wait for the next image of either stream and copy it; None if none comes in time.

        Raises
        ------
        RuntimeError
            The driver fails.
        """
        has_come, frame = self._queue.try_wait_for_frame(max(int(1e3 * timeout_s), 1))
        if not has_come:
            return None
        domain = frame.get_frame_timestamp_domain()
        return Image(
            kind="depth" if frame.get_profile().stream_type() == self._driver.stream.depth else "color",
            number=int(frame.get_frame_number()),
            pixels=np.array(np.asanyarray(frame.as_video_frame().get_data())),
            stamp_s=1e-3 * float(frame.get_timestamp()),
            on_host_clock=domain != self._driver.timestamp_domain.hardware_clock,
        )

    def flush(self) -> None:
        """Drop the images that wait."""
        while self._queue.poll_for_frame():
            pass

    def close(self) -> None:
        """Stop streaming; twice is harmless."""
        opened, self._opened = self._opened, []
        for sensor in opened:
            for step in (sensor.stop, sensor.close):
                try:
                    step()
                except RuntimeError:  # not started, or unplugged meanwhile
                    continue

    def _use_host_clock(self, sensor: Any) -> None:
        option = self._driver.option.global_time_enabled
        if sensor.supports(option) and not sensor.get_option(option):
            sensor.set_option(option, 1.0)


def _by_sensor(streams: dict[str, Stream]) -> list[tuple[Any, list[Any]]]:
    """Group the streams by the sensor that has them: a D405 has one for both."""
    groups: list[tuple[Any, list[Any]]] = []
    for stream in streams.values():
        for sensor, profiles in groups:
            if sensor is stream.sensor:
                profiles.append(stream.profile)
                break
        else:
            groups.append((stream.sensor, [stream.profile]))
    return groups


def _explain(info: DeviceInfo, error: RuntimeError) -> str:
    words = str(error).lower()
    if any(sign in words for sign in _BUSY):
        return f"the {info.title} is in use by another program; close it, the RealSense Viewer perhaps ({error})"
    if any(sign in words for sign in _FORBIDDEN):
        return f"the {info.title} may not be opened: udev rules are missing, tactune doctor says how to add them"
    return f"the {info.title} cannot be opened ({error}); plug it in again, or run tactune doctor"
