"""Sources by name: ``sim:cup``, ``folder:PATH``, ``bag:PATH`` or just a path.

A new kind of source, live or recorded, is one more entry in ``_KINDS``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal
from urllib.parse import parse_qsl

from ..errors import SourceError
from ..model.files import user_path
from .base import FrameSource, Progress
from .realsense_files.names import SUFFIXES, recording_files

if TYPE_CHECKING:
    from ..preset import CamerasSection

SCENES = ("cube", "cup", "octopus")
#: Further scenes of the simulator, and the options that any of them takes.
MORE_SCENES = ("two", "knobs", "star", "mug", "hand", "hover", "stiff", "wrinkled", "slide")
SCENE_OPTIONS = ("press", "side", "object", "gap", "grid", "light", "seed", "noise")
_DEFAULT_SCENE = "cup"


@dataclass(frozen=True)
class SourceKind:
    """One kind of source, as help texts and menus need it.

    Attributes
    ----------
    scheme : str
        What stands before the colon of a name.
    form : str
        How a name is written.
    needs : {"nothing", "folder", "file"}
        What a person has to point at to open one.
    pattern : str
        Names of the files that it opens, such as ``"*.bag *.db3"``; empty where it opens none.
    examples : tuple of str
        Names that can be offered as they are.
    """

    scheme: str
    title: str
    form: str
    description: str
    needs: Literal["nothing", "folder", "file"]
    pattern: str = ""
    examples: tuple[str, ...] = ()


def source_kinds() -> tuple[SourceKind, ...]:
    """Return every kind of source that `open_source` can open, the default first."""
    return tuple(kind for kind, _ in _KINDS.values())


def open_source(name: str, progress: Progress | None = None, cameras: CamerasSection | None = None) -> FrameSource:
    """Open a source by its name.

    Parameters
    ----------
    name : str
        ``"sim"``, ``"sim:cup?seed=3&noise=0.5"``, ``"folder:PATH"``, ``"bag:PATH"``, or a path whose
        kind is plain: a folder with ``rig.json``, that file itself, an ``.mcap``, a ``.bag`` or
        ``.db3``, or two of the latter with a comma between them.
    progress : callable, optional
        Told the share done, 0 to 1, and what is being done, where opening takes long.
    cameras : CamerasSection, optional
        The preset's section ``cameras``: which devices ``realsense:`` opens, and their options.

    Raises
    ------
    SourceError
        Unknown kind, scene or option, nothing at that path, or unreadable; the message says what to do.
    """
    try:
        scheme, _, rest = name.partition(":")
        if scheme not in _KINDS:
            scheme, rest = _guess(name)
        if scheme == "realsense":
            return _open_realsense(rest, progress, cameras)
        _, opener = _KINDS[scheme]
        return opener(rest, progress)
    except OSError as error:
        raise SourceError(f"cannot open {name}: {error.strerror or error}; check the path") from error


def _guess(name: str) -> tuple[str, str]:
    """Return the scheme and path of a name without a scheme."""
    forms = ", ".join(kind.form for kind in source_kinds())
    path = user_path(name)
    if len(recording_files(name)) == 2:
        return "bag", name
    if not name or not path.exists():
        kind, colon, _ = name.partition(":")
        if colon and kind.isalnum() and len(kind) > 1:
            raise SourceError(f"{name!r}: there is no kind of source called {kind!r}; known are {forms}")
        raise SourceError(f"{name!r} is no source: nothing is at that path; give an existing path or one of {forms}")
    if path.suffix in SUFFIXES and path.is_file():
        return "bag", name
    if path.suffix == ".mcap" and path.is_file():
        return "mcap", name
    if (path / "rig.json").is_file():
        return "folder", name
    if path.name == "rig.json":
        return "folder", str(path.parent)
    raise SourceError(
        f"{name!r} is neither a folder with rig.json nor an .mcap, nor a RealSense .bag or .db3; "
        f"known sources are {forms}"
    )


def _open_simulator(rest: str, progress: Progress | None) -> FrameSource:
    """Open ``SCENE?seed=N&noise=X``; every part may be left out."""
    name = f"sim:{rest}"
    scene, _, query = rest.partition("?")
    scene = scene or _DEFAULT_SCENE
    if scene not in (*SCENES, *MORE_SCENES):
        raise SourceError(f"{name}: there is no scene {scene!r}; known are {', '.join((*SCENES, *MORE_SCENES))}")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise SourceError(f"{name}: {query!r} are no options; write them as seed=3&noise=0.5") from error
    options = dict(pairs)
    for key, _ in pairs:
        if key not in SCENE_OPTIONS:
            raise SourceError(f"{name}: the simulator has no option {key!r}; known are {', '.join(SCENE_OPTIONS)}")
        if [given for given, _ in pairs].count(key) > 1:
            raise SourceError(f"{name}: {key} is given twice; keep one")
    seed, noise = _seed(name, options.pop("seed", "0")), _number(name, "noise", options.pop("noise", "1"))
    from .simulator.source import SimulatorSource

    if not options:
        return SimulatorSource(scene=scene, seed=seed, noise=noise, progress=progress)
    from .simulator.scenes import read_options

    variant, light = read_options(name, options)
    return SimulatorSource(scene=scene, seed=seed, noise=noise, progress=progress, variant=variant, light=light)


def _seed(name: str, text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 10):
        raise SourceError(f"{name}: seed is {text!r}, but it must be a whole number from 0, such as seed=3")
    return int(text)


def _number(name: str, key: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0.0 <= number <= 100.0:
        raise SourceError(f"{name}: {key} is {text!r}, but it must be a number from 0 (none) to 100, such as {key}=0.5")
    return number


def _open_folder(rest: str, _: Progress | None) -> FrameSource:
    from .folder import FolderSource

    return FolderSource(_path("folder", rest))


def _open_bag(rest: str, progress: Progress | None) -> FrameSource:
    from .bag import BagSource

    return BagSource(_path("bag", rest), progress)


def _open_live(rest: str, progress: Progress | None) -> FrameSource:
    from .process import ProcessSource

    if not rest:
        raise SourceError("live: needs another source, as in live:sim")
    return ProcessSource(partial(_play_live, rest), progress)


def _play_live(name: str, progress: Progress) -> FrameSource:
    """Open a recording to be played as if it were live; runs in the capture process."""
    from .process.live import LiveLoop

    source = open_source(name, progress)
    try:
        return LiveLoop(source)
    except SourceError:
        source.close()
        raise


def _open_realsense(rest: str, progress: Progress | None, cameras: CamerasSection | None = None) -> FrameSource:
    """Open ``PROXIMITY,TACTILE``, the serial numbers of both cameras; without them the preset's, or the only ones."""
    from ..preset import CamerasSection
    from .process import ProcessSource

    chosen = cameras or CamerasSection()
    if rest:
        serials = rest.split(",")
        if len(serials) != 2 or not all(serials):
            raise SourceError(
                f"realsense:{rest}: give both serial numbers, as in realsense:f0090001,130322270002, or none"
            )
        for role, serial in zip(("proximity", "tactile"), serials, strict=True):
            chosen = chosen.model_copy(
                update={role: getattr(chosen, role).model_copy(update={"serial": serial.strip()})}
            )
    return ProcessSource(partial(_capture_realsense, chosen), progress)


