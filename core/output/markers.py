"""Named markers and the in and out marks of a recording, in a small JSON file beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from ..errors import SourceError
from ..model.files import atomic_path, recording_files, user_path
from ..model.loading import MAX_JSON_BYTES, read_file

#: Longest name of a marker.
MAX_NAME: Final = 120
#: Largest number of markers; more make every edit in the window slow.
MAX_MARKERS: Final = 10_000
_FrameIndex = Annotated[int, Field(ge=0, lt=2**31)]


class Marker(BaseModel):
    """A named frame: ``frame`` counts from 0, ``time_s`` from the first frame."""

    model_config = ConfigDict(frozen=True)

    frame: _FrameIndex
    name: Annotated[str, Field(min_length=1, max_length=MAX_NAME)]
    time_s: Annotated[float, Field(allow_inf_nan=False)]


class Marks(BaseModel):
    """What a person marked in a recording: markers in the order of their frames, and the in and out marks.

    ``trim`` holds the first frame between the marks, and the one behind the last.
    """

    model_config = ConfigDict(frozen=True)

    markers: Annotated[tuple[Marker, ...], Field(max_length=MAX_MARKERS)] = ()
    trim: tuple[_FrameIndex, _FrameIndex] | None = None

    @field_validator("markers")
    @classmethod
    def _in_order(cls, markers: tuple[Marker, ...]) -> tuple[Marker, ...]:
        return tuple(sorted(markers, key=lambda marker: marker.frame))

    @field_validator("trim")
    @classmethod
    def _not_empty(cls, trim: tuple[int, int] | None) -> tuple[int, int] | None:
        if trim is not None and trim[0] >= trim[1]:
            raise ValueError(f"trim {trim} holds no frame")
        return trim


def markers_file(source: str) -> Path | None:
    """Return the file for the marks of a source, by its name; None if the source is neither a file nor a folder.

    ``mcap:press.mcap`` has ``press.mcap.markers.json``, ``folder:press`` has ``press/markers.json``; a recording in
    two files has it beside the first.
    """
    rest = source.partition(":")[2]
    if files := recording_files(rest):
        return files[0].with_name(f"{files[0].name}.markers.json")
    folder = user_path(rest)
    return folder / "markers.json" if rest and folder.is_dir() else None


def load_marks(path: Path) -> Marks:
    """Read marks; none if there is no such file. Raises `SourceError` if it cannot be read or is damaged."""
    try:
        return Marks.model_validate_json(read_file(path, MAX_JSON_BYTES))
    except FileNotFoundError:
        return Marks()
    except OSError as error:
        raise SourceError(f"cannot read the markers in {path}: {error.strerror or error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the file"
        raise SourceError(f"the markers in {path} are damaged ({place}: {first['msg']})") from error


def save_marks(path: Path, marks: Marks) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(marks.model_dump_json(indent=1) + "\n", encoding="utf-8")
