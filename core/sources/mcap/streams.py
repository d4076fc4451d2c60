"""The images of a frame as topics, and which of them a rig has a lens for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import FrameError
from ...model.arrays import AnyArray
from ...model.frames import Rig, SensorFrame
from ...model.intrinsics import Intrinsics
from .messages import PROXIMITY_COLOR_FRAME, PROXIMITY_FRAME, TACTILE_FRAME, Topic, camera_info, image_head

_DTYPES: dict[str, np.dtype[Any]] = {
    "16UC1": np.dtype("<u2"),
    "rgb8": np.dtype("u1"),
    "mono8": np.dtype("u1"),
    "32FC1": np.dtype("<f4"),
}
_CHANNELS = {"rgb8": 3}


@dataclass(frozen=True)
class ImageStream:
    """One image topic; what is the same in all its messages is serialised once.

    Attributes
    ----------
    head : bytes
        An image message up to its pixels, of no time.
    lens : bytes or None
        The camera info that goes with each image.
    """

    topic: Topic
    of_tactile: bool
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    channels: int
    head: bytes
    lens: bytes | None

    def check(self, image: AnyArray, sequence: int) -> None:
        """Raise `FrameError` where an image has another size or type than the stream."""
        shape = self.shape if self.channels == 1 else (*self.shape, self.channels)
        if image.shape != shape or image.dtype != self.dtype:
            raise FrameError(
                f"frame {sequence}: the image for {self.topic} is {image.dtype}, {image.shape}, "
                f"but the rig needs {self.dtype}, {shape}; use the rig of the camera that took it"
            )


def image_streams(rig: Rig) -> dict[Topic, ImageStream]:
    """Return the streams of a rig's frames."""
    proximity, tactile = rig.proximity.intrinsics, rig.tactile.intrinsics
    color, color_frame = proximity, PROXIMITY_FRAME
    if rig.proximity_color is not None:
        color, color_frame = rig.proximity_color.intrinsics, PROXIMITY_COLOR_FRAME
    streams = (
        _stream(Topic.PROXIMITY_DEPTH, PROXIMITY_FRAME, "16UC1", proximity),
        _stream(Topic.PROXIMITY_COLOR, color_frame, "rgb8", color),
        _stream(Topic.TACTILE_DEPTH, TACTILE_FRAME, "16UC1", tactile, of_tactile=True),
        _stream(Topic.TACTILE_COLOR, TACTILE_FRAME, "rgb8", tactile, of_tactile=True),
        _stream(Topic.TRUTH_CONTACT, PROXIMITY_FRAME, "mono8", proximity, with_lens=False),
        _stream(Topic.TRUTH_DEPTH, PROXIMITY_FRAME, "32FC1", proximity, with_lens=False),
    )
    return {stream.topic: stream for stream in streams}


def images_of(frame: SensorFrame) -> Iterator[tuple[Topic, AnyArray]]:
    """Yield the images that a frame has."""
    yield Topic.PROXIMITY_DEPTH, frame.proximity_depth
    yield Topic.PROXIMITY_COLOR, frame.proximity_color
    yield Topic.TACTILE_DEPTH, frame.tactile_depth
    if frame.tactile_color is not None:
        yield Topic.TACTILE_COLOR, frame.tactile_color
    if frame.truth is not None:
        yield Topic.TRUTH_CONTACT, np.where(frame.truth.contact, np.uint8(255), np.uint8(0))
        if frame.truth.depth_m is not None:
            yield Topic.TRUTH_DEPTH, frame.truth.depth_m


def _stream(
    topic: Topic, frame_id: str, encoding: str, lens: Intrinsics, *, of_tactile: bool = False, with_lens: bool = True
) -> ImageStream:
    dtype, channels = _DTYPES[encoding], _CHANNELS.get(encoding, 1)
    return ImageStream(
        topic=topic,
        of_tactile=of_tactile,
        shape=lens.shape,
        dtype=dtype,
        channels=channels,
        head=image_head(frame_id, encoding, lens.shape, dtype.itemsize * channels),
        lens=camera_info(frame_id, lens) if with_lens else None,
    )
