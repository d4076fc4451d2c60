"""Sources by name: ``sim:cup``, ``folder:PATH``, ``bag:PATH`` or just a path.

A kind of source is one `SourceKind`. Other packages add theirs by an entry point in the group ``tactune.sources``.
"""

from __future__ import annotations

from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from ..errors import SourceError, closed_on_error, foreign
from ..model.files import path_exists, recording_files, user_path
from ..model.plugins import added_by_others
from .base import FrameSource, Progress, SourceKind, split_topics
from .folder_layout import find_frames

if TYPE_CHECKING:
    from ..preset import CamerasSection
    from .ros.recording import Inspection

GROUP = "tactune.sources"


def _open_simulator(rest: str, progress: Progress | None, _: CamerasSection | None) -> FrameSource:
    from .simulator.scenes import read_name  # not above: it compiles kernels' modules
    from .simulator.simulator_source import SimulatorSource

    return SimulatorSource(progress=progress, **read_name(rest))


def _open_folder(rest: str, progress: Progress | None, _: CamerasSection | None) -> FrameSource:
    from .folder import FolderSource

    return FolderSource(rest)


def _open_cameras(rest: str, progress: Progress | None, cameras: CamerasSection | None) -> FrameSource:
    from .cameras.camera_source import open_in_process

    return open_in_process(rest, progress, cameras)


def _open_as_live(rest: str, progress: Progress | None, _: CamerasSection | None) -> FrameSource:
    from .capture.process_source import ProcessSource

    if not rest:
        raise SourceError("live: needs another source, as in live:sim")
    return ProcessSource(partial(_play_as_live, rest), progress)


def _play_as_live(name: str, progress: Progress) -> FrameSource:
    """Open a recording in the capture process and play it as if it were live."""
    from .play_as_live import PlayAsLive

    source = open_source(name, progress)
    with closed_on_error(source.close):
        return PlayAsLive(source)


def _open_recording(scheme: str, rest: str, progress: Progress | None, _: CamerasSection | None) -> FrameSource:
    from .tactune_files import McapSource, is_ours

    topics, paths = split_topics(rest)[1], rest.split(",")
    if not topics and len(paths) > 1 and all(path.endswith(".mcap") and is_ours(path) for path in paths):
        raise SourceError(f"{rest}: these are recordings of Tactune; open one at a time")
    if scheme == "bag" and rest.endswith(".mcap"):
        scheme = "mcap"
    if topics or _is_of_others(scheme, rest):
        from .ros.recording import RosSource

        return RosSource(scheme, rest, progress)
    if scheme == "bag":
        from .realsense_files import BagSource

        return BagSource(rest, progress)
    return McapSource(rest, progress)


def _recordings(scheme: str, title: str, form: str, needs: Literal["folder", "file"], pattern: str) -> SourceKind:
    opener = partial(_open_recording, scheme)
    return SourceKind(scheme, title, form, opener, needs, pattern, files=2 if needs == "file" else 1)


def _is_of_others(scheme: str, rest: str) -> bool:
    """Whether a recording is a ROS program's, neither librealsense's nor Tactune's own."""
    from .realsense_files import is_realsense
    from .tactune_files import is_ours

    return scheme == "rosbag" or not (is_realsense(rest) if scheme == "bag" else is_ours(rest))


def _open_ros2(rest: str, progress: Progress | None, cameras: CamerasSection | None) -> FrameSource:
    from .ros.live import open_in_process

    return open_in_process(rest, progress, cameras)


_ROS_FOLDER: Final = "metadata.yaml *_0.mcap *_0.db3 *_0.mcap.zstd *_0.db3.zstd"
_OWN: Final = {
    kind.scheme: kind
    for kind in (
        SourceKind("sim", "Simulator", "sim:SCENE", _open_simulator),
        SourceKind("folder", "Folder of images", "folder:PATH", _open_folder, "folder", "rig.json"),
        _recordings("bag", "RealSense or ROS recording", "bag:PATH[,PATH]", "file", "*.bag *.db3"),
        _recordings("mcap", "Tactune or ROS recording", "mcap:PATH[,PATH]", "file", "*.mcap"),
        _recordings("rosbag", "Folder of ros2 bag record", "rosbag:PATH", "folder", _ROS_FOLDER),
        SourceKind("cameras", "Cameras", "cameras:[PROXIMITY,TACTILE]", _open_cameras),
        SourceKind("ros2", "Live ROS 2 topics", "ros2:[?domain=N]", _open_ros2),
        SourceKind("live", "Any source, played live", "live:SOURCE", _open_as_live),
    )
}


