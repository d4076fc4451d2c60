"""RealSense cameras by Intel's pyrealsense2: devices, streaming, factory calibration and options."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final, NamedTuple

import numpy as np

from ...errors import SourceError, extra, foreign
from ...model.frames import DepthCamera, Matrix4, camera_pose, pose_matrix
from ...model.intrinsics import Distortion, Intrinsics
from ..base import CameraOption, CameraRole
from .camera import Calibration, Camera, CameraDriver, DeviceInfo, Images

#: Returns the driver's objects of the connected devices.
DeviceQuery = Callable[[], Iterable[Any]]

#: The last release that knows the L515; the next one dropped it.
_LAST_WITH_L515 = 2, 54, 2

#: An L515 looks through the membrane, a D405 sees the membrane; others are used where their serial number is named.
_ROLES: dict[str, CameraRole] = {"L515": "proximity", "D405": "tactile"}


class RealSenseDriver(CameraDriver):
    """The RealSense cameras; ``query`` returns the driver's objects of the connected devices."""

    title = "RealSense"

    def __init__(self, query: DeviceQuery | None = None) -> None:
        self._find = query

    def devices(self) -> list[DeviceInfo]:
        return [describe(device) for device in self._query()]

    def open(self, serial: str, role: CameraRole) -> Camera:
        for device in self._query():
            if (info := describe(device)).serial == serial:
                return RealSenseCamera(load_driver(), device, info, role)
        raise SourceError(f"the RealSense camera with the serial {serial} is not connected; plug it in")

    def hint(self) -> str:
        """Return why this version of the driver finds no L515."""
        return no_l515_sentence(driver_version())

    def _query(self) -> list[Any]:
        if self._find is None:
            self._find = load_driver().context().query_devices
        try:
            return list(self._find())
        except RuntimeError as error:
            raise SourceError(f"the camera driver cannot list its devices ({error}); plug them in again") from error


def load_driver() -> Any:
    return extra("pyrealsense2", "a RealSense camera", "realsense")


def driver_version() -> str:
    """Return the driver's version, such as ``"2.54.2.5684"``, or an empty string if it is not installed."""
    try:
        return version("pyrealsense2")
    except PackageNotFoundError:
        return ""


def no_l515_sentence(driver: str) -> str:
    """Return why a driver of this version finds no L515, and what to install; empty if it supports the L515."""
    if tuple(map(int, re.findall(r"\d+", driver)))[:3] <= _LAST_WITH_L515:
        return ""
    return (
        f"the camera driver {driver} no longer supports the L515: with Python 3.11, "
        f"pip install 'pyrealsense2==2.54.2.5684'"
    )


def describe(device: Any) -> DeviceInfo:
    """Return the information about one of the driver's devices."""
    driver = load_driver()

    def told(name: str) -> str:
        info = getattr(driver.camera_info, name)
        return str(device.get_info(info)) if device.supports(info) else ""

    try:
        model = told("name").removeprefix("Intel RealSense ").removeprefix("RealSense ").strip() or "unknown"
        usb = told("usb_type_descriptor")
        return DeviceInfo(
            model=model,
            serial=told("serial_number"),
            role=_ROLES.get(model),
            firmware=told("firmware_version"),
            usb=usb,
            problem="it runs at USB 2, too slow for these cameras; use a USB 3 port and cable"
            if usb.startswith("2")
            else "",
        )
    except RuntimeError as error:
        return DeviceInfo(model="unknown", serial="", problem=f"it does not answer ({error}); plug it in again")


# One camera

WIDTH, HEIGHT, RATE_HZ = 640, 480, 30
_FORMATS = {"depth": "z16", "color": "rgb8"}

#: Images of a stream that the driver holds at most, and framesets of them that wait for a busy computer. A pool that is
#: full silently stops the stream, so the queue is shorter.
_POOL, _QUEUE = 32, 24
_BUSY = ("busy", "in use", "is streaming", "already opened", "errno=16", "power state")
_FORBIDDEN = ("permission", "errno=13", "access")

