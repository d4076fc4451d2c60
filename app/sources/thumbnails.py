"""Small pictures of the sources that were open, kept in the user's cache."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import platformdirs

from ...core.errors import TactuneError
from ...core.model.arrays import Uint8Array
from ...core.model.files import atomic_path
from ...core.model.loading import decode_image, read_file
from ...core.sources.base import Progress
from ...core.sources.registry import open_source

#: Width and height of a picture, pixels; a picture fits into it.
SIZE = (160, 90)
#: The pictures that were used least recently are removed above this number.
_MAX_PICTURES = 100
_MAX_BYTES = 1_000_000


def default_folder() -> Path:
    """Return the folder of the pictures in the user's cache."""
    return Path(platformdirs.user_cache_dir("tactune")) / "thumbnails"


class Thumbnails:
    """Pictures by the name of the source. What cannot be written is left out."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def path(self, name: str) -> Path:
        """Return the file of a source's picture; it may not exist."""
        key = hashlib.sha256(name.encode(errors="surrogatepass")).hexdigest()  # file names need not be valid Unicode
        return self._folder / f"{key[:24]}.png"

    def load(self, name: str) -> Uint8Array | None:
        """Return a source's picture, RGB, uint8, shape (H, W, 3); None without one, or where its file is damaged."""
        try:
            image = decode_image(read_file(self.path(name), _MAX_BYTES))  # Qt would wait for a pipe's writer
        except (OSError, ValueError):
            return None
        fits = image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3
        return np.ascontiguousarray(image[:, :, ::-1]) if fits else None

    def keep(self, name: str, image: Uint8Array) -> None:
        """Keep a picture of a source: RGB, uint8, shape (H, W, 3)."""
        height, width = image.shape[:2]
        scale = min(SIZE[0] / width, SIZE[1] / height)
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        with suppress(TactuneError, OSError), atomic_path(self.path(name)) as temporary:
            temporary.write_bytes(cv2.imencode(".png", small[:, :, ::-1])[1].tobytes())
        self._remove_old()

    def make(self, names: Sequence[str], progress: Progress) -> None:
        """Make pictures of the first frames of recordings; ``progress`` gets each name when it is done."""
        for done, name in enumerate(names, start=1):
            with suppress(Exception), open_source(name) as source:  # a recording without a picture is listed as well
                frame = source.next_frame()
                if frame is not None:
                    self.keep(name, frame.proximity_color)
            progress(done / len(names), name)

    def _remove_old(self) -> None:
        with suppress(OSError):
            newest = sorted(self._folder.glob("*.png"), key=lambda file: file.stat().st_mtime, reverse=True)
            for file in newest[_MAX_PICTURES:]:
                file.unlink()
