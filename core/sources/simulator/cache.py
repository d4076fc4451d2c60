"""Clean states on disk, so that a scene is solved once.

A cache file is a zip of PNG images under a name that contains a hash of everything the images
depend on, this package's code included. A file that is damaged, foreign or unreadable counts as
missing; one that cannot be written is reported and otherwise ignored.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from platformdirs import user_cache_dir

from ...atomic import atomic_path
from .scene import CleanState

_NAMES = tuple(field.name for field in fields(CleanState))


def cache_file(scene: str, key: str) -> Path:
    """Return where the states of a scene are kept; ``key`` is text that tells all its parameters."""
    digest = hashlib.sha256(key.encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return Path(user_cache_dir("tactune")) / "simulator" / f"{scene}-{digest.hexdigest()[:16]}.zip"


def load_states(path: Path, count: int) -> list[CleanState] | None:
    """Return ``count`` states from a file, or None where there is no such file or it is damaged."""
    try:
        with zipfile.ZipFile(path) as archive:
            packed = [{name: archive.read(f"{n}/{name}.png") for name in _NAMES} for n in range(count)]
    except (OSError, KeyError, ValueError, zipfile.BadZipFile):
        return None
    with ThreadPoolExecutor(2) as pool:
        states = list(pool.map(_unpack, packed))
    return [state for state in states if state is not None] if None not in states else None


def save_states(path: Path, states: Sequence[CleanState]) -> None:
    """Write states to a file, whole or not at all, and remove the scene's older files.

    Raises
    ------
    ExportError
        The operating system refuses.
    """
    with ThreadPoolExecutor(2) as pool:
        packed = list(pool.map(_pack, states))
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for n, images in enumerate(packed):
            for name, data in images.items():
                archive.writestr(f"{n}/{name}.png", data)
    scene = path.name.rpartition("-")[0]
    for older in path.parent.glob(f"{scene}-*.zip"):
        if older != path:
            older.unlink(missing_ok=True)


def _pack(state: CleanState) -> dict[str, bytes]:
    fast = [cv2.IMWRITE_PNG_COMPRESSION, 1]
    return {name: cv2.imencode(".png", image, fast)[1].tobytes() for name, image in state.arrays().items()}


def _unpack(packed: dict[str, bytes]) -> CleanState | None:
    images: dict[str, npt.NDArray[Any]] = {}
    for name, data in packed.items():
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        if image is None:
            return None
        images[name] = image
    return CleanState(**images)
