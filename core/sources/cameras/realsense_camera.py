"""One RealSense camera: streaming, factory calibration and options."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final, NamedTuple

import numpy as np
from pydantic import ValidationError

from ...errors import SourceError
from ...model.frames import DepthCamera, Matrix4, camera_pose
from ...model.intrinsics import Distortion, Intrinsics
from ..base import CameraOption, CameraRole
from .camera import Calibration, Camera, DeviceInfo, Image, StreamLens

WIDTH, HEIGHT, RATE_HZ = 640, 480, 30
_FORMATS = {"depth": "z16", "color": "rgb8"}

#: Images that wait in the driver's queue: a second of both streams, then the oldest is dropped. The queue keeps its
#: frames; other queues count against the driver's pool of 16, and a full pool silently stops the stream.
_QUEUE: Final = 60
_BUSY = ("busy", "in use", "is streaming", "already opened", "errno=16", "power state")
_FORBIDDEN = ("permission", "errno=13", "access")

VISUAL_PRESET: Final = "visual_preset"
_AUTO_EXPOSURE: Final = "enable_auto_exposure"

#: Options that are offered where the camera has them, in the order in which they are applied: description, unit.
_OFFERED: Final = {
    VISUAL_PRESET: ("A set of values for one purpose; selecting one changes other settings.", ""),
    _AUTO_EXPOSURE: ("Automatic exposure and gain; 1 on, 0 off.", ""),
    "exposure": ("Exposure time; setting it turns automatic exposure off.", "us"),
    "gain": ("Amplification of the image sensor; more is brighter and noisier.", ""),
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
#: Options that an L515's visual preset sets too.
_SET_BY_PRESET: Final = frozenset(_OFFERED) - {VISUAL_PRESET, _AUTO_EXPOSURE, "exposure", "gain", "emitter_enabled"}

#: Visual preset of an L515 for objects as near as the membrane.
_SHORT_RANGE: Final = 5.0


class _Stream(NamedTuple):
    """One stream of a device: the driver's sensor and profile."""

    sensor: Any
    profile: Any


class RealSenseCamera(Camera):
    """Depth and colour of one device.

    The sensors are opened directly, without the driver's pipeline, which waits for devices by itself and drops images
    that it cannot pair. The driver puts images into its own queue, so none of its threads waits for Python.
    """

    def __init__(self, driver: Any, device: Any, info: DeviceInfo, role: CameraRole) -> None:
        self._driver = driver
        try:
            streams = _find_streams(device, info)
            super().__init__(info, role, _read_calibration(streams, info), float(RATE_HZ))
            self._depth_sensor = streams["depth"].sensor
            self._sensors = _by_sensor(streams)
            option = driver.option.global_time_enabled
            for sensor, _ in self._sensors:
                if sensor.supports(option) and not sensor.get_option(option):
                    sensor.set_option(option, 1.0)
        except RuntimeError as error:
            raise SourceError(_explain(info, error)) from error
        self._queue = self._driver.frame_queue(_QUEUE, True)
        self._opened: list[Any] = []

    @property
    def defaults(self) -> Mapping[str, float]:
        """The short-range visual preset for an L515."""
        return {VISUAL_PRESET: _SHORT_RANGE} if self._is_l500 else {}

    def start(self) -> None:
        """Start streaming."""
        try:
            for sensor, profiles in self._sensors:
                sensor.open(profiles)
                self._opened.append(sensor)
                sensor.start(self._queue)
        except RuntimeError as error:
            self.close()
            raise SourceError(_explain(self.info, error)) from error

    def read(self, timeout_s: float) -> Sequence[Image]:
        """Wait for the next image of either stream and copy it."""
        has_come, frame = self._queue.try_wait_for_frame(max(int(1e3 * timeout_s), 1))
        if not has_come:
            return ()
        domain = frame.get_frame_timestamp_domain()
        image = Image(
            kind="depth" if frame.get_profile().stream_type() == self._driver.stream.depth else "color",
            number=int(frame.get_frame_number()),
            pixels=np.array(np.asanyarray(frame.as_video_frame().get_data())),
            stamp_s=1e-3 * float(frame.get_timestamp()),
            on_host_clock=domain != self._driver.timestamp_domain.hardware_clock,
        )
        return (image,)

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

    def options(self) -> tuple[CameraOption, ...]:
        """Return the settings that can be changed, with their present values."""
        options = []
        for name in _OFFERED:
            try:
                option = self._option(name)
            except RuntimeError:  # some cannot be read in some modes
                continue
            if option is not None:
                options.append(option)
        return tuple(options)

    def set_option(self, name: str, value: float) -> None:
        """Change one setting."""
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

    def apply_options(self, wanted: Mapping[str, float]) -> list[str]:
        """Set options in an order in which none undoes another; return a sentence for each refused one."""
        order = list(_OFFERED)
        names = sorted(wanted, key=lambda name: order.index(name) if name in order else len(order))
        # Exposure and gain would turn the automatic exposure off again.
        skipped = ("exposure", "gain") if wanted.get(_AUTO_EXPOSURE) else ()
        return self._apply((name, wanted[name]) for name in names if name not in skipped)

    def reset_by(self, name: str) -> Collection[str]:
        """Return the options that a visual preset sets too."""
        return _SET_BY_PRESET if name == VISUAL_PRESET else ()

    def _option(self, name: str) -> CameraOption | None:
        option, sensor = getattr(self._driver.option, name, None), self._depth_sensor
        if option is None or not sensor.supports(option):
            return None
        extent = sensor.get_option_range(option)
        description, unit = _OFFERED[name]
        return CameraOption(
            camera=self.role,
            name=name,
            description=description,
            minimum=float(extent.min),
            maximum=float(extent.max),
            step=float(extent.step),
            # The default of options that the preset does not name.
            default=self.defaults.get(name, float(extent.default)),
            value=float(sensor.get_option(option)),
            unit=unit,
            choices=self._choices(option, extent) if name == VISUAL_PRESET else (),
            read_only=bool(sensor.is_option_read_only(option)),
        )

    def _choices(self, option: Any, extent: Any) -> tuple[tuple[float, str], ...]:
        enumeration = self._driver.l500_visual_preset if self._is_l500 else self._driver.rs400_visual_preset
        names = {int(member): name.replace("_", " ") for name, member in enumeration.__members__.items()}
        choices = []
        for number in range(int(extent.min), int(extent.max) + 1):
            told = self._depth_sensor.get_option_value_description(option, float(number))
            if told or number in names:
                choices.append((float(number), str(told or names[number])))
        return tuple(choices)

    @property
    def _is_l500(self) -> bool:
        return self.info.model.startswith("L5")


