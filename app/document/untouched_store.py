"""Untouched frames of presets without a file, kept on disk until the preset is saved."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Final

from ...core.model.frames import SensorFrame
from ...core.model.loading import read_file
from ...core.preset import UntouchedRecord
from ...core.rig.untouched import save_untouched

#: Number of newest untouched frames that are never removed: a running window may still undo to them.
_KEPT: Final = 20


class UntouchedStore:
    """A folder of untouched frames, named by their content; its methods may be called from any thread."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        #: Stands for the file of a preset without one; it is never written.
        self.place = folder / "preset.json"

    def keep(self, frame: SensorFrame, frames: int) -> UntouchedRecord:
        """Save an untouched frame and return its record for the preset."""
        return save_untouched(frame, frames, self.place)

    def home(self, record: UntouchedRecord | None, path: Path | None) -> Path | None:
        """Return the file that an untouched frame lies beside, for `load_untouched`: the preset's own, else `place`.

        If it is not found, return the preset's own file, or None without a file.
        """
        if record is None or (path is not None and (path.parent / record.file).is_file()):
            return path
        return self.place if (self._folder / record.file).is_file() else path

    def tidy(self, unsaved: Path) -> None:
        """Remove old untouched frames that no unsaved work in a folder refers to."""
        with suppress(OSError):
            named = b"".join(map(read_file, unsaved.glob("*.json")))
            files = sorted(self._folder.glob("untouched-*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
            for file in files[_KEPT:]:
                if file.name.encode() not in named:
                    file.unlink()
