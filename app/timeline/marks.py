"""The marks of the open recording: in and out, named markers; kept beside the recording, each edit undoable."""

from __future__ import annotations

import hashlib
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from PyQt6.QtCore import QObject, pyqtSignal

from ...core.errors import ExportError, SourceError
from ...core.output.markers import MAX_MARKERS, MAX_NAME, Marker, Marks, load_marks, markers_file, save_marks
from ..document.history import History
from ..document.keeping import free_aside


class MarksKeeper(QObject):
    """The marks of one source, saved with every change, by a thread: a slow disk never stalls the window.

    A recording has them in a file beside it, or inside its folder. Where that cannot be written, and for sources that
    are no files, such as the simulator, they are kept in a folder of the user's data by the source's name.

    Signals
    -------
    changed(Marks)
    told(sentence: str)
        Where marks could not be read or written.
    """

    changed = pyqtSignal(object)
    told = pyqtSignal(str)

    def __init__(self, folder: Path, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._folder = folder
        self._history: History[Marks] = History(Marks(), self)
        self._history.changed.connect(self._changed)
        self.undo_stack = self._history.undo_stack
        self._length = 0
        self._beside: Path | None = None
        self._own: Path | None = None
        self._damaged: Path | None = None
        self._disk = ThreadPoolExecutor(max_workers=1, thread_name_prefix="keep markers")
        self._loading = False

    @property
    def marks(self) -> Marks:
        """The present marks."""
        return self._history.state

    @property
    def trim(self) -> tuple[int, int] | None:
        """The marked frames that the source has: the first, and the one behind the last; None: all."""
        if self.marks.trim is None:
            return None
        first, end = self.marks.trim[0], min(self.marks.trim[1], self._length)
        return (first, end) if first < end else None

    def open(self, source: str, length: int) -> None:
        """Read the marks of a source with this number of frames; 0: a source that has none."""
        with suppress(RuntimeError):  # the window is closing
            self._disk.submit(lambda: None).result()  # what was written last may be read now
        self._length = length
        self._beside = markers_file(source)
        digest = hashlib.blake2b(source.encode(), digest_size=4).hexdigest()
        letters = "".join(letter if letter.isalnum() else "_" for letter in source[-40:])
        self._own = self._folder / f"{letters}-{digest}.json"
        self._damaged = None
        marks = self._read() if length else Marks()
        self._loading = True
        self._history.start(marks)
        self._loading = False

    def close(self) -> None:
        """Wait until the last change is written."""
        self._disk.shutdown(wait=True)

    # Edits

    def set_in(self, frame: int) -> None:
        """Mark the first frame of a part; an out mark before it goes."""
        _, end = self.trim or (0, self._length)
        self._set_trim("Set in mark", frame, end if end > frame else self._length)

    def set_out(self, frame: int) -> None:
        """Mark the last frame of a part; an in mark behind it goes."""
        first, _ = self.trim or (0, self._length)
        self._set_trim("Set out mark", first if first <= frame else 0, frame + 1)

    def clear_trim(self) -> None:
        """Remove the in and out marks."""
        self._set_trim("Clear in and out marks", 0, self._length)

    def add(self, frame: int, time_s: float) -> None:
        """Add a marker with a new name, unless the frame has one."""
        markers = self.marks.markers
        if any(marker.frame == frame for marker in markers):
            return
        if len(markers) >= MAX_MARKERS:
            self.told.emit(f"There are {MAX_MARKERS} markers already; delete some to add others.")
            return
        taken = {marker.name for marker in markers}
        number = next(number for number in range(1, len(markers) + 2) if f"Marker {number}" not in taken)
        self._edit("Add marker", (*markers, Marker(frame=frame, name=f"Marker {number}", time_s=round(time_s, 6))))

    def rename(self, place: int, name: str) -> None:
        """Rename the marker at a place in `Marks.markers`; an empty name changes nothing."""
        markers = list(self.marks.markers)
        if name := name.strip()[:MAX_NAME]:
            markers[place] = markers[place].model_copy(update={"name": name})
            self._edit("Rename marker", tuple(markers))

    def delete(self, places: set[int]) -> None:
        """Delete the markers at these places in `Marks.markers`."""
        kept = tuple(marker for place, marker in enumerate(self.marks.markers) if place not in places)
        self._edit("Delete marker", kept)

    def beyond(self, frame: int, forward: bool) -> int | None:
        """Return the frame of the next marker after ``frame``, or of the last one before it; None if there is none.

        Markers behind the end are left out: the recording was longer when they were set.
        """
        frames = [marker.frame for marker in self.marks.markers if marker.frame < self._length]
        if forward:
            return min((other for other in frames if other > frame), default=None)
        return max((other for other in frames if other < frame), default=None)

    # Steps

    def _set_trim(self, text: str, first: int, end: int) -> None:
        trim = None if (first, end) == (0, self._length) else (first, end)
        self._history.edit(text, self.marks.model_copy(update={"trim": trim}))

    def _edit(self, text: str, markers: tuple[Marker, ...]) -> None:
        self._history.edit(text, Marks(markers=markers, trim=self.marks.trim))

    def _changed(self, marks: Marks) -> None:
        if not self._loading:
            assert self._own is not None
            self._disk.submit(self._write, marks, self._beside, self._own, self._damaged)
            self._damaged = None
        self.changed.emit(marks)

    def _read(self) -> Marks:
        """Return the marks of the first file that there is."""
        for file in (self._own, self._beside):
            if file is not None and file.exists():
                try:
                    return load_marks(file)
                except SourceError as error:
                    self._damaged = file
                    self.told.emit(f"{error}. The file stays; with the next mark it becomes {_aside(file).name}.")
        return Marks()

    def _write(self, marks: Marks, beside: Path | None, own: Path, damaged: Path | None) -> None:
        """Write marks, on the disk's thread."""
        if damaged is not None:
            with suppress(OSError):
                damaged.rename(_aside(damaged))
        if beside is not None:
            try:
                save_marks(beside, marks)
            except ExportError:
                self.told.emit(f"{beside} cannot be written, so the markers are kept in {own} on this computer.")
            else:
                with suppress(OSError):
                    own.unlink(missing_ok=True)
                return
        try:
            save_marks(own, marks)
        except ExportError as error:
            self.told.emit(f"The markers are not kept: {error}.")


def _aside(file: Path) -> Path:
    return free_aside(file.with_name(f"{file.name}.damaged"))