def _find_streams(device: Any, info: DeviceInfo) -> dict[str, _Stream]:
    """Return the depth and the colour stream in the needed mode; `SourceError` names the modes that there are."""
    found: dict[str, _Stream] = {}
    for sensor in device.query_sensors():
        for profile in sensor.get_stream_profiles():
            kind = profile.stream_type().name
            if kind not in found and _is_wanted(profile, kind):
                found[kind] = _Stream(sensor, profile)
    for kind, form in _FORMATS.items():
        if kind not in found:
            there = [str(mode) for mode in info.modes if mode.stream == kind]
            raise SourceError(
                f"the {info.title} offers no {kind} stream of {WIDTH} x {HEIGHT} at {RATE_HZ} Hz ({form}), but "
                f"{', '.join(there[:12]) or 'none at all'}; use a USB 3 port, or update the camera's firmware"
            )
    return found


def _is_wanted(profile: Any, kind: str) -> bool:
    if not profile.is_video_stream_profile() or profile.format().name != _FORMATS.get(kind):
        return False
    video = profile.as_video_stream_profile()
    return (video.width(), video.height(), profile.fps()) == (WIDTH, HEIGHT, RATE_HZ)


def _read_calibration(streams: dict[str, _Stream], info: DeviceInfo) -> Calibration:
    """Return the device's lenses, their pose and its depth unit; `SourceError` if these are not possible."""
    depth, color = streams["depth"], streams["color"]
    unit_m = float(depth.sensor.as_depth_sensor().get_depth_scale()) if depth.sensor.is_depth_sensor() else 0.0
    if not unit_m > 0.0:
        raise SourceError(
            f"the {info.title} reports a depth unit of {unit_m:g} m, so its depths are meaningless; "
            "plug it in again, or update its firmware"
        )
    try:
        camera = DepthCamera(
            model=info.model,
            serial=info.serial,
            intrinsics=_lens(depth.profile),
            depth_unit_m=float(f"{unit_m:.7g}"),  # the driver keeps it in single precision
        )
        return Calibration(camera, _lens(color.profile), _pose(depth.profile, color.profile))
    except (ValidationError, ValueError) as error:
        raise SourceError(f"the {info.title} reports a lens or pose that cannot be ({error}); calibrate it") from error


def read_lenses(device: Any) -> list[StreamLens]:
    """Return the lens of every size of a device's depth and colour images; sizes without one are left out."""
    found: dict[tuple[str, int, int], Intrinsics] = {}
    unit_m = 0.0
    for sensor in device.query_sensors():
        if sensor.is_depth_sensor():
            unit_m = float(f"{sensor.as_depth_sensor().get_depth_scale():.7g}")
        for profile in sensor.get_stream_profiles():
            kind = profile.stream_type().name
            if kind not in _FORMATS or not profile.is_video_stream_profile():
                continue
            with suppress(RuntimeError, ValueError):  # ValidationError is a ValueError
                lens = _lens(profile)
                found.setdefault((kind, lens.width, lens.height), lens)
    return [StreamLens("depth" if kind == "depth" else "color", lens, unit_m) for (kind, _, _), lens in found.items()]


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
    matrix = np.eye(4)
    matrix[:3, :3] = np.asarray(extrinsics.rotation).reshape(3, 3).T  # column-major in the driver
    matrix[:3, 3] = extrinsics.translation
    return camera_pose(matrix)


def _by_sensor(streams: dict[str, _Stream]) -> list[tuple[Any, list[Any]]]:
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
