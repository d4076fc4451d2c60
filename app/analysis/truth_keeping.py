"""The alignment of a scan outlives closing and crashing: it is kept on disk, one file per scan, and restored."""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from PyQt6.QtCore import QObject

from ...core.model.files import atomic_path
from ...core.model.frames import rigid_transform
from ...core.preset import now
from ...core.scan.paint import PaintSettings
from ...core.scan.pose import save_transform
from ..document.keeping import KeptState, check_version, remove_unnamed, write_json
from .truth_patch import FrozenPatch
from .truth_state import PickedPair, Place, TruthSession, TruthState

_VERSION = 1


class TruthKeeper(KeptState[TruthState]):
    """Keeps a session's state in a folder; patches lie beside it under their digest."""

    def __init__(self, session: TruthSession, folder: Path, parent: QObject | None = None) -> None:
        self._session = session
        super().__init__(folder, "alignment", parent)
        self._key = ""
        self._lost = ""
        self._stored: set[str] = set()
        self._seen: dict[str, tuple[TruthState, datetime]] = {}
        session.changed.connect(self.schedule)

    @property
    def transform_file(self) -> Path:
        """Where the pose of the present scan lies once it is kept, as the command line reads it."""
        return self.folder / f"scan-{self._key}.transform.json"

    def present(self) -> TruthState:
        """Return the session's state."""
        return self._session.state

    def turn_to(self, key: str) -> datetime | None:
        """Keep the present scan's work and take up another's; return when that was kept, None where there is none."""
        self.flush()
        if self._key:
            self._seen[self._key] = self._session.state, now()
        self._key = key
        file = self.folder / f"scan-{key}.json" if key else None
        found = self._seen.get(key) or (None if file is None else self._read(file))
        state = found[0] if found else TruthState()
        self.follow(file, state)
        self._session.start(state)
        return found[1] if found and not found[0].empty else None

    def close(self) -> None:
        """Write the last state and remove patches that no kept scan names."""
        self.flush()
        self.on_disk(
            remove_unnamed,
            self.folder,
            "scan-*[0-9a-f].json",
            lambda content: [_patch_file(self.folder, content["patch"]["digest"]).name] if content["patch"] else [],
            "patch-*.npz",
        )
        self.finish()

    def write(self, state: TruthState, file: Path) -> None:
        """Write the patch, the state that names it, and the pose for the command line."""
        if state.patch is not None:
            self._write_patch(state.patch)
        write_json(file, _content(state))
        if state.pose is not None:
            save_transform(file.with_suffix(".transform.json"), state.pose)

    def parse(self, content: dict[str, Any]) -> TruthState:
        """Return the kept state, without its patch where that is gone."""
        check_version(content, _VERSION)
        paint: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in content["paint"].items()
        }
        pose, patch, self._lost = content["pose"], None, ""
        if content["patch"] is not None:
            try:
                patch = _read_patch(self.folder, content["patch"])
            except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
                self._lost = str(error)
        return TruthState(
            paint=PaintSettings(**paint),
            pairs=tuple(PickedPair(_place(pair["scan"]), _place(pair["patch"])) for pair in content["pairs"]),
            pose=None if pose is None else rigid_transform(pose),
            origin=content["origin"],
            patch=patch,
        )

    def _read(self, file: Path) -> tuple[TruthState, datetime] | None:
        self._lost = ""
        found = self.read(file)
        if self._lost and found is not None:
            self.failed.emit(f"The patch that this scan was aligned to is gone ({self._lost}); pairs and pose remain.")
        return found

    def _write_patch(self, patch: FrozenPatch) -> None:
        """Write a patch once; a file that another process left under its name may be damaged and is replaced."""
        file = _patch_file(self.folder, patch.digest)
        if patch.digest in self._stored and file.exists():
            return
        with atomic_path(file) as temporary:
            np.savez_compressed(temporary, points=patch.points, context=patch.context)
        self._stored.add(patch.digest)


def _content(state: TruthState) -> dict[str, Any]:
    patch = state.patch
    return {
        "version": _VERSION,
        "paint": asdict(state.paint),
        "pairs": [asdict(pair) for pair in state.pairs],
        "pose": state.pose,
        "origin": state.origin,
        "patch": None if patch is None else {
            "digest": patch.digest, "area_mm2": patch.area_mm2, "source": patch.source, "frame": patch.frame,
            "preset": patch.preset,
        },
    }  # fmt: skip


def _place(values: Any) -> Place | None:
    if values is None:
        return None
    x, y, z = (float(value) for value in values)
    return x, y, z


def _patch_file(folder: Path, digest: str) -> Path:
    return folder / f"patch-{digest}.npz"


def _read_patch(folder: Path, told: dict[str, Any]) -> FrozenPatch:
    with _patch_file(folder, told["digest"]).open("rb") as file, np.load(file) as stored:
        points, context = stored["points"], stored["context"]
    patch = FrozenPatch(points, context, told["area_mm2"], told["source"], told["frame"], told["preset"])
    if patch.digest != told["digest"]:
        raise ValueError(f"the patch {told['digest']} has been changed")
    return patch
