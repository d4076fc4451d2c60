"""What a person does with files: presets, recordings, exports; nothing entered is lost on the way."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from PyQt6.QtCore import QObject

from ..core.errors import TactuneError
from ..core.frames import Rig
from ..core.preset import now
from ..core.preset_file import load_preset
from .dialogs import PRESET_FILTER, Dialogs
from .document import Document
from .message_bar import MessageBar, Severity
from .recovery import Autosave, UnsavedWork, unsaved_work
from .settings import Settings

EXPORT_FILTERS = ["PLY, binary (*.ply)", "PCD, binary (*.pcd)", "NumPy (*.npz)", "Table (*.csv)"]


class FileFlows(QObject):
    """Leads through opening, saving and exporting; asks before changes are lost.

    Parameters
    ----------
    open_source : callable
        Opens a source by its name.
    rig : callable
        Returns the rig of the source that is open, or None.
    """

    def __init__(
        self,
        document: Document,
        dialogs: Dialogs,
        settings: Settings,
        messages: MessageBar,
        autosave: Autosave,
        open_source: Callable[[str], None],
        rig: Callable[[], Rig | None],
    ) -> None:
        super().__init__(document)
        self._document = document
        self._dialogs = dialogs
        self._settings = settings
        self._messages = messages
        self._autosave = autosave
        self._open_source = open_source
        self._rig = rig

    # Presets

    def guarded(self, then: Callable[[], object]) -> None:
        """Do something that replaces the preset, after asking about unsaved changes."""
        if not self._document.dirty:
            then()
            return
        self._dialogs.ask_unsaved(self._document.preset.name, save=lambda: self.save(then), discard=then)

    def new(self, shipped: str = "default") -> None:
        """Begin a new preset from a shipped one."""

        def begin() -> None:
            created = now()
            preset = load_preset(shipped)
            self._document.new(preset.model_copy(update={"name": "untitled", "created": created, "modified": created}))

        self.guarded(partial(self._told, begin))

    def open_preset_dialog(self) -> None:
        """Ask for a preset file and open it."""
        self.guarded(
            lambda: self._dialogs.open_file("Open preset", self._folder("preset"), PRESET_FILTER, self._read_preset)
        )

    def open_preset(self, path: Path) -> None:
        """Open a preset file, after asking about unsaved changes."""
        self.guarded(lambda: self._read_preset(path))

    def save(self, then: Callable[[], object] | None = None) -> None:
        """Save to the document's file, or ask for one; ``then`` runs only once that has succeeded."""
        if self._document.path is None:
            self.save_as(then)
        else:
            self._write_preset(self._document.path, then)

    def save_as(self, then: Callable[[], object] | None = None) -> None:
        """Ask where to save."""
        suggestion = self._document.path or self._folder("preset") / f"{file_name(self._document.preset.name)}.json"
        self._dialogs.save_file("Save preset", suggestion, [PRESET_FILTER], lambda path: self._write_preset(path, then))

    def details(self) -> None:
        """Ask for the preset's name and notes."""
        preset = self._document.preset
        self._dialogs.ask_details(
            preset.name,
            preset.notes,
            lambda name, notes: self._document.edit_many({"name": name, "notes": notes}),
        )

    # Recordings

    def open_folder_dialog(self) -> None:
        """Ask for a recording stored as a folder."""
        self._dialogs.open_folder(
            "Open a recorded folder", self._folder("source"), lambda path: self._open_recording(f"folder:{path}", path)
        )

    def open_bag_dialog(self) -> None:
        """Ask for a RealSense bag."""
        self._dialogs.open_file(
            "Open a RealSense recording",
            self._folder("source"),
            "RealSense recordings (*.bag)",
            lambda path: self._open_recording(f"bag:{path}", path),
        )

    def open_dropped(self, path: Path) -> None:
        """Open whatever was dropped on the window, or say why not."""
        if path.is_dir():
            self._open_recording(f"folder:{path}", path)
        elif path.suffix.lower() == ".bag":
            self._open_recording(f"bag:{path}", path)
        elif path.suffix.lower() == ".json":
            self.open_preset(path)
        else:
            self._messages.show_message(
                "file",
                Severity.ERROR,
                f"{path.name} is neither a preset (.json) nor a recording (a folder with rig.json, or a .bag file); "
                "nothing was changed.",
            )

    # Export

    def export_dialog(self, sequence: int, export: Callable[[Path], None]) -> None:
        """Ask where to save the patch of a frame."""
        suggestion = self._folder("export") / f"patch_{sequence:06d}.ply"

        def chosen(path: Path) -> None:
            self._settings.set("folder/export", str(path.parent))
            export(path)

        self._dialogs.save_file("Export this patch", suggestion, EXPORT_FILTERS, chosen)

    # Unsaved work of a window that died

    def offer_unsaved_work(self, folder: Path) -> None:
        """Offer what the last crash left, one piece after the other."""
        pieces = unsaved_work(folder)
        if not pieces:
            return
        newest = pieces[0]
        where = f" ({newest.path})" if newest.path else ""

        def discard() -> None:
            newest.file.unlink(missing_ok=True)
            self.offer_unsaved_work(folder)

        self._messages.show_message(
            "recovery",
            Severity.INFO,
            f"Tactune ended without saving “{newest.preset.name}”{where}. Its unsaved changes were kept.",
            offers=[("Restore", lambda: self.guarded(lambda: self._restore(newest))), ("Discard", discard)],
        )

    def _restore(self, work: UnsavedWork) -> None:
        self._document.restore(work.preset, work.path)
        self._autosave.take_over(work)

    # Steps

    def _read_preset(self, path: Path) -> None:
        if self._told(lambda: self._document.open(path)):
            self._messages.clear("file")
            self._settings.set("folder/preset", str(path.parent))
            self._settings.add_recent("presets", str(path))
        elif not path.exists():
            self._settings.remove_recent("presets", str(path))

    def _write_preset(self, path: Path, then: Callable[[], object] | None) -> None:
        self._complete(path)
        if not self._told(lambda: self._document.save(path)):
            return
        self._messages.clear("file")
        self._settings.set("folder/preset", str(path.parent))
        self._settings.add_recent("presets", str(path))
        if then is not None:
            then()

    def _complete(self, path: Path) -> None:
        """Before it is saved, give a preset what it still lacks: a name, and the rig it was tuned on."""
        preset, rig = self._document.preset, self._rig()
        missing: dict[str, Any] = {}
        if preset.name == "untitled":
            missing["name"] = path.stem[:120] or "untitled"
        if preset.rig is None and rig is not None:
            missing["rig"] = rig.model_dump(mode="json")
        if missing:
            self._document.edit_many(missing)

    def _open_recording(self, name: str, path: Path) -> None:
        self._settings.set("folder/source", str(path.parent))
        self._open_source(name)

    def _told(self, action: Callable[[], None]) -> bool:
        """Do something with a file; an error becomes a message. Returns whether it succeeded."""
        try:
            action()
        except TactuneError as error:
            self._messages.show_message("file", Severity.ERROR, str(error))
            return False
        return True

    def _folder(self, kind: str) -> Path:
        remembered = Path(self._settings.text(f"folder/{kind}", str(Path.home())))
        return remembered if remembered.is_dir() else Path.home()


def file_name(name: str) -> str:
    """Turn a preset's name into a file name."""
    return "".join(letter if letter.isalnum() or letter in "-_ ." else "_" for letter in name).strip(" .") or "preset"
