"""Examples as files: an ``.npz`` with the images of the frame, and the masks ``contact`` and ``known``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import AdviceError, FrameError
from ...model.arrays import BoolArray
from ...model.files import atomic_path
from ...model.loading import parse_npz, read_file
from ...model.untouched_archive import frame_arrays, frame_from_bytes
from .proposal import Example

_MASKS = ("contact", "known")


def save_example(example: Example, path: Path) -> None:
    """Write an example; a mask that is None is left out.

    Raises
    ------
    ExportError
        The file cannot be written.
    """
    masks = {name: mask for name in _MASKS if (mask := getattr(example, name)) is not None}
    with atomic_path(path) as temporary:
        np.savez(temporary, allow_pickle=False, **frame_arrays(example.frame), **masks)


def load_example(path: Path) -> Example:
    """Read an example.

    Raises
    ------
    AdviceError
        The file is missing or damaged, or a mask has another size than the frame.
    """
    try:
        data = read_file(path)
        frame = frame_from_bytes(data)
        stored = parse_npz(data)
        masks: dict[str, BoolArray] = {name: stored[name] for name in _MASKS if name in stored}
    except (OSError, ValueError, FrameError) as error:
        raise AdviceError(f"{path}: the example cannot be read ({error}); mark or paint it again") from error
    for name, mask in masks.items():
        if mask.dtype != np.bool_ or mask.shape != frame.proximity_depth.shape:
            raise AdviceError(
                f"{path}: {name} is {mask.dtype} {mask.shape}, not a bool mask of the frame's "
                f"{frame.proximity_depth.shape} pixels; paint the example again"
            )
    return Example(frame, masks.get("contact"), masks.get("known"))
