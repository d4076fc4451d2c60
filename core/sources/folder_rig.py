"""Folders of images that lack ``rig.json``: what is in them, and writing the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import ExportError, SourceError
from ..model.files import atomic_path
from ..model.frames import Rig
from ..model.loading import decode_image, image_size, read_file
from ..model.rig_file import json_text, rig_to_json
from .folder import IMAGES, numbered_folders

RIG_FILE = "rig.json"
#: Frames of a long folder whose images are looked at.
_LOOKED_AT = 20


@dataclass(frozen=True)
class FolderImages:
    """What a folder holds.

    Attributes
    ----------
    sizes : dict of str to (int, int)
        Width and height of each image of the first frame, by file name.
    problem : str
        Why no rig makes these images a source; empty if one does.
    different : str
        How a later frame differs from the first, so that it cannot be read; empty if none of those looked at does.
    """

    sizes: Mapping[str, tuple[int, int]]
    problem: str
    different: str = ""

    @property
    def has_own_color_lens(self) -> bool:
        """Whether the proximity colour image is another camera's than the depth image, by its size."""
        size = self.sizes.get("proximity_color.png")
        return size is not None and size != self.sizes.get("proximity_depth.png")


def find_images(path: Path) -> FolderImages:
    """Look at the images of a folder's first frame, and at the sizes of those of `_LOOKED_AT` frames all over it."""
    try:
        first = _first_frame(path)
        if first is None:
            raise SourceError(f"{path} has no images of frames; they are called {', '.join(IMAGES)}")
        numbered = [] if first == path else numbered_folders(path)
        sizes, problems = {}, []
        for name, (needed, bits, channels) in IMAGES.items():
            file = first / name
            if not file.is_file():
                problems += [f"{name} is missing"] * needed
                continue
            try:
                image = decode_image(read_file(file))
            except ValueError:
                image = np.empty(0, np.bool_)
            if (image.dtype.itemsize * 8, image.shape[2] if image.ndim == 3 else 1) != (bits, channels):
                problems.append(f"{name} is no PNG image of {channels} x {bits} bits")
                continue
            sizes[name] = (image.shape[1], image.shape[0])
        different = _first_difference(numbered, sizes)
    except OSError as error:
        raise SourceError(
            f"cannot read the images in {path}: {error.strerror or error}; check its name and permissions"
        ) from error
    if sizes.get("tactile_color.png", sizes.get("tactile_depth.png")) != sizes.get("tactile_depth.png"):
        problems.append("tactile_color.png has another size than tactile_depth.png; align it to the depth image")
    problem = f"{first}: {'; '.join(problems)}" if problems else ""
    return FolderImages(sizes, problem, different)


def _first_difference(frames: list[Path], sizes: Mapping[str, tuple[int, int]]) -> str:
    """Say where the first frame stands whose images are not those of the first one; empty if there is none."""
    for frame in frames[:: max(len(frames) // _LOOKED_AT, 1)] + frames[-1:]:
        for name, wanted in sizes.items():
            file = frame / name
            try:
                size = image_size(read_file(file)) if file.is_file() else None
            except ValueError as error:
                return f"{file}: {error}"
            if size is None:
                return f"{file} is missing"
            if size != wanted:
                return f"{file} has {size[0]} x {size[1]} pixels, in the first frame {wanted[0]} x {wanted[1]}"
    return ""


def write_rig(path: Path, rig: Rig) -> None:
    """Write ``rig.json`` into a folder, whole or not at all; one that is there is never replaced."""
    file = path / RIG_FILE
    if file.exists():
        raise ExportError(f"{file} is already there; remove it first")
    with atomic_path(file) as temporary:
        temporary.write_text(json_text(rig_to_json(rig)), encoding="utf-8")


def _first_frame(path: Path) -> Path | None:
    folders = [path, *numbered_folders(path)[:1]]
    return next((folder for folder in folders if any((folder / name).is_file() for name in IMAGES)), None)