def _capture_realsense(cameras: CamerasSection, progress: Progress) -> FrameSource:
    """Open the cameras; runs in the capture process."""
    from .realsense.source import RealSenseSource

    return RealSenseSource(cameras, progress=progress)


def _open_mcap(rest: str, progress: Progress | None) -> FrameSource:
    from .mcap.source import McapSource

    return McapSource(_path("mcap", rest), progress)


def _path(scheme: str, rest: str) -> str:
    if not rest:
        raise SourceError(f"{scheme}: needs a path, as in {_KINDS[scheme][0].form}")
    return rest


_Opener = Callable[[str, Progress | None], FrameSource]
_KINDS: dict[str, tuple[SourceKind, _Opener]] = {
    "sim": (
        SourceKind(
            scheme="sim",
            title="Simulator",
            form="sim:SCENE[?press=medium&seed=N&noise=X]",
            description=(
                f"A simulated sensor with ground truth, pressed by an object: {', '.join(SCENES)}, two; mug and hand, "
                "held out for judging methods. hover (gap=1...20 mm away), stiff (regions 8 times as stiff), wrinkled "
                "(folds of a twist) and slide take object=cup. press=low, medium or high holds a press, high at "
                "side=right or left, press=none shows the untouched membrane; grid=dots prints dots 10 mm apart; "
                "light=bright or dim; noise=0, 1 or 2."
            ),
            needs="nothing",
            examples=tuple(f"sim:{scene}" for scene in SCENES),
        ),
        _open_simulator,
    ),
    "folder": (
        SourceKind(
            scheme="folder",
            title="Folder of images",
            form="folder:PATH",
            description="PNG images with rig.json beside them: one frame, or numbered subfolders.",
            needs="folder",
            pattern="rig.json",
        ),
        _open_folder,
    ),
    "bag": (
        SourceKind(
            scheme="bag",
            title="RealSense recording",
            form="bag:PATH[,PATH]",
            description="A RealSense .bag or .db3 of two depth cameras, two files of one each, or one to view only.",
            needs="file",
            pattern="*.bag *.db3",
        ),
        _open_bag,
    ),
    "mcap": (
        SourceKind(
            scheme="mcap",
            title="Tactune recording",
            form="mcap:PATH",
            description="A recording in MCAP, as tactune record writes it: a ROS 2 bag with both cameras.",
            needs="file",
            pattern="*.mcap",
        ),
        _open_mcap,
    ),
    "realsense": (
        SourceKind(
            scheme="realsense",
            title="RealSense cameras",
            form="realsense:[PROXIMITY,TACTILE]",
            description="A live L515 and a D405, captured in a process of their own; with serial numbers, those.",
            needs="nothing",
            examples=("realsense:",),
        ),
        _open_realsense,
    ),
    "live": (
        SourceKind(
            scheme="live",
            title="Any source, played live",
            form="live:SOURCE",
            description="Plays a recording or the simulator over and over in real time, as cameras would give it.",
            needs="nothing",
            examples=("live:sim:cup",),
        ),
        _open_live,
    ),
}
