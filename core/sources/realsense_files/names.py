"""How recordings are named."""

from __future__ import annotations

from pathlib import Path

from ...model.files import user_path

SUFFIXES = (".bag", ".db3")


def recording_files(text: str) -> tuple[Path, ...]:
    """Return the one or two files that a name means; none where there are no such files.

    A name is a path, or two paths with a comma between them. Paths may contain commas themselves:
    a name that is a file as it stands is that file, else it is parted at the first comma that has a
    file on either side.
    """
    if user_path(text).is_file():
        return (user_path(text),)
    for at, letter in enumerate(text):
        if letter == ",":
            first, second = user_path(text[:at]), user_path(text[at + 1 :])
            if first.is_file() and second.is_file():
                return first, second
    return ()
