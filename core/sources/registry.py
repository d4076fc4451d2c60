"""Sources by name: ``sim:cup``, ``folder:PATH``, ``bag:PATH`` or just a path.

A kind of source is one `SourceKind`. Other packages add theirs by an entry point in the group ``tactune.sources``.
"""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import SourceError, foreign
from ..model.files import path_exists, recording_files, user_path
from ..model.plugins import added_by_others
from .base import FrameSource, Progress, SourceKind, split_topics
from .folder_layout import find_frames

if TYPE_CHECKING:
    from ..preset import CamerasSection
    from .ros.source import Inspection

GROUP = "tactune.sources"


def _open_live(rest: str, progress: Progress | None, _: CamerasSection | None) -> FrameSource:
    from .capture.source import ProcessSource

    if not rest:
        raise SourceError("live: needs another source, as in live:sim")
    return ProcessSource(partial(_play_live, rest), progress)


def _play_live(name: str, progress: Progress) -> FrameSource:
    """Open a recording in the capture process and play it as if it were live."""
    from .capture.live import LiveLoop

    source = open_source(name, progress)
    try:
        return LiveLoop(source)
    except SourceError:
        source.close()
        raise


def _open_recording(scheme: str, rest: str, progress: Progress | None, _: CamerasSection | None) -> FrameSource:
    if split_topics(rest)[1] or _is_of_others(scheme, rest):
        from .ros.source import RosSource

        return RosSource(scheme, rest, progress)
    if scheme == "bag":
        from .realsense_files import BagSource

        return BagSource(rest, progress)
    from .mcap.source import McapSource

    return McapSource(rest, progress)


def _is_of_others(scheme: str, rest: str) -> bool:
    """Whether a recording is a ROS program's, neither librealsense's nor Tactune's own."""
    from .mcap.source import is_ours
    from .realsense_files import is_realsense

    return scheme == "rosbag" or not (is_realsense(rest) if scheme == "bag" else is_ours(rest))


def _open_ros2(rest: str, progress: Progress | None, cameras: CamerasSection | None) -> FrameSource:
    from .ros.live import open_in_process

    return open_in_process(rest, progress, cameras)


_BAG = SourceKind(
    scheme="bag",
    title="RealSense or ROS recording",
    form="bag:PATH[,PATH]",
    needs="file",
    pattern="*.bag *.db3",
    files=2,
    open=partial(_open_recording, "bag"),
)
_ROS_FOLDER = SourceKind(
    scheme="rosbag",
    title="Folder of ros2 bag record",
    form="rosbag:PATH",
    needs="folder",
    pattern="metadata.yaml *_0.mcap *_0.db3 *_0.mcap.zstd *_0.db3.zstd",
    open=partial(_open_recording, "rosbag"),
)
_MCAP = SourceKind(
    scheme="mcap",
    title="Tactune or ROS recording",
    form="mcap:PATH[,PATH]",
    needs="file",
    pattern="*.mcap",
    files=2,
    open=partial(_open_recording, "mcap"),
)
_ROS2 = SourceKind(
    scheme="ros2",
    title="Live ROS 2 topics",
    form="ros2:[?domain=N]",
    open=_open_ros2,
)
_LIVE = SourceKind(
    scheme="live",
    title="Any source, played live",
    form="live:SOURCE",
    open=_open_live,
)


@cache
def _own_kinds() -> dict[str, SourceKind]:
    from . import cameras, folder, simulator

    kinds = (simulator.KIND, folder.KIND, _BAG, _MCAP, _ROS_FOLDER, cameras.KIND, cameras.REALSENSE, _ROS2, _LIVE)
    return {kind.scheme: kind for kind in kinds}


def source_kinds() -> tuple[SourceKind, ...]:
    """Return every kind of source that can be loaded: our own, then those of other packages."""
    own = _own_kinds()
    added = [kind for kind in added_by_others(GROUP, SourceKind)[0].values() if kind.scheme not in own]
    return (*own.values(), *added)


