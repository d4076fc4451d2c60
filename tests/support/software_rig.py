"""Two librealsense software devices, like an L515 and a D405, with images at 30 Hz and faults on command.

`open_software_rig` opens them through the class that opens hardware. A separate process can call it, because it is
picklable and this module is importable by its top-level name.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from tactune.core.preset import CamerasSection
from tactune.core.sources.base import CameraRole
from tactune.core.sources.cameras.camera_source import CameraSource
from tactune.core.sources.cameras.realsense import RealSenseDriver, load_driver

WIDTH, HEIGHT, RATE_HZ = 640, 480, 30.0
PROXIMITY_SERIAL, TACTILE_SERIAL = "f0090001", "130322270002"
PROXIMITY_UNIT_M, TACTILE_UNIT_M = 0.00025, 0.0001
COLOR_ROTATION = (0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
COLOR_TRANSLATION_M = (0.015, -0.004, 0.002)
ANY_CAMERAS = CamerasSection()

Action = Literal["stop", "go", "stutter", "streams", "remove", "add"]


@dataclass(frozen=True)
class Command:
    """What a camera is to do next.

    ``stop`` and ``go``; ``stutter``: nothing for ``value`` seconds, then all at once; ``streams``: only those
    of ``text``, such as ``"depth"`` or ``"depth color"``; ``remove`` and ``add``.
    """

    action: Action
    camera: CameraRole = "tactile"
    value: float = 0.0
    text: str = ""


def depth_image(role: CameraRole, number: int) -> npt.NDArray[np.uint16]:
    """Image ``number``, all of whose pixels differ from those of its neighbours; `image_number` inverts it."""
    return _BASE_DEPTH[role] + np.uint16(number * 131 % 65536)


def color_image(role: CameraRole, number: int) -> npt.NDArray[np.uint8]:
    return _BASE_COLOR[role] + np.uint8(number * 17 % 256)


def image_number(role: CameraRole, depth: npt.NDArray[np.uint16]) -> int:
    return (int(depth[0, 0]) - int(_BASE_DEPTH[role][0, 0])) * pow(131, -1, 65536) % 65536


def _bases() -> tuple[dict[CameraRole, npt.NDArray[np.uint16]], dict[CameraRole, npt.NDArray[np.uint8]]]:
    random = np.random.default_rng(4)
    roles: tuple[CameraRole, ...] = ("proximity", "tactile")
    depths = {role: random.integers(0, 65536, (HEIGHT, WIDTH), np.uint16) for role in roles}
    return depths, {role: random.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8) for role in roles}


_BASE_DEPTH, _BASE_COLOR = _bases()


class SoftwareCamera:
    """One software device: its sensors, options and what it sends."""

    def __init__(self, role: CameraRole, unit_m: float | None = None) -> None:
        rs = load_driver()
        self._rs = rs
        self.role: CameraRole = role
        is_l515 = role == "proximity"
        self.streams: tuple[str, ...] = ("depth", "color")
        self.running = True
        self.held: deque[Callable[[], None]] = deque()
        self.hold_until_s = 0.0
        self._in_use: deque[Any] = deque(maxlen=64)
        self.device = rs.software_device()
        product = "L500" if is_l515 else "D400"
        # 2.54 comes with a name, to which register_info would append; later ones have none to update.
        has_name = self.device.supports(rs.camera_info.name)
        name = self.device.update_info if has_name else self.device.register_info
        name(rs.camera_info.name, f"Intel RealSense {'L515' if is_l515 else 'D405'}")
        for info, text in {
            rs.camera_info.serial_number: PROXIMITY_SERIAL if is_l515 else TACTILE_SERIAL,
            rs.camera_info.firmware_version: "01.05.08.01" if is_l515 else "05.12.14.100",
            rs.camera_info.usb_type_descriptor: "3.2",
            rs.camera_info.product_line: product,
        }.items():
            self.device.register_info(info, text)
        depth_sensor = self.device.add_sensor("L500 Depth Sensor" if is_l515 else "Stereo Module")
        color_sensor = self.device.add_sensor("RGB Camera") if is_l515 else depth_sensor
        self._sensors = {"depth": depth_sensor, "color": color_sensor}
        if unit_m is None:
            unit_m = PROXIMITY_UNIT_M if is_l515 else TACTILE_UNIT_M
        depth_sensor.add_read_only_option(rs.option.depth_units, unit_m)
        if not is_l515:
            depth_sensor.add_read_only_option(rs.option.stereo_baseline, 18.0)
        for option, limits in _options(rs, is_l515).items():
            depth_sensor.add_option(option, _extent(rs, *limits), True)
        for sensor in dict.fromkeys((depth_sensor, color_sensor)):
            sensor.add_option(rs.option.global_time_enabled, _extent(rs, 0, 1, 1, 0 if is_l515 else 1), True)
        self._profiles = {
            "depth": depth_sensor.add_video_stream(self._stream("depth", WIDTH, HEIGHT), True),
            "color": color_sensor.add_video_stream(self._stream("color", WIDTH, HEIGHT), True),
        }
        depth_sensor.add_video_stream(self._stream("depth", WIDTH // 2, HEIGHT // 2), False)
        pose = rs.extrinsics()
        if is_l515:
            pose.rotation, pose.translation = list(COLOR_ROTATION), list(COLOR_TRANSLATION_M)
        else:
            pose.rotation, pose.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [0, 0, 0]
        self._profiles["depth"].register_extrinsics_to(self._profiles["color"], pose)
        self.context = rs.context()
        alive: list[Any] = []  # from 2.55 on the context does not keep the device, what the callback gets does
        self.context.set_devices_changed_callback(lambda changes: alive.append(changes.get_new_devices()))
        self._alive = alive
        self.device.add_to(self.context)

    def send(self, number: int, time_s: float) -> None:
        """Send image ``number`` of each stream, or whatever the camera has been told to do instead."""
        if not self.running:
            return
        if time.time() < self.hold_until_s:
            self.held.append(lambda: self._send(number, time_s))
            return
        while self.held:
            self.held.popleft()()
        self._send(number, time_s)

    @property
    def global_time(self) -> list[bool]:
        """Whether depth and colour stamps are asked to count on the computer's clock."""
        option = self._rs.option.global_time_enabled
        return [self._sensors[stream].get_option(option) == 1.0 for stream in ("depth", "color")]

    def _send(self, number: int, time_s: float) -> None:
        for stream in self.streams:
            profile = self._profiles[stream]
            image: Any = depth_image(self.role, number) if stream == "depth" else color_image(self.role, number)
            rs = self._rs
            frame = rs.software_video_frame()
            frame.pixels = image
            frame.bpp = 2 if stream == "depth" else 3
            frame.stride = frame.bpp * image.shape[1]
            frame.timestamp = 1e3 * time_s
            frame.domain = rs.timestamp_domain.global_time
            frame.frame_number = number
            frame.profile = profile.as_video_stream_profile()
            self._in_use.append((frame, image))
            self._sensors[stream].on_video_frame(frame)

    def _stream(self, kind: str, width: int, height: int) -> Any:
        rs = self._rs
        stream = rs.video_stream()
        stream.type = rs.stream.depth if kind == "depth" else rs.stream.color
        stream.fmt = rs.format.z16 if kind == "depth" else rs.format.rgb8
        stream.uid = {("depth", WIDTH): 0, ("color", WIDTH): 1}.get((kind, width), 2)
        stream.index, stream.width, stream.height = 0, width, height
        stream.fps, stream.bpp = int(RATE_HZ), 2 if kind == "depth" else 3
        stream.intrinsics = self._lens(kind, width, height)
        return stream

    def _lens(self, kind: str, width: int, height: int) -> Any:
        rs = self._rs
        lens = rs.intrinsics()
        lens.width, lens.height = width, height
        lens.ppx, lens.ppy = width / 2 + 1.25, height / 2 - 2.5
        if self.role == "proximity" and kind == "color":
            lens.fx, lens.fy = 603.5, 604.25
            lens.model, lens.coeffs = rs.distortion.inverse_brown_conrady, [0.125, -0.25, 0.001, -0.0005, 0.0625]
        else:
            lens.fx, lens.fy = (461.0, 462.5) if self.role == "proximity" else (433.75, 433.5)
            lens.model, lens.coeffs = rs.distortion.none, [0.0] * 5
        return lens


