"""Sources by name: ``sim:cup``, ``folder:PATH``, ``bag:PATH`` or just a path.

A kind of source is one `SourceKind` object that an entry point in the group ``tactune.sources`` names; the built-in
ones are declared in Tactune's ``pyproject.toml``, others in their own packages.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ..errors import PluginError, SourceError
from ..model.files import path_exists, recording_files, user_path
from ..model.plugins import NOT_INSTALLED, load_plugin, load_plugins, plugin_names
from .base import FrameSource, Progress

if TYPE_CHECKING:
    from ..preset import CamerasSection

    Opener = Callable[[str, Progress | None, CamerasSection | None], FrameSource]

GROUP = "tactune.sources"


@dataclass(frozen=True)
class SourceKind:
    """One kind of source: its names, what the user must choose, and how it is opened.

    Attributes
    ----------
    scheme : str
        Text before the colon of a name; the entry point has the same name.
    title : str
        Name in menus and dialogs.
    form : str
        How a name is written, such as ``"folder:PATH"``.
    description : str
        A sentence for help texts and tooltips.
    open : callable
        ``open(rest, progress, cameras)`` returns the source. ``rest`` is the name after the colon, ``progress`` is
        called with the fraction done and the current step, or is None, ``cameras`` is the preset's section
        ``cameras``, or None. Raises `SourceError`. A heavy module is best imported inside.
    needs : {"nothing", "folder", "file"}
        What the user must choose to open a source.
    pattern : str
        File names that it opens, such as ``"*.bag *.db3"``, or the file that makes a folder one, such as
        ``"rig.json"``; empty if it opens none.
    examples : tuple of str
        Example names for menus.
    rank : int
        Position in lists, lower first; built-in kinds have ranks below 100.
    """

    scheme: str
    title: str
    form: str
    description: str
    open: Opener
    needs: Literal["nothing", "folder", "file"] = "nothing"
    pattern: str = ""
    examples: tuple[str, ...] = ()
    rank: int = 100

    def claim(self, name: str) -> str | None:
        """Return what to open where a name without a scheme is a path of this kind, else None."""
        path = user_path(name)
        if self.needs == "file":
            return name if path.is_file() and any(path.match(each) for each in self.pattern.split()) else None
        if self.needs == "folder" and self.pattern:
            if (path / self.pattern).is_file():
                return name
            if path.name == self.pattern and path.is_file():
                return str(path.parent)
        return None


def source_kinds() -> tuple[SourceKind, ...]:
    """Return every kind of source that can be loaded, the default first."""
    return _all_kinds()[0]


def open_source(name: str, progress: Progress | None = None, cameras: CamerasSection | None = None) -> FrameSource:
    """Open a source by its name.

    Parameters
    ----------
    name : str
        ``"sim"``, ``"sim:cup?seed=3&noise=0.5"``, ``"folder:PATH"``, ``"bag:PATH"``, or a path whose
        kind is plain: a folder with ``rig.json``, that file itself, an ``.mcap``, a ``.bag`` or
        ``.db3``, or two of the latter with a comma between them.
    progress : callable, optional
        Receives the fraction done, 0 to 1, and the current step, where opening takes long.
    cameras : CamerasSection, optional
        The preset's section ``cameras``: which devices live sources open, and their options.

    Raises
    ------
    SourceError
        Unknown kind, scene or option, nothing at that path, or unreadable; the message says what to do.
    """
    try:
        scheme, _, rest = name.partition(":")
        if scheme in plugin_names(GROUP):
            kind = _load(scheme)
        else:
            kind, rest = _guess(name)
        if kind.needs != "nothing" and not rest:
            raise SourceError(f"{kind.scheme}: needs a path, as in {kind.form}")
        return kind.open(rest, progress, cameras)
    except PluginError as error:
        raise SourceError(str(error)) from error
    except OSError as error:
        raise SourceError(f"cannot open {name}: {error.strerror or error}; check the path") from error


def opens_by_name(name: str) -> bool:
    """Return whether `open_source` knows the kind of a source's name; a program may make sources of its own."""
    return name.partition(":")[0] in plugin_names(GROUP)


def missing_path(name: str) -> Path | None:
    """Return the file or folder that a source's name needs and that does not exist, else None."""
    scheme, colon, rest = name.partition(":")
    if scheme == "live" and colon:
        return missing_path(rest)
    kind = next((kind for kind in source_kinds() if kind.scheme == scheme), None)
    if kind is None:
        return None if path_exists(name) or recording_files(name) else user_path(name)
    if kind.needs == "nothing" or path_exists(rest) or recording_files(rest):
        return None
    return next((user_path(part) for part in rest.split(",") if not path_exists(part)), user_path(rest))


def is_recording(name: str) -> bool:
    """Return whether a source's name means files, which are read at once, not cameras or what is computed."""
    scheme = name.partition(":")[0]
    return next((kind.needs != "nothing" for kind in source_kinds() if kind.scheme == scheme), path_exists(name))


def _load(scheme: str) -> SourceKind:
    kind = load_plugin(GROUP, scheme, SourceKind)
    if kind.scheme != scheme:
        raise PluginError(
            f"the entry point {scheme!r} ({GROUP}) has the scheme {kind.scheme!r}; both names must be the same"
        )
    return kind


def _all_kinds() -> tuple[tuple[SourceKind, ...], list[str]]:
    """Return all kinds in the order of lists, and a sentence for each one that cannot be loaded."""
    plugins = load_plugins(GROUP, _load)
    kinds = sorted(plugins.found.values(), key=lambda kind: (kind.rank, kind.scheme))
    return tuple(kinds), list(plugins.problems.values())


def _guess(name: str) -> tuple[SourceKind, str]:
    """Return the kind of a name without a scheme, and what to open."""
    kinds, problems = _all_kinds()
    if not kinds:
        raise SourceError(NOT_INSTALLED)
    for kind in kinds:
        if name and (rest := kind.claim(name)) is not None:
            return kind, rest
    forms = "; ".join([", ".join(kind.form for kind in kinds), *problems])
    if not name or not user_path(name).exists():
        scheme, colon, _ = name.partition(":")
        if colon and scheme.isalnum() and len(scheme) > 1:
            raise SourceError(f"{name!r}: there is no kind of source called {scheme!r}; known are {forms}")
        raise SourceError(f"{name!r} is no source: nothing is at that path; give an existing path or one of {forms}")
    raise SourceError(
        f"{name!r} is neither a folder with rig.json nor an .mcap, nor a RealSense .bag or .db3; "
        f"tactune create-rig writes rig.json for a folder of images; known sources are {forms}"
    )
