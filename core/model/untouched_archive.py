"""The frame of the untouched membrane as a NumPy archive: in a recording, or beside a preset."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from ..errors import FrameError, SourceError
from .frames import GroundTruth, SensorFrame
from .loading import parse_npz

_ARRAYS = ("proximity_depth", "tactile_depth", "proximity_color", "tactile_color")
_NUMBERS = ("sequence", "proximity_time_s", "tactile_time_s")


def frame_arrays(frame: SensorFrame) -> dict[str, Any]:
    """Return what an ``.npz`` of a frame holds, by name; `frame_from_bytes` reads it and ignores other names."""
    arrays = {name: getattr(frame, name) for name in (*_ARRAYS, *_NUMBERS)}
    if frame.truth is not None:
        arrays |= {"truth_contact": frame.truth.contact, "truth_depth_m": frame.truth.depth_m}
    return {name: it for name, it in arrays.items() if it is not None}


def untouched_bytes(frame: SensorFrame) -> bytes:
    """Return a frame as the bytes of an ``.npz``."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **frame_arrays(frame))
    return buffer.getvalue()


def frame_from_bytes(data: bytes) -> SensorFrame:
    """Return the frame in the bytes of an ``.npz``; raise `FrameError` if they are damaged."""
    try:
        arrays = parse_npz(data)
        truth = None
        if "truth_contact" in arrays:
            truth = GroundTruth(arrays["truth_contact"], arrays.get("truth_depth_m"))
        return SensorFrame(
            sequence=int(arrays["sequence"]),
            proximity_depth=arrays["proximity_depth"],
            tactile_depth=arrays["tactile_depth"],
            proximity_color=arrays["proximity_color"],
            tactile_color=arrays.get("tactile_color"),
            proximity_time_s=float(arrays["proximity_time_s"]),
            tactile_time_s=float(arrays["tactile_time_s"]),
            truth=truth,
        )
    except KeyError as error:
        raise FrameError(f"it has no array {error.args[0]}") from error
    except (ValueError, TypeError, OverflowError) as error:
        raise FrameError(str(error)) from error


def parse_untouched(data: bytes, origin: str) -> SensorFrame:
    """Return the frame; `SourceError` where the bytes are none."""
    try:
        return frame_from_bytes(data)
    except FrameError as error:
        raise SourceError(f"{origin}: its untouched frame is damaged ({error}); copy or record it again") from error
