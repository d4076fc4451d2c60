"""Untouched frames of presets that have no folder yet, kept on disk like all unsaved work."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Final

from ...core.model.frames import SensorFrame
from ...core.preset import UntouchedRecord
from ...core.rig.untouched import save_untouched

#: Untouched frames that stay, though no unsaved work names them: a window that runs may still undo to them.
_KEPT: Final = 20


class UntouchedStore:
    """A folder of untouched frames, named by their content; its methods may be called from any thread.

    Parameters
    ----------
    folder : Path
        Made when the first untouched frame comes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        #: Stands for the file of a preset that has none; nothing is written there.
        self.place = folder / "preset.json"

    def keep(self, frame: SensorFrame, frames: int) -> UntouchedRecord:
        """Write an untouched frame down, safe from a crash, and return what the preset keeps of it.

        Raises
        ------
        ExportError
            It cannot be written.
        """
        return save_untouched(frame, frames, self.place)

    def home(self, record: UntouchedRecord | None, path: Path | None) -> Path | None:
        """Return the file that an untouched frame lies beside, for `load_untouched`: the preset's own, else `place`.

        Where it lies nowhere, the preset's own file; None where it has none.
        """
        if record is None or (path is not None and (path.parent / record.file).is_file()):
            return path
        return self.place if (self._folder / record.file).is_file() else path

    def tidy(self, unsaved: Path) -> None:
        """Remove untouched frames that neither unsaved work in a folder names nor a running window is likely to."""
        with suppress(OSError):
            named = "".join(file.read_text(encoding="utf-8", errors="replace") for file in unsaved.glob("*.json"))
            files = sorted(self._folder.glob("untouched-*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
            for file in files[_KEPT:]:
                if file.name not in named:
                    file.unlink()