def _extent(rs: Any, low: float, high: float, step: float, default: float) -> Any:
    extent = rs.option_range()
    extent.min, extent.max, extent.step, extent.default = low, high, step, default
    return extent


def _options(rs: Any, is_l515: bool) -> dict[Any, tuple[float, float, float, float]]:
    option = rs.option
    if is_l515:
        return {
            option.visual_preset: (0, 5, 1, 3),
            option.laser_power: (0, 100, 1, 100),
            option.min_distance: (0, 1600, 1, 190),
        }
    return {
        option.visual_preset: (0, 5, 1, 0),
        option.exposure: (1, 165_000, 1, 33_000),
        option.gain: (16, 248, 1, 16),
        option.enable_auto_exposure: (0, 1, 1, 1),
    }


class SoftwareRig:
    """Both cameras, plugged in or not, and the thread that feeds them."""

    def __init__(self) -> None:
        self.cameras: dict[CameraRole, SoftwareCamera] = {
            "proximity": SoftwareCamera("proximity"),
            "tactile": SoftwareCamera("tactile"),
        }
        self._removed: list[SoftwareCamera] = []  # frames of theirs may be in flight
        self._quit = threading.Event()
        self._thread: threading.Thread | None = None

    def devices(self) -> list[Any]:
        """Return the connected devices, as `RealSenseDriver` asks for them."""
        return [device for camera in list(self.cameras.values()) for device in camera.context.query_devices()]

    def start(self, commands: queue.Queue[Command] | None = None, count: int | None = None) -> None:
        """Send ``count`` images of each stream, or images for ever, and obey commands meanwhile."""
        self._thread = threading.Thread(target=self._feed, args=(commands, count), name="software cameras", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._quit.set()
        if self._thread is not None:
            self._thread.join(60.0)

    def obey(self, command: Command) -> None:
        role = command.camera
        if command.action == "add":
            self.cameras[role] = SoftwareCamera(role)
            return
        camera = self.cameras[role]
        if command.action == "remove":
            self._removed.append(self.cameras.pop(role))
        elif command.action == "stutter":
            camera.hold_until_s = time.time() + command.value
        elif command.action == "streams":
            camera.streams = tuple(command.text.split())
        else:
            camera.running = command.action == "go"

    def _feed(self, commands: queue.Queue[Command] | None, count: int | None) -> None:
        start_s = time.time()
        number = 0
        while count is None or number < count:
            due_s = start_s + number / RATE_HZ
            # after a pause of a busy computer no burst, which would be more than a driver's queue holds
            if self._quit.wait(max(due_s - time.time(), 0.01)):
                return
            while commands is not None and not commands.empty():  # this thread alone takes them
                self.obey(commands.get())
            for camera in list(self.cameras.values()):
                camera.send(number, due_s)
            number += 1


class SoftwareSource(CameraSource):
    """The live source over software cameras, which end with it."""

    def __init__(self, cameras: CamerasSection, rig: SoftwareRig) -> None:
        self.software_rig = rig
        super().__init__([RealSenseDriver(rig.devices)], cameras)

    def close(self) -> None:
        self.software_rig.close()
        super().close()


def open_software_rig(
    commands: queue.Queue[Command] | None = None, cameras: CamerasSection = ANY_CAMERAS, count: int | None = None
) -> CameraSource:
    """Open the pair through the class that opens hardware; ``functools.partial`` of this is picklable.

    Parameters
    ----------
    commands : queue of `Command`, optional
    cameras : section of a preset, optional
    count : int, optional
        Number of images that each stream sends, from number 0, after the source is open. Without: for ever.
    """
    rig = SoftwareRig()
    source = SoftwareSource(cameras, rig)
    rig.start(commands, count)
    return source