def source_kinds() -> tuple[SourceKind, ...]:
    """Return every kind of source that can be loaded: our own, then those of other packages."""
    added = [kind for kind in added_by_others(GROUP, SourceKind)[0].values() if kind.scheme not in _OWN]
    return (*_OWN.values(), *added)


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
    try:
        kind, rest = _resolved(name)
        if kind.needs != "nothing" and not rest:
            raise SourceError(f"{kind.scheme}: needs a path, as in {kind.form}")
        if kind.needs != "nothing" and (missing := missing_path(name)) is not None:  # before anything is imported
            raise SourceError(f"{name}: there is no {kind.needs} {missing}; check the path")
        return kind.open(rest, progress, cameras)
    except OSError as error:
        raise SourceError(f"cannot open {foreign(name)}: {error.strerror or error}; check the path") from error


def topics_to_choose(name: str, progress: Progress | None = None) -> Inspection | None:
    """Return what there is to choose before another program's recording is opened; None if nothing."""
    from .ros.recording import inspect_recording

    kind, rest = _resolved(name)
    is_here = path_exists(rest) or bool(recording_files(rest))
    if not is_here or split_topics(rest)[1] or kind.scheme not in ("bag", "mcap", "rosbag"):
        return None
    return inspect_recording(rest, progress) if _is_of_others(kind.scheme, rest) else None


def images_without_rig(name: str) -> tuple[Path, tuple[str, ...]] | None:
    """Return the folder that a name means and the slots of its images, if it has no ``rig.json``; else None."""
    named, rest = _named(name)
    path = user_path(rest)
    if named not in (None, _OWN["folder"]) or not path.is_dir():
        return None
    if any(kind.needs == "folder" and kind.claim(str(path)) is not None for kind in source_kinds()):
        return None
    try:
        return path, find_frames(path).slots
    except SourceError:  # opening it tells what it lacks
        return None


def opens_by_name(name: str) -> bool:
    """Return whether `open_source` knows the kind of a source's name; a program may make sources of its own."""
    return _named(name)[0] is not None


def missing_path(name: str) -> Path | None:
    """Return the file or folder that a source's name needs and that does not exist, else None."""
    kind, rest = _named(name)
    if kind is _OWN["live"] and rest:
        return missing_path(rest)
    rest = split_topics(rest)[0]
    if (kind is not None and kind.needs == "nothing") or path_exists(rest) or recording_files(rest):
        return None
    parts = [rest] if kind is None else rest.split(",")
    return next((user_path(part) for part in parts if not path_exists(part)), user_path(rest))


def _named(name: str) -> tuple[SourceKind | None, str]:
    """Return the kind that a name's scheme says, and the rest of the name; None and all of it without a scheme."""
    scheme, _, rest = name.partition(":")
    kind = next((kind for kind in source_kinds() if kind.scheme == scheme), None)
    return kind, name if kind is None else rest


def _resolved(name: str) -> tuple[SourceKind, str]:
    """Return the kind of a source, by its scheme or by what is at its path, and what is to be opened."""
    named, rest = _named(name)
    if named is not None:
        return named, rest
    kinds, problems = source_kinds(), added_by_others(GROUP, SourceKind)[1]
    name, topics = split_topics(name)
    for kind in kinds:
        if name and (path := kind.claim(name)) is not None:
            return kind, path + topics
    forms = "; ".join([", ".join(kind.form for kind in kinds), *problems.values()])
    if name and user_path(name).exists():
        raise SourceError(
            f"{name!r} is neither a folder with rig.json or metadata.yaml nor an .mcap, .bag or .db3; "
            f"tactune preset create-rig {name} writes rig.json for a folder of images, or says why not"
        )
    scheme = name.partition(":")[0]
    if scheme in problems:
        raise SourceError(problems[scheme])
    if ":" not in name and (Path(name).suffix or "/" in name):
        raise SourceError(f"{name!r} is no source: there is no such file or folder; check the path")
    near = get_close_matches(scheme, [kind.scheme for kind in kinds], 1)
    meant = f"did you mean {near[0]}? Else " if near else ""
    raise SourceError(f"{name!r} is no source: {meant}give an existing path or one of {forms}")
