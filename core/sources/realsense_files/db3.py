"""RealSense recordings in ``.db3`` files, as librealsense writes them from 2.58 on.

Such a file is the SQLite database of a ROS 2 bag. Its descriptions are strings of ``key=value;``.
2.58 compresses every message with zstd and keeps images raw; 2.59 keeps images as PNG.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from ...model.arrays import Float64Array
from ..mcap.messages import IMAGE, TEXT, TYPES
from ..ros.bags import SqliteBag
from ..ros_image import DamagedFileError, RawImage
from .recording import RecordingFile, Times


class Db3File(RecordingFile):
    """An open ``.db3``, read without the camera driver."""

    _bag: SqliteBag | None = None

    @property
    def _messages(self) -> SqliteBag:
        assert self._bag is not None
        return self._bag

    def _open(self) -> Collection[str]:
        self._bag = SqliteBag(self.path)
        return self._bag.types

    def close(self) -> None:
        if self._bag is not None:
            self._bag.close()

    def _names(self, topic: str) -> dict[str, str]:
        """Return the merged key-value pairs of all messages of a string topic."""
        facts: dict[str, str] = {}
        for index in range(self._messages.count(topic)):
            facts |= self._pairs(topic, index)
        return facts

    def _depth_unit_m(self, sensor: str) -> float | None:
        unit = self._names(f"{sensor}/option/Depth_Units/value")
        return _numbers({"unit": next(iter(unit))}, "unit")[0] if unit else None

    def _lens(self, topic: str) -> tuple[dict[str, Any], float]:
        info, lens = self._names(f"{topic}/info"), self._names(f"{topic}/camera_info")
        keys = {"width": "width", "height": "height", "fx": "fx", "fy": "fy", "cx": "ppx", "cy": "ppy"}
        values: dict[str, Any] = {key: _numbers(lens, theirs)[0] for key, theirs in keys.items()}
        values |= {"distortion": lens.get("model", ""), "coefficients": _numbers(lens, "coeffs")}
        return values, _numbers(info, "fps")[0]

    def _pose(self, topic: str) -> Float64Array:
        """Its rotation is written column by column."""
        facts, matrix = self._names(topic), np.eye(4)
        matrix[:3, :3] = np.reshape(_numbers(facts, "rotation"), (3, 3)).T
        matrix[:3, 3] = _numbers(facts, "translation")
        return matrix

    def _times(self, topics: Collection[tuple[str, str]]) -> Mapping[str, Times]:
        times: dict[str, Times] = {}
        for done, (topic, images) in enumerate(topics, start=1):
            about = f"{topic}/image/metadata"
            written_ns, recorded_ns = self._messages.times_ns(about), self._messages.times_ns(images)
            facts = {int(time_ns): self._pairs(about, index) for index, time_ns in enumerate(written_ns)}
            stamps_s = [float(facts.get(int(time), {}).get("timestamp", "nan")) * 1e-3 for time in recorded_ns]
            if not np.isfinite(stamps_s).all():
                raise DamagedFileError(f"an image of {topic} has no time stamp")
            clock = facts[int(recorded_ns[-1])].get("timestamp_domain", "")
            times[topic] = Times(recorded_ns.tolist(), stamps_s, clock)
            if self.progress is not None:
                self.progress(done / len(topics), f"indexing {self.path.name}: stream {done} of {len(topics)}")
        return times

    def _image(self, topic: str, index: int) -> RawImage:
        data = self._messages.raw(topic, index)
        if topic.endswith("/image/data"):
            return RawImage.of(TYPES.deserialize_cdr(data, IMAGE))
        found: Any = TYPES.deserialize_cdr(data, "sensor_msgs/msg/CompressedImage")
        found.format = "16UC1; compressedDepth png" if topic.endswith("Depth") else "png"
        return RawImage.of(found)

    def _pairs(self, topic: str, index: int) -> dict[str, str]:
        """Return the ``key=value;key=value`` of a message; a part without a value is a key with an empty value."""
        message: Any = TYPES.deserialize_cdr(self._messages.raw(topic, index), TEXT)
        return {key: value for key, _, value in (part.partition("=") for part in message.data.split(";")) if key}


def _numbers(facts: Mapping[str, str], key: str) -> tuple[float, ...]:
    """Return the comma-separated numbers of a field, at the precision of the cameras."""
    text = facts.get(key, "")
    try:
        return tuple(float(np.float32(float(part))) for part in text.split(","))
    except ValueError as error:
        raise DamagedFileError(f"{key} is {text[:40]!r}, which is no number") from error
