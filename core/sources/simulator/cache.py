"""Solved scenes on disk: in the cache of the user, and the default scene in the package.

A file holds the differences between successive states, compressed. Its name contains a hash of everything that the
images depend on, but not the errors of the cameras, which are added later.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np
from platformdirs import user_cache_dir
from pydantic import TypeAdapter

from ...model.files import atomic_path
from .scene import CleanState, PressFacts

#: To count up whenever a change of the code changes an image of a scene; then run ``scripts/ship_scene.py``.
_IMAGES_VERSION: Final = 1
#: Folder of the solved scenes in the package.
SHIPPED: Final = Path(__file__).with_name("solved")

_IMAGES: Final = tuple(field.name for field in fields(CleanState))
_FACTS = TypeAdapter(list[PressFacts])


@dataclass(frozen=True)
class SolvedScene:
    """The clean states of a scene in the order of ``Scene.drawn``, and their ground truth."""

    states: Sequence[CleanState]
    facts: Sequence[PressFacts]


def cache_file(scene: str, key: str) -> Path:
    """Return the cache file of a scene; ``key`` is text with all its parameters."""
    digest = hashlib.sha256(f"{_IMAGES_VERSION} {key}".encode()).hexdigest()
    return Path(user_cache_dir("tactune")) / "simulator" / f"{scene}-{digest[:16]}.npz"


def find_solved(path: Path, count: int) -> SolvedScene | None:
    """Return the ``count`` states of a cache file from the package or from the cache; None if neither has them."""
    return load_scene(SHIPPED / path.name, count) or load_scene(path, count)


def load_scene(path: Path, count: int) -> SolvedScene | None:
    """Return ``count`` states from a file, or None where it is missing or damaged."""
    images: dict[str, Any] = {}
    try:
        with path.open("rb") as file, np.load(file) as archive:
            facts = _FACTS.validate_json(archive["facts"].tobytes())
            for name in _IMAGES:
                images[name] = np.cumsum(archive[name], axis=0, dtype=archive[name].dtype)
        states = [CleanState(**{name: images[name][n] for name in _IMAGES}) for n in range(count)]
    except Exception:  # a damaged file may raise anything
        return None
    return SolvedScene(states, facts) if len(facts) == count else None


def save_scene(path: Path, scene: SolvedScene) -> None:
    """Write a scene to a file, whole or not at all."""
    arrays: dict[str, Any] = {"facts": np.frombuffer(_FACTS.dump_json(list(scene.facts)), np.uint8)}
    for name in _IMAGES:
        arrays[name] = np.stack([getattr(state, name) for state in scene.states])
        arrays[name][1:] -= arrays[name][:-1].copy()
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)
