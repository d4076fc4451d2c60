"""The marks of the open recording: in and out, and markers; kept beside the recording."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path

from PyQt6.QtCore import QObject, pyqtSignal

from ...core.errors import ExportError, SourceError
from ...core.output.markers import MAX_MARKERS, Marker, Marks, load_marks, markers_file, save_marks
from ..document.keeping import KeptState, free_aside


class MarksKeeper(KeptState[Marks]):
    """The marks of one source, saved soon after every change.

    A recording has them in a file beside it, or inside its folder. Where that cannot be written, and for sources that
    are no files, such as the simulator, they are kept in a folder of the user's data by the source's name.
    """

    changed = pyqtSignal(object)  # Marks

    def __init__(self, folder: Path, parent: QObject | None = None) -> None:
        self.marks = Marks()
        super().__init__(folder, "markers", parent)
        self._length = 0
        self._beside: dict[Path, Path | None] = {}
        self.changed.connect(self.schedule)

    @property
    def trim(self) -> tuple[int, int] | None:
        """The marked frames that the source has: the first, and the one behind the last; None: all."""
        if self.marks.trim is None:
            return None
        first, end = self.marks.trim[0], min(self.marks.trim[1], self._length)
        return (first, end) if first < end else None

    def open(self, source: str, length: int) -> None:
        """Read the marks of a source with this number of frames; 0: a source that has none."""
        self.flush()
        self.wait()  # what was written last may be read now
        digest = hashlib.blake2b(source.encode(), digest_size=4).hexdigest()
        letters = "".join(letter if letter.isalnum() else "_" for letter in source[-40:])
        own, beside = self.folder / f"{letters}-{digest}.json", markers_file(source)
        self._length, self._beside[own] = length, beside
        self.marks = self._read(own, beside) if length else Marks()
        self.follow(own, self.marks)
        self.changed.emit(self.marks)

    def set_in(self, frame: int) -> None:
        """Mark the first frame of a part; an out mark before it goes."""
        _, end = self.trim or (0, self._length)
        self._set_trim(frame, end if end > frame else self._length)

    def set_out(self, frame: int) -> None:
        """Mark the last frame of a part; an in mark behind it goes."""
        first, _ = self.trim or (0, self._length)
        self._set_trim(first if first <= frame else 0, frame + 1)

    def clear_trim(self) -> None:
        self._set_trim(0, self._length)

    def toggle(self, frame: int, time_s: float) -> None:
        """Add a marker with a new name at a frame, or delete those that the frame has."""
        markers = tuple(marker for marker in self.marks.markers if marker.frame != frame)
        if len(markers) == len(self.marks.markers):
            if len(markers) >= MAX_MARKERS:
                self.failed.emit(f"There are {MAX_MARKERS} markers already; delete some to add others.")
                return
            taken = {marker.name for marker in markers}
            number = next(number for number in range(1, len(markers) + 2) if f"Marker {number}" not in taken)
            markers = (*markers, Marker(frame=frame, name=f"Marker {number}", time_s=round(time_s, 6)))
        self._change(Marks(markers=markers, trim=self.marks.trim))

    def beyond(self, frame: int, forward: bool) -> int | None:
        """Return the frame of the next marker after ``frame``, or of the last one before it; none behind the end."""
        frames = [marker.frame for marker in self.marks.markers if marker.frame < self._length]
        if forward:
            return min((other for other in frames if other > frame), default=None)
        return max((other for other in frames if other < frame), default=None)

    def _set_trim(self, first: int, end: int) -> None:
        trim = None if (first, end) == (0, self._length) else (first, end)
        self._change(self.marks.model_copy(update={"trim": trim}))

    def _change(self, marks: Marks) -> None:
        if marks != self.marks:
            self.marks = marks
            self.changed.emit(marks)

    def present(self) -> Marks:
        return self.marks

    def write(self, state: Marks, file: Path) -> None:
        """Write marks beside their recording, else into the user's data."""
        if (beside := self._beside[file]) is not None:
            with suppress(ExportError):
                save_marks(beside, state)
                file.unlink(missing_ok=True)
                return
            self.failed.emit(f"{beside} cannot be written, so the markers are kept in {file} on this computer.")
        save_marks(file, state)

    def _read(self, own: Path, beside: Path | None) -> Marks:
        """Return the marks of the first file that there is; a damaged one is set aside."""
        for file in (own, beside):
            if file is None or not file.exists():
                continue
            try:
                return load_marks(file)
            except SourceError as error:
                aside = free_aside(file.with_name(f"{file.name}.damaged"))
                with suppress(OSError):
                    file.rename(aside)
                self.failed.emit(f"{error}. The file was set aside as {aside.name}.")
        return Marks()