def open_source(name: str, progress: Progress | None = None, cameras: CamerasSection | None = None) -> FrameSource:
    """Open a source by its name.

    Parameters
    ----------
    name : str
        ``"sim"``, ``"sim:cup?seed=3&noise=0.5"``, ``"folder:PATH"``, ``"bag:PATH"``, or a path whose kind is plain:
        a folder with ``rig.json``, an ``.mcap``, a ``.bag`` or ``.db3``, or two of the latter with a comma between.
    progress : callable, optional
        Receives the fraction done, 0 to 1, and the current step, where opening takes long.
    cameras : CamerasSection, optional
        The preset's section ``cameras``: which devices live sources open, and their options.

    Raises
    ------
    SourceError
        Nothing has that name, or it cannot be read; the message says what to do.
    """
    scheme, _, rest = name.partition(":")
    try:
        kind = _kind(scheme)
        if kind is None:
            kind, rest = _guess(name)
        if kind.needs != "nothing" and not rest:
            raise SourceError(f"{kind.scheme}: needs a path, as in {kind.form}")
        if kind.needs != "nothing" and (missing := missing_path(name)) is not None:  # before anything is imported
            raise SourceError(f"{name}: there is no {kind.needs} {missing}; check the path")
        return kind.open(rest, progress, cameras)
    except OSError as error:
        raise SourceError(f"cannot open {foreign(name)}: {error.strerror or error}; check the path") from error


def topics_to_choose(name: str, progress: Progress | None = None) -> Inspection | None:
    """Return what there is to choose before another program's recording is opened; None if nothing."""
    from .ros.source import inspect_recording

    scheme, _, rest = name.partition(":")
    if _kind(scheme) is None:
        kind, rest = _guess(name)
        scheme = kind.scheme
    if (
        split_topics(rest)[1]
        or not (path_exists(rest) or recording_files(rest))
        or scheme not in ("bag", "mcap", "rosbag")
    ):
        return None
    if not _is_of_others(scheme, rest):
        return None
    return inspect_recording(rest, progress)


def images_without_rig(name: str) -> tuple[Path, tuple[str, ...]] | None:
    """Return the folder that a name means and the slots of its images, if it has no ``rig.json``; else None."""
    scheme, _, rest = name.partition(":")
    path = user_path(rest if scheme == "folder" else name)
    if (_kind(scheme) is not None and scheme != "folder") or not path.is_dir():
        return None
    kinds = (kind for kind in source_kinds() if kind.needs == "folder")
    if any(kind.claim(str(path)) is not None for kind in kinds):
        return None
    try:
        return path, find_frames(path).slots
    except SourceError:  # opening it tells what it lacks
        return None


def opens_by_name(name: str) -> bool:
    """Return whether `open_source` knows the kind of a source's name; a program may make sources of its own."""
    return _kind(name.partition(":")[0]) is not None


def missing_path(name: str) -> Path | None:
    """Return the file or folder that a source's name needs and that does not exist, else None."""
    scheme, colon, rest = name.partition(":")
    if scheme == "live" and colon:
        return missing_path(rest)
    kind = _kind(scheme)
    name, rest = split_topics(name)[0], split_topics(rest)[0]
    if kind is None:
        return None if path_exists(name) or recording_files(name) else user_path(name)
    if kind.needs == "nothing" or path_exists(rest) or recording_files(rest):
        return None
    return next((user_path(part) for part in rest.split(",") if not path_exists(part)), user_path(rest))


def _kind(scheme: str) -> SourceKind | None:
    return next((kind for kind in source_kinds() if kind.scheme == scheme), None)


def _guess(name: str) -> tuple[SourceKind, str]:
    kinds, problems = source_kinds(), added_by_others(GROUP, SourceKind)[1]
    name, topics = split_topics(name)
    for kind in kinds:
        if name and (rest := kind.claim(name)) is not None:
            return kind, rest + topics
    forms = "; ".join([", ".join(kind.form for kind in kinds), *problems.values()])
    if name and user_path(name).exists():
        raise SourceError(
            f"{name!r} is neither a folder with rig.json or metadata.yaml nor an .mcap, .bag or .db3; "
            f"tactune preset create-rig writes rig.json for a folder of images; known sources are {forms}"
        )
    scheme = name.partition(":")[0]
    if scheme in problems:
        raise SourceError(problems[scheme])
    raise SourceError(f"{name!r} is no source: nothing is at that path; give an existing path or one of {forms}")
