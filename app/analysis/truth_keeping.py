"""Work on a scan outlives closing and crashing: it is kept on disk, one file per scan, and taken up again."""

from __future__ import annotations

import json
import zipfile
import zlib
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from PyQt6.QtCore import QObject, QTimer, pyqtSignal

from ...core.errors import TactuneError
from ...core.model.files import atomic_path
from ...core.model.frames import rigid_transform
from ...core.preset import now
from ...core.scan.paint import PaintSettings
from ...core.scan.pose import save_transform
from .truth_patch import FrozenPatch
from .truth_state import PickedPair, Place, TruthSession, TruthState

DELAY_MS = 600
_VERSION = 1


class TruthKeeper(QObject):
    """Keeps a session's state in a folder; patches lie beside it under their digest, written by a thread.

    Signals
    -------
    failed(sentence: str)
        The state could not be kept, which is said once, or what was kept cannot be read.
    """

    failed = pyqtSignal(str)

    def __init__(self, session: TruthSession, folder: Path, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._session, self._folder = session, folder
        self._key = ""
        self._kept = session.state
        self._said = False
        self._written: set[str] = set()
        self._seen: dict[str, tuple[TruthState, datetime]] = {}
        self._disk = ThreadPoolExecutor(max_workers=1, thread_name_prefix="scan-truth")
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(DELAY_MS)
        self._timer.timeout.connect(self.flush)
        session.changed.connect(self._timer.start)

    @property
    def transform_file(self) -> Path:
        """Where the pose of the present scan lies once it is kept, as the command line reads it."""
        return self._folder / f"scan-{self._key}.transform.json"

    def turn_to(self, key: str) -> datetime | None:
        """Keep the present scan's work and take up another's; returns when that was kept, None: there is none."""
        self.flush()
        if self._key:
            self._seen[self._key] = self._session.state, now()
        self._key = key
        found = self._seen.get(key) or self._read()
        self._kept = found[0] if found else TruthState()
        self._session.start(self._kept)
        return found[1] if found and not found[0].empty else None

    def _read(self) -> tuple[TruthState, datetime] | None:
        file = self._file()
        if file is None:
            return None
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
            state, lost = _state_of(content, self._folder)
            kept_at = datetime.fromisoformat(content["kept"])
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError, KeyError, TypeError, TactuneError) as error:
            with suppress(OSError):
                file.replace(file.with_suffix(".damaged"))
            self.failed.emit(f"The kept alignment {file} cannot be read ({error}); it was set aside.")
            return None
        if lost:
            self.failed.emit(f"The patch that this scan was aligned to is gone ({lost}); pairs and pose are kept.")
        return state, kept_at

    def flush(self) -> None:
        """Have the file brought up to date, soon and in order."""
        self._timer.stop()
        state = self._session.state
        file = self._file()
        if file is not None and state != self._kept:
            self._kept = state
            self._disk.submit(self._write, state, file, self.transform_file)

    def close(self) -> None:
        """Write the last state."""
        self.flush()
        self._disk.submit(_tidy, self._folder)
        self._disk.shutdown(wait=True)

    def _file(self) -> Path | None:
        return self._folder / f"scan-{self._key}.json" if self._key else None

    def _write(self, state: TruthState, file: Path, transform: Path) -> None:
        try:
            if state.patch is not None:
                self._write_patch(state.patch)
            with atomic_path(file) as temporary:
                temporary.write_text(json.dumps(_content(state)), encoding="utf-8")
            if state.pose is not None:
                save_transform(transform, state.pose)
        except (OSError, TactuneError) as error:
            if not self._said:
                self._said = True
                self.failed.emit(f"The alignment cannot be kept safe in {self._folder} ({error}).")

    def _write_patch(self, patch: FrozenPatch) -> None:
        """Write a patch once; a file that somebody else has left under its name may be damaged."""
        file = _patch_file(self._folder, patch.digest)
        if patch.digest in self._written and file.exists():
            return
        with atomic_path(file) as temporary:
            np.savez_compressed(temporary, points=patch.points, context=patch.context)
        self._written.add(patch.digest)


def _content(state: TruthState) -> dict[str, Any]:
    patch = state.patch
    return {
        "version": _VERSION,
        "kept": now().isoformat(),
        "paint": asdict(state.paint),
        "pairs": [asdict(pair) for pair in state.pairs],
        "pose": state.pose,
        "origin": state.origin,
        "patch": None if patch is None else {
            "digest": patch.digest, "area_mm2": patch.area_mm2, "source": patch.source, "frame": patch.frame,
            "preset": patch.preset,
        },
    }  # fmt: skip


def _state_of(content: dict[str, Any], folder: Path) -> tuple[TruthState, str]:
    """Return what was kept, and why its patch is missing where it is."""
    if content["version"] != _VERSION:
        raise ValueError(f"version {content['version']} is not known here")
    paint: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in content["paint"].items()
    }
    pose, patch, lost = content["pose"], None, ""
    if content["patch"] is not None:
        try:
            patch = _read_patch(folder, content["patch"])
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            lost = str(error)
    state = TruthState(
        paint=PaintSettings(**paint),
        pairs=tuple(PickedPair(_place(pair["scan"]), _place(pair["patch"])) for pair in content["pairs"]),
        pose=None if pose is None else rigid_transform(pose),
        origin=content["origin"],
        patch=patch,
    )
    return state, lost


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


def _tidy(folder: Path) -> None:
    """Remove patches that no kept scan mentions."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        kept = [json.loads(file.read_text(encoding="utf-8"))["patch"] for file in folder.glob("scan-*[0-9a-f].json")]
        wanted = {_patch_file(folder, patch["digest"]).name for patch in kept if patch is not None}
        for file in folder.glob("patch-*.npz"):
            if file.name not in wanted:
                file.unlink()