#: Options that are offered where the camera has them, in the order in which they are applied: description, unit. A
#: visual preset changes most others, and exposure and gain turn the automatic off.
_OFFERED: Final = {
    "visual_preset": ("A set of values for one purpose; selecting one changes other settings.", ""),
    "exposure": ("Exposure time; setting it turns automatic exposure off.", "us"),
    "gain": ("Amplification of the image sensor; more is brighter and noisier.", ""),
    "enable_auto_exposure": ("Automatic exposure and gain; 1 on, 0 off.", ""),
    "emitter_enabled": ("The infrared projector; 0 off, 1 on.", ""),
    "laser_power": ("Power of the infrared laser; less helps near objects, which are otherwise too bright.", ""),
    "receiver_gain": ("Gain of the laser's receiver; less helps near objects, more helps dark ones.", ""),
    "digital_gain": ("Gain after the laser's receiver: 1 high, 2 low, for places with ambient light.", ""),
    "confidence_threshold": ("Depths with lower confidence are dropped.", ""),
    "min_distance": ("Depths nearer than this are dropped.", "mm"),
    "noise_filtering": ("Strength of the camera's own noise filter.", ""),
    "pre_processing_sharpening": ("Sharpening before depth is computed.", ""),
    "post_processing_sharpening": ("Sharpening of the depth image.", ""),
}

#: Visual preset of an L515 for objects as near as the membrane; it is set unless the preset names another.
_SHORT_RANGE: Final = 5.0


class _Stream(NamedTuple):
    """One stream of a device: the driver's sensor and profile."""

    sensor: Any
    profile: Any


class RealSenseCamera(Camera):
    """Depth and colour of one device, without the driver's pipeline, which waits for devices by itself."""

    def __init__(self, driver: Any, device: Any, info: DeviceInfo, role: CameraRole) -> None:
        self._driver = driver
        try:
            depth, color = _find_streams(device, info)
            super().__init__(info, role, _read_calibration(depth, color, info), float(RATE_HZ))
            self._depth_sensor = depth.sensor
            self._sensors = [(depth.sensor, [depth.profile]), (color.sensor, [color.profile])]
            if depth.sensor is color.sensor:  # as in a D405
                self._sensors = [(depth.sensor, [depth.profile, color.profile])]
            needed = {driver.option.global_time_enabled: 1.0, driver.option.frames_queue_size: float(_POOL)}
            for sensor, _ in self._sensors:
                for option, value in needed.items():
                    if sensor.supports(option) and sensor.get_option(option) != value:
                        sensor.set_option(option, value)
            if self._is_l515:
                self._depth_sensor.set_option(driver.option.visual_preset, _SHORT_RANGE)
        except RuntimeError as error:
            raise SourceError(_explain(info, error)) from error
        self._syncer = driver.syncer(_QUEUE)
        self._opened: list[Any] = []

    def start(self) -> None:
        try:
            for sensor, profiles in self._sensors:
                sensor.open(profiles)
                self._opened.append(sensor)
                sensor.start(self._syncer)
        except RuntimeError as error:
            self.close()
            raise SourceError(_explain(self.info, error)) from error

    def read(self, timeout_s: float) -> Images | None:
        """Wait for the next images and copy them; None if none come in time, or no depth image."""
        has_come, frames = self._syncer.try_wait_for_frames(max(int(1e3 * timeout_s), 1))
        depth = frames.get_depth_frame() if has_come else None
        if not depth:
            return None
        color = frames.get_color_frame()
        is_hosts = depth.get_frame_timestamp_domain() != self._driver.timestamp_domain.hardware_clock
        return Images(
            number=int(depth.get_frame_number()),
            depth=np.array(np.asanyarray(depth.get_data())),
            color=np.array(np.asanyarray(color.get_data())) if color else None,
            time_s=1e-3 * float(depth.get_timestamp()) if is_hosts else time.time(),
        )

    def close(self) -> None:
        opened, self._opened = self._opened, []
        for sensor in opened:
            for step in (sensor.stop, sensor.close):
                with suppress(RuntimeError):  # not started, or unplugged meanwhile
                    step()

    def options(self) -> tuple[CameraOption, ...]:
        options = []
        for name in _OFFERED:
            with suppress(RuntimeError):  # some cannot be read in some modes
                options += self._option(name)
        return tuple(options)

    def set_option(self, name: str, value: float) -> None:
        sensor = self._depth_sensor
        option = getattr(self._driver.option, name, None) if name in _OFFERED else None
        if option is None or not sensor.supports(option):
            known = ", ".join(known.name for known in self.options())
            raise SourceError(f"the {self.info.title} has no option {name!r}; it has {known or 'none'}")
        try:
            sensor.set_option(option, value)
        except RuntimeError as error:
            extent = sensor.get_option_range(option)
            raise SourceError(
                f"the {self.info.title} refuses {name} = {value:g} ({error}); "
                f"allowed are {extent.min:g} to {extent.max:g} in steps of {extent.step:g}"
            ) from error

    def _option(self, name: str) -> list[CameraOption]:
        """Return one setting; none where the camera does not have it."""
        option, sensor = getattr(self._driver.option, name, None), self._depth_sensor
        if option is None or not sensor.supports(option):
            return []
        extent = sensor.get_option_range(option)
        description, unit = _OFFERED[name]
        is_preset = name == "visual_preset"
        numbers = range(int(extent.min), int(extent.max) + 1) if is_preset else ()
        named = ((float(number), sensor.get_option_value_description(option, float(number))) for number in numbers)
        return [
            CameraOption(
                camera=self.role,
                name=name,
                description=description,
                minimum=float(extent.min),
                maximum=float(extent.max),
                step=float(extent.step),
                default=_SHORT_RANGE if is_preset and self._is_l515 else float(extent.default),
                value=float(sensor.get_option(option)),
                unit=unit,
                choices=tuple((number, str(words)) for number, words in named if words),
                read_only=bool(sensor.is_option_read_only(option)),
            )
        ]

    @property
    def _is_l515(self) -> bool:
        return self.info.model == "L515"


