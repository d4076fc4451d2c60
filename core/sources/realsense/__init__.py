"""Intel RealSense cameras through librealsense: an L515 and a D405."""

from __future__ import annotations

from functools import partial

from ..cameras import open_in_process
from ..registry import SourceKind

KIND = SourceKind(
    scheme="realsense",
    title="RealSense cameras",
    form="realsense:[PROXIMITY,TACTILE]",
    description="A live L515 and a D405, captured in a separate process; serial numbers select the devices.",
    open=partial(open_in_process, driver="realsense"),
    rank=5,
)
