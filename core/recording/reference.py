"""The frame of the untouched membrane, kept inside a recording as a NumPy archive."""

from __future__ import annotations

import io
import zipfile
import zlib

import numpy as np

from ..errors import FrameError, SourceError
from ..frames import GroundTruth, SensorFrame

_ARRAYS = ("proximity_depth", "tactile_depth", "proximity_color", "tactile_color")
_DAMAGE = (OSError, ValueError, KeyError, TypeError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error)
_NUMBERS = ("sequence", "proximity_time_s", "tactile_time_s")


def reference_bytes(frame: SensorFrame) -> bytes:
    """Return a frame as the bytes of an ``.npz``."""
    arrays = {name: getattr(frame, name) for name in (*_ARRAYS, *_NUMBERS)}
    if frame.truth is not None:
        arrays |= {"truth_contact": frame.truth.contact, "truth_depth_m": frame.truth.depth_m}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **{name: it for name, it in arrays.items() if it is not None})
    return buffer.getvalue()


def parse_reference(data: bytes, origin: str) -> SensorFrame:
    """Return the frame; `SourceError` where the bytes are none."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = dict(archive)
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
    except (*_DAMAGE, FrameError) as error:
        detail = " ".join(str(error).split())
        raise SourceError(f"{origin}: its reference frame is damaged ({detail}); copy or record it again") from error
