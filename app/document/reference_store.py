"""References of presets that have no folder yet, kept on disk like all unsaved work."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Final

from ...core.model.frames import SensorFrame
from ...core.preset import ReferenceRecord
from ...core.rig.untouched import save_reference

#: References that stay, though no unsaved work names them: a window that runs may still undo to them.
_KEPT: Final = 20


class ReferenceStore:
    """A folder of references, named by their content; its methods may be called from any thread.

    Parameters
    ----------
    folder : Path
        Made when the first reference comes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        #: Stands for the file of a preset that has none; nothing is written there.
        self.place = folder / "preset.json"

    def keep(self, frame: SensorFrame, frames: int) -> ReferenceRecord:
        """Write a reference down, safe from a crash, and return what the preset keeps of it.

        Raises
        ------
        ExportError
            It cannot be written.
        """
        return save_reference(frame, frames, self.place)

    def home(self, record: ReferenceRecord | None, path: Path | None) -> Path | None:
        """Return beside which file a reference lies, as `load_reference` takes it: the preset's own, else `place`.

        Where it lies nowhere, the preset's own file; None where it has none.
        """
        if record is None or (path is not None and (path.parent / record.file).is_file()):
            return path
        return self.place if (self._folder / record.file).is_file() else path

    def tidy(self, unsaved: Path) -> None:
        """Remove references that neither unsaved work in a folder names nor a running window is likely to."""
        with suppress(OSError):
            named = "".join(file.read_text(encoding="utf-8", errors="replace") for file in unsaved.glob("*.json"))
            files = sorted(self._folder.glob("reference-*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
            for file in files[_KEPT:]:
                if file.name not in named:
                    file.unlink()