def _find_streams(device: Any, info: DeviceInfo) -> tuple[_Stream, _Stream]:
    """Return the depth and the colour stream in the needed mode; `SourceError` names the modes that there are."""
    found: dict[str, _Stream] = {}
    modes = set()
    for sensor in device.query_sensors():
        for profile in sensor.get_stream_profiles():
            kind = profile.stream_type().name
            if kind not in _FORMATS or profile.format().name != _FORMATS[kind]:
                continue
            video = profile.as_video_stream_profile()
            mode = video.width(), video.height(), profile.fps()
            modes.add(f"{kind} {mode[0]} x {mode[1]} at {mode[2]} Hz")
            if mode == (WIDTH, HEIGHT, RATE_HZ):
                found.setdefault(kind, _Stream(sensor, profile))
    for kind in _FORMATS:
        if kind not in found:
            raise SourceError(
                f"the {info.title} offers no {kind} stream of {WIDTH} x {HEIGHT} at {RATE_HZ} Hz, but "
                f"{', '.join(sorted(modes)) or 'none at all'}; use a USB 3 port, or update the camera's firmware"
            )
    return found["depth"], found["color"]


def _read_calibration(depth: _Stream, color: _Stream, info: DeviceInfo) -> Calibration:
    """Return the device's lenses, their pose and its depth unit; `SourceError` if these are not possible."""
    unit_m = float(depth.sensor.as_depth_sensor().get_depth_scale()) if depth.sensor.is_depth_sensor() else 0.0
    try:
        camera = DepthCamera(
            model=info.model,
            serial=info.serial,
            intrinsics=_lens(depth.profile),
            depth_unit_m=float(f"{unit_m:.7g}"),  # the driver keeps it in single precision
        )
        return Calibration(camera, _lens(color.profile), _pose(depth.profile, color.profile))
    except ValueError as error:
        told = f"an impossible lens, pose or depth unit ({foreign(error)}); update its firmware, or calibrate it"
        raise SourceError(f"the {info.title} reports {told}") from error


def _lens(profile: Any) -> Intrinsics:
    lens = profile.as_video_stream_profile().get_intrinsics()
    coefficients = tuple(float(value) for value in lens.coeffs)
    if lens.model.name not in list(Distortion) and any(coefficients):
        raise ValueError(f"lens model {lens.model.name}")
    return Intrinsics(
        width=lens.width,
        height=lens.height,
        fx=lens.fx,
        fy=lens.fy,
        cx=lens.ppx,
        cy=lens.ppy,
        distortion=Distortion(lens.model.name) if lens.model.name in list(Distortion) else Distortion.NONE,
        coefficients=coefficients,
    )


def _pose(source: Any, target: Any) -> Matrix4:
    extrinsics = source.get_extrinsics_to(target)
    rotation = np.reshape(extrinsics.rotation, (3, 3)).T  # column-major in the driver
    return camera_pose(pose_matrix(rotation, extrinsics.translation))


def _explain(info: DeviceInfo, error: RuntimeError) -> str:
    words = str(error).lower()
    if any(sign in words for sign in _BUSY):
        return f"the {info.title} is in use by another program; close it, the RealSense Viewer perhaps ({error})"
    if any(sign in words for sign in _FORBIDDEN):
        return f"the {info.title} may not be opened: udev rules are missing, tactune doctor says how to add them"
    return f"the {info.title} cannot be opened ({error}); plug it in again, or run tactune doctor"
