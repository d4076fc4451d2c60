"""Solved scenes on disk: in the cache of the user, and the default scene in the package.

A file is a zip. Images of one channel are kept as differences between successive states, byte by byte; colour images as
PNG, or WebP in the package, which is smaller and slower to write. The file's name contains a hash of everything that
the images depend on, their code included. The errors of the cameras are added later, so their code is not. A damaged or
unreadable file counts as missing.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from platformdirs import user_cache_dir
from pydantic import TypeAdapter

from ...model.arrays import Uint8Array
from ...model.files import atomic_path
from ...model.loading import open_regular
from .scene import CleanState, PressFacts

#: Files of this folder on which the clean images depend beyond `Scene.key`.
CLEAN_CODE: Final = ("grid_strain.py", "membrane.py", "mesh.py", "objects.py", "render.py", "scene.py", "sheet.py")
#: Folder of the solved scenes in the package; ``scripts/ship_scene.py`` writes them.
SHIPPED: Final = Path(__file__).with_name("solved")
#: Cached versions of a scene, and size of the whole cache, bytes.
_VERSIONS: Final = 3
MAX_CACHE_BYTES: Final = 4_000_000_000

_COLOURS: Final = ("proximity_color", "tactile_color")
_COUNTS: Final = tuple(field.name for field in fields(CleanState) if field.name not in _COLOURS)
_FACTS = TypeAdapter(list[PressFacts])
#: What a damaged file raises; `OSError` also where there is none.
_DAMAGED: Final = (OSError, EOFError, KeyError, ValueError, RuntimeError, zipfile.BadZipFile, zlib.error, cv2.error)


@dataclass(frozen=True)
class SolvedScene:
    """The clean states of a scene in the order of ``Scene.drawn``, and their ground truth."""

    states: Sequence[CleanState]
    facts: Sequence[PressFacts]


def cache_file(scene: str, key: str) -> Path:
    """Return the cache file of a scene; ``key`` is text with all its parameters."""
    digest = hashlib.sha256(key.encode())
    for name in CLEAN_CODE:
        digest.update(Path(__file__).with_name(name).read_bytes())
    return Path(user_cache_dir("tactune")) / "simulator" / f"{scene}-{digest.hexdigest()[:16]}.zip"


def find_solved(path: Path, count: int) -> SolvedScene | None:
    """Return the ``count`` states of a cache file from the package or from the cache; None if neither has them."""
    return load_scene(SHIPPED / path.name, count) or load_scene(path, count)


def load_scene(path: Path, count: int) -> SolvedScene | None:
    """Return ``count`` states from a file, or None where it is missing or damaged."""
    images: dict[str, Any] = {}
    try:
        with open_regular(path) as file, zipfile.ZipFile(file) as archive:
            facts = _FACTS.validate_json(archive.read("facts.json"))
            packed = {name: [archive.read(f"{n}/{name}") for n in range(count)] for name in _COLOURS}
            shape = count, *_decoded(packed["tactile_color"][0]).shape[:2]
            for name in _COUNTS:
                low_and_high = np.frombuffer(archive.read(f"{name}.changes"), np.uint8).reshape(-1, *shape)
                changes = np.ascontiguousarray(np.moveaxis(low_and_high, 0, -1)).view(f"<u{len(low_and_high)}")[..., 0]
                images[name] = np.cumsum(changes, axis=0, dtype=changes.dtype)
        with ThreadPoolExecutor(2) as pool:
            images |= {name: list(pool.map(_decoded, packed[name])) for name in _COLOURS}
    except _DAMAGED:
        return None
    with suppress(OSError):
        path.touch()
    states = [CleanState(**{name: images[name][n] for name in (*_COUNTS, *_COLOURS)}) for n in range(count)]
    return SolvedScene(states, facts) if len(facts) == count else None


def save_scene(path: Path, scene: SolvedScene, *, small: bool = False) -> None:
    """Write a scene to a file, whole or not at all, and remove the files that were used least recently."""
    how = (".webp", [cv2.IMWRITE_WEBP_QUALITY, 101]) if small else (".png", [cv2.IMWRITE_PNG_COMPRESSION, 1])
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", compresslevel=9 if small else 1) as archive:
        archive.writestr("facts.json", json.dumps([asdict(entry) for entry in scene.facts]))
        for name in _COUNTS:
            changes = np.stack([getattr(state, name) for state in scene.states])
            changes[1:] -= changes[:-1].copy()
            low_and_high = np.moveaxis(changes[..., None].view(np.uint8), -1, 0)
            archive.writestr(f"{name}.changes", low_and_high.tobytes(), zipfile.ZIP_DEFLATED)
        for n, state in enumerate(scene.states):
            for name in _COLOURS:
                archive.writestr(f"{n}/{name}", cv2.imencode(how[0], getattr(state, name), how[1])[1].tobytes())
    _clean_up(path)


def _decoded(packed: bytes) -> Uint8Array:
    image = cv2.imdecode(np.frombuffer(packed, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError("no image")
    return np.asarray(image, np.uint8)


def _clean_up(path: Path) -> None:
    """Keep the most recently used versions of this scene, and of all scenes as many as fit."""
    last_used = sorted(path.parent.glob("*.zip"), key=_last_used, reverse=True)
    versions = [file for file in last_used if file.name.rpartition("-")[0] == path.name.rpartition("-")[0]]
    total, spare = 0, set(versions[_VERSIONS:])
    for file in last_used:
        with suppress(OSError):
            total += 0 if file in spare else file.stat().st_size
        if total > MAX_CACHE_BYTES:
            spare.add(file)
    for file in spare - {path}:
        with suppress(OSError):  # another user's, or already removed
            file.unlink()


def _last_used(file: Path) -> float:
    try:
        return file.stat().st_mtime
    except OSError:
        return 0.0
