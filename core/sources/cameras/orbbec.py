"""Orbbec's cameras by pyorbbecsdk2: the Gemini family (stereo) and the Femto family (time of flight)."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from contextlib import suppress
from importlib.util import find_spec
from typing import Any, Final

import numpy as np

from ...errors import MissingExtraError, SourceError, closed_on_error, foreign
from ...model.frames import DepthCamera, Matrix4, camera_pose, pose_matrix
from ...model.loading import decode_image
from ..base import CameraOption, CameraRole
from ..lens_files import Lens, make_lens
from ..ros_image import RawImage
from .camera import Calibration, Camera, CameraDriver, DeviceInfo, Images

RATE_HZ: Final = 30
#: Depth of about this width is chosen where a camera offers several sizes, pixels.
_WIDTH: Final = 640
_FIRST_IMAGES_S: Final = 3.0
#: Formats of colour in the order of preference, with the names of the same encodings in ROS; MJPG is decoded.
_COLORS: Final = {
    "RGB": "rgb8", "BGR": "bgr8", "RGBA": "rgba8", "BGRA": "bgra8", "YUYV": "yuyv", "UYVY": "uyvy",
    "NV12": "nv12", "NV21": "nv21", "MJPG": "", "GRAY": "mono8", "Y8": "mono8",
}  # fmt: skip
#: The SDK's lens models that are defined somewhere, with their numbers of k1, k2, p1, p2, k3, k4, k5, k6.
_LENSES: Final = {"BROWN_CONRADY": ("plumb_bob", 5), "BROWN_CONRADY_K6": ("rational_polynomial", 8)}
#: Families by the beginnings of their names: a time-of-flight camera looks through the membrane.
_ROLES: Final[dict[str, CameraRole]] = {"Femto": "proximity", "Gemini": "tactile"}

#: Options that are offered where the camera has them, in the order in which they are applied: the SDK's property,
#: description, unit.
_OFFERED: Final = {
    "depth_auto_exposure": ("OB_PROP_DEPTH_AUTO_EXPOSURE_BOOL", "Automatic exposure of depth; 1 on, 0 off.", ""),
    "depth_exposure": ("OB_PROP_DEPTH_EXPOSURE_INT", "Exposure of depth, while the automatic is off.", ""),
    "depth_gain": ("OB_PROP_DEPTH_GAIN_INT", "Amplification of depth; more is brighter and noisier.", ""),
    "color_auto_exposure": ("OB_PROP_COLOR_AUTO_EXPOSURE_BOOL", "Automatic exposure of colour; 1 on, 0 off.", ""),
    "color_exposure": ("OB_PROP_COLOR_EXPOSURE_INT", "Exposure of colour, while the automatic is off.", ""),
    "laser": ("OB_PROP_LASER_CONTROL_INT", "The infrared projector; 0 off, 1 on.", ""),
    "laser_power": ("OB_PROP_LASER_POWER_LEVEL_CONTROL_INT", "Power of the infrared projector.", ""),
    "min_depth": ("OB_PROP_MIN_DEPTH_INT", "Depths nearer than this are dropped.", "mm"),
    "max_depth": ("OB_PROP_MAX_DEPTH_INT", "Depths farther than this are dropped.", "mm"),
}


class OrbbecDriver(CameraDriver):
    """The cameras of Orbbec, of which ``query`` lists those connected; none where the SDK is not installed."""

    title = "Orbbec"

    def __init__(self, query: Callable[[], Any] | None = None) -> None:
        self._find = query

    def devices(self) -> list[DeviceInfo]:
        if self._find is None and find_spec("pyorbbecsdk") is None:
            return []
        found = self._query()
        infos = []
        for n in range(found.get_count()):
            model = found.get_device_name_by_index(n).removeprefix("Orbbec ").strip() or "unknown"
            role = next((role for family, role in _ROLES.items() if model.startswith(family)), None)
            usb = found.get_device_connection_type_by_index(n).removeprefix("USB")
            infos.append(DeviceInfo(model, found.get_device_serial_number_by_index(n), role, usb=usb))
        return infos

    def open(self, serial: str, role: CameraRole) -> Camera:
        """Open a device; it streams from then on, since its first images tell its lenses and its unit."""
        info = next((info for info in self.devices() if info.serial == serial), None)
        if info is None:
            raise SourceError(f"the Orbbec camera with the serial {serial} is not connected; plug it in")
        sdk = load_sdk()
        try:
            return OrbbecCamera(sdk, self._query().get_device_by_serial_number(serial), info, role)
        except (RuntimeError, sdk.OBError) as error:
            remedy = "close other programs that use it, plug it in again, or install the SDK's udev rules"
            raise SourceError(f"the {info.title} cannot be opened ({error}); {remedy}") from error

    def _query(self) -> Any:
        sdk = load_sdk()
        try:
            self._find = self._find or sdk.Context().query_devices
            return self._find()
        except (RuntimeError, sdk.OBError) as error:
            raise SourceError(f"Orbbec's SDK cannot list its devices ({error}); plug them in again") from error


def load_sdk() -> Any:
    """Import the SDK, and keep it from writing a log into the folder in which the program was started."""
    try:
        sdk: Any = importlib.import_module("pyorbbecsdk")
    except ImportError as error:  # the extra would install what the SDK demands, too: another NumPy and Open3D
        remedy = "install it with pip install --no-deps pyorbbecsdk2"
        raise MissingExtraError(f"Orbbec's SDK cannot be loaded ({error}); {remedy}") from error
    sdk.Context.set_logger_level(sdk.OBLogLevel.NONE)
    return sdk


class OrbbecCamera(Camera):
    """Depth and colour of one device, paired by the SDK."""

    def __init__(self, sdk: Any, device: Any, info: DeviceInfo, role: CameraRole) -> None:
        self._sdk, self._device = sdk, device
        self._pipeline = sdk.Pipeline(device)
        self._is_streaming = False
        depth, color = self._profiles(info)
        config = sdk.Config()
        config.enable_stream(depth)
        if color is not None:
            config.enable_stream(color)
            self._pipeline.enable_frame_sync()
        config.set_frame_aggregate_output_mode(sdk.OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE)
        with suppress(RuntimeError, sdk.OBError):  # some have no clock that is matched to the computer's
            device.enable_global_timestamp(device.is_global_timestamp_supported())
        self._pipeline.start(config)
        self._is_streaming = True
        with closed_on_error(self.close):
            super().__init__(info, role, self._read_calibration(info), float(depth.get_fps()))

    def read(self, timeout_s: float) -> Images | None:
        frames = self._pipeline.wait_for_frames(max(int(1e3 * timeout_s), 1))
        depth = None if frames is None else frames.get_depth_frame()
        if depth is None:
            return None
        color = frames.get_color_frame()
        pixels = None if color is None else self._color_lens.rectify(_rgb(color))
        counts = np.array(depth.get_data()).view(np.uint16).reshape(depth.get_height(), depth.get_width())
        stamp_us = depth.get_global_timestamp_us() or depth.get_system_timestamp_us()
        return Images(int(depth.get_index()), self._depth_lens.rectify(counts), pixels, 1e-6 * stamp_us or time.time())

    def close(self) -> None:
        if self._is_streaming:
            self._is_streaming = False
            with suppress(RuntimeError, self._sdk.OBError):  # unplugged meanwhile
                self._pipeline.stop()

    def options(self) -> tuple[CameraOption, ...]:
        found = []
        for name in _OFFERED:
            with suppress(RuntimeError, self._sdk.OBError, AttributeError):  # not in this mode, or of another version
                found += self._option(name)
        return tuple(found)

    def set_option(self, name: str, value: float) -> None:
        known = {option.name: option for option in self.options()}
        if (option := known.get(name)) is None:
            raise SourceError(f"the {self.info.title} has no option {name!r}; it has {', '.join(known) or 'none'}")
        number, kind = self._property(name)
        try:
            getattr(self._device, f"set_{kind}_property")(number, bool(value) if kind == "bool" else int(value))
        except (RuntimeError, self._sdk.OBError) as error:
            allowed = f"allowed are {option.minimum:g} to {option.maximum:g} in steps of {option.step:g}"
            raise SourceError(f"the {self.info.title} refuses {name} = {value:g} ({error}); {allowed}") from error

    def _property(self, name: str) -> tuple[Any, str]:
        """Return the SDK's number of a setting and its kind, ``bool`` or ``int``."""
        number = _OFFERED[name][0]
        return getattr(self._sdk.OBPropertyID, number), number.rpartition("_")[2].lower()

    def _option(self, name: str) -> list[CameraOption]:
        number, kind = self._property(name)
        if not self._device.is_property_supported(number, self._sdk.OBPermissionType.PERMISSION_READ_WRITE):
            return []
        extent = getattr(self._device, f"get_{kind}_property_range")(number)
        lowest, highest, step, usual = map(float, (extent.min, extent.max, extent.step, extent.default_value))
        value = float(getattr(self._device, f"get_{kind}_property")(number))
        _, description, unit = _OFFERED[name]
        return [CameraOption(self.role, name, description, lowest, highest, step, usual, value, unit)]

    def _profiles(self, info: DeviceInfo) -> tuple[Any, Any | None]:
        """Return the streams: depth of a usual size, and colour of the nearest size in the best format."""
        order = list(_COLORS)
        depths = self._offered(self._sdk.OBSensorType.DEPTH_SENSOR, ["Y16", "Z16"])
        colors = self._offered(self._sdk.OBSensorType.COLOR_SENSOR, order)
        if not depths:
            raise SourceError(f"the {info.title} offers no depth at {RATE_HZ} Hz; use a USB 3 port or newer firmware")
        depth = min(depths, key=lambda each: abs(each.get_width() - _WIDTH))
        colors.sort(key=lambda each: (abs(each.get_width() - depth.get_width()), order.index(each.get_format().name)))
        return depth, next(iter(colors), None)

    def _offered(self, sensor: Any, formats: list[str]) -> list[Any]:
        try:
            profiles = self._pipeline.get_stream_profile_list(sensor)
        except (RuntimeError, self._sdk.OBError):  # a camera without colour
            return []
        found = (profiles.get_stream_profile_by_index(n) for n in range(profiles.get_count()))
        videos = [each.as_video_stream_profile() for each in found if each.is_video_stream_profile()]
        return [each for each in videos if each.get_fps() == RATE_HZ and each.get_format().name in formats]

    def _read_calibration(self, info: DeviceInfo) -> Calibration:
        """Return lenses, pose and depth unit as the first images state them."""
        frames = self._pipeline.wait_for_frames(int(1e3 * _FIRST_IMAGES_S))
        if frames is None or (depth := frames.get_depth_frame()) is None:
            raise SourceError(f"the {info.title} sends no images; plug it into another USB 3 port")
        color = frames.get_color_frame()
        try:
            self._depth_lens = _lens(depth)
            unit_m = float(f"{1e-3 * depth.get_depth_scale():.7g}")  # the SDK keeps it in single precision
            lens = self._depth_lens.intrinsics
            camera = DepthCamera(model=info.model, serial=info.serial, intrinsics=lens, depth_unit_m=unit_m)
            if color is None:
                return Calibration(camera)
            self._color_lens = _lens(color)
            return Calibration(camera, self._color_lens.intrinsics, _pose(depth, color))
        except (ValueError, SourceError) as error:
            told = f"an impossible lens, pose or depth unit ({foreign(error)}); update its firmware"
            raise SourceError(f"the {info.title} reports {told}") from error


def _lens(frame: Any) -> Lens:
    profile = frame.get_stream_profile().as_video_stream_profile()
    lens, bend = profile.get_intrinsic(), profile.get_distortion()
    d = [float(getattr(bend, name)) for name in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")]
    model, count = _LENSES.get(bend.model.name, (bend.model.name.lower(), 8))
    matrix = [lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0]
    return make_lens(model, d[:count], matrix, (frame.get_width(), frame.get_height()))


def _pose(depth: Any, color: Any) -> Matrix4:
    extrinsic = depth.get_stream_profile().get_extrinsic_to(color.get_stream_profile())
    return camera_pose(pose_matrix(np.reshape(extrinsic.rot, (3, 3)), 1e-3 * np.ravel(extrinsic.transform)))


def _rgb(color: Any) -> Any:
    data, encoding = np.asarray(color.get_data()), _COLORS[color.get_format().name]
    height, width = color.get_height(), color.get_width()
    if not encoding:
        return RawImage.of_pixels(decode_image(data.tobytes()), "bgr8").color((height, width))
    step = width if encoding.startswith("nv") else data.size // height
    return RawImage(height, width, encoding, False, step, data).color((height, width))
