"""ROS 1 bags as librealsense writes them up to 2.57."""

from __future__ import annotations

import struct
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from ...model.arrays import Float64Array
from ..mcap.messages import matrix_of
from ..ros.bags import Ros1Bag
from ..ros_image import DamagedFileError, RawImage
from .recording import RecordingFile, Times


class BagFile(RecordingFile):
    """An open ``.bag``, read without the camera driver."""

    _bag: Ros1Bag | None = None

    @property
    def _messages(self) -> Ros1Bag:
        assert self._bag is not None
        return self._bag

    def _open(self) -> Collection[str]:
        self._bag = Ros1Bag(self.path)
        self.is_complete = self._bag.complete
        return self._bag.types

    def close(self) -> None:
        if self._bag is not None:
            self._bag.close()

    def _names(self, topic: str) -> Mapping[str, str]:
        bag = self._messages
        return dict(_key_value(bag.raw(topic, index)) for index in range(bag.count(topic)))

    def _depth_unit_m(self, sensor: str) -> float | None:
        options = [f"{sensor}/option/{words}/value" for words in ("Depth Units", "Depth_Units")]
        return next((float(self._first(option).data) for option in options if self._messages.count(option)), None)

    def _lens(self, topic: str) -> tuple[dict[str, Any], float]:
        if not self._messages.count(f"{topic}/info"):
            raise DamagedFileError(f"the topic {topic}/info is missing")
        (rate_hz,) = struct.unpack_from("<I", self._messages.raw(f"{topic}/info", 0))
        lens: Any = self._first(f"{topic}/info/camera_info")
        fx, _, cx, _, fy, cy, *_ = lens.K
        size = {"width": lens.width, "height": lens.height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
        return {**size, "distortion": lens.distortion_model, "coefficients": lens.D}, float(rate_hz)

    def _pose(self, topic: str) -> Float64Array:
        return matrix_of(self._first(topic))

    def _times(self, topics: Collection[tuple[str, str]]) -> Mapping[str, Times]:
        """Read the stamp of every image, in the order of the file, and the clock of the last one."""
        bag = self._messages
        stamps_s: dict[tuple[str, int], float] = {}
        wanted = bag.in_order_of_file([images for _, images in topics])
        for done, (images, index) in enumerate(wanted):
            stamps_s[images, index] = bag.stamp_ns(images, index) * 1e-9
            if self.progress is not None and done % 1000 == 0:
                self.progress(done / len(wanted), f"indexing {self.path.name}")
        times: dict[str, Times] = {}
        for topic, images in topics:
            about = f"{topic}/image/metadata"
            # Cameras write two dozen facts for every image.
            written_ns = bag.times_ns(about)
            last = np.flatnonzero(written_ns == written_ns[-1:])
            facts = dict(_key_value(bag.raw(about, int(index))) for index in last)
            stamps = [stamps_s[images, index] for index in range(bag.count(images))]
            times[topic] = Times(bag.times_ns(images).tolist(), stamps, facts.get("timestamp_domain", ""))
        return times

    def _image(self, topic: str, index: int) -> RawImage:
        """Some versions append a list of metadata, which the library does not accept."""
        message = self._messages.raw(topic, index)
        _, at = _text(message, 12)
        height, width = struct.unpack_from("<II", message, at)
        encoding, at = _text(message, at + 8)
        big_endian, step, size = struct.unpack_from("<BII", message, at)
        at += 9
        if size > len(message) - at:
            raise DamagedFileError(f"it has {len(message) - at} bytes, too few for its size")
        return RawImage(height, width, encoding, bool(big_endian), step, np.frombuffer(message, np.uint8, size, at))

    def _first(self, topic: str) -> Any:
        if not self._messages.count(topic):
            raise DamagedFileError(f"the topic {topic} is missing")
        return self._messages.message(topic, 0)


def _text(message: memoryview, at: int) -> tuple[str, int]:
    """Return a text in a message, and where it ends."""
    (length,) = struct.unpack_from("<I", message, at)
    end = at + 4 + length
    return bytes(message[at + 4 : end]).decode(errors="replace"), end


def _key_value(message: memoryview) -> tuple[str, str]:
    key, at = _text(message, 0)
    return key, _text(message, at)[0]
