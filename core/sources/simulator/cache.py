"""Clean states on disk, so that a scene is solved once.

A cache file is a zip of PNG images under a name that contains a hash of everything the images
depend on, this package's code included. A file that is damaged, foreign or unreadable counts as
missing; one that cannot be written is reported and otherwise ignored.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from platformdirs import user_cache_dir

from ...model.arrays import AnyArray
from ...model.files import atomic_path
from .scene import CleanState, PressFacts

#: Versions of a scene that are kept, and the size of everything that is kept, bytes.
_VERSIONS: Final = 3
_ALL_BYTES: Final = 2_000_000_000

_NAMES = tuple(field.name for field in fields(CleanState))


def cache_file(scene: str, key: str) -> Path:
    """Return where the states of a scene are kept; ``key`` is text that tells all its parameters."""
    digest = hashlib.sha256(key.encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return Path(user_cache_dir("tactune")) / "simulator" / f"{scene}-{digest.hexdigest()[:16]}.zip"


@dataclass(frozen=True)
class SolvedScene:
    """The clean states of a scene, in the order of the schedule's depths, and what is true of them."""

    states: Sequence[CleanState]
    facts: Sequence[PressFacts]


def load_scene(path: Path, count: int) -> SolvedScene | None:
    """Return ``count`` states from a file, or None where there is no such file or it is damaged."""
    try:
        with zipfile.ZipFile(path) as archive:
            facts = [PressFacts(**entry) for entry in json.loads(archive.read("facts.json"))]
            packed = [{name: archive.read(f"{n}/{name}.png") for name in _NAMES} for n in range(count)]
    except (OSError, KeyError, TypeError, ValueError, zipfile.BadZipFile):
        return None
    with suppress(OSError):
        path.touch()
    with ThreadPoolExecutor(2) as pool:
        unpacked = list(pool.map(_unpack, packed))
    states = [state for state in unpacked if state is not None]
    return SolvedScene(states, facts) if len(states) == len(facts) == count else None


def save_scene(path: Path, scene: SolvedScene) -> None:
    """Write a scene to a file, whole or not at all, and remove files that were not used for long.

    Raises
    ------
    ExportError
        The operating system refuses.
    """
    with ThreadPoolExecutor(2) as pool:
        packed = list(pool.map(_pack, scene.states))
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        archive.writestr("facts.json", json.dumps([asdict(entry) for entry in scene.facts]))
        for n, images in enumerate(packed):
            for name, data in images.items():
                archive.writestr(f"{n}/{name}.png", data)
    _clean_up(path)


def _clean_up(path: Path) -> None:
    """Keep the versions of this scene that were used last, and of all scenes what fits."""
    last_used = sorted(path.parent.glob("*.zip"), key=_last_used, reverse=True)
    versions = [file for file in last_used if file.name.rpartition("-")[0] == path.name.rpartition("-")[0]]
    total, spare = 0, set(versions[_VERSIONS:])
    for file in last_used:
        with suppress(OSError):
            total += 0 if file in spare else file.stat().st_size
        if total > _ALL_BYTES:
            spare.add(file)
    for file in spare - {path}:
        with suppress(OSError):  # somebody else's, or gone already
            file.unlink()


def _last_used(file: Path) -> float:
    try:
        return file.stat().st_mtime
    except OSError:
        return 0.0


def _pack(state: CleanState) -> dict[str, bytes]:
    fast = [cv2.IMWRITE_PNG_COMPRESSION, 1]
    return {name: cv2.imencode(".png", image, fast)[1].tobytes() for name, image in state.arrays().items()}


def _unpack(packed: dict[str, bytes]) -> CleanState | None:
    images: dict[str, AnyArray] = {}
    for name, data in packed.items():
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        if image is None:
            return None
        images[name] = image
    return CleanState(**images)
