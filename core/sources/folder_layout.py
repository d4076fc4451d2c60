"""Which images of a folder belong to which frame: our own layout, TUM's, BOP's, and folders of numbered files."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from ..errors import SourceError, counted
from ..model.arrays import Float64Array
from ..model.loading import read_file
from .base import PROXIMITY_NAMES, TACTILE_NAMES
from .cameras.pairing import nearest_within, period_s

#: Cameras whose names hold numbers, which are no frames'.
_MODELS: Final = "l515|d405"
IMAGE_SUFFIXES: Final = (".png", ".tif", ".tiff", ".npy", ".pgm", ".jpg", ".jpeg", ".bmp")
#: Files of these kinds are depth where no name says what they are.
_DEPTH_SUFFIXES: Final = (".npy", ".tif", ".tiff", ".pgm")
SLOTS: Final = ("proximity_depth", "proximity_color", "tactile_depth", "tactile_color")
#: Words in the names of files and folders, by what they say.
_WORDS: Final = {
    **dict.fromkeys(("depth", "depths", "depthmap", "dpt"), "depth"),
    **dict.fromkeys(("color", "colors", "colour", "rgb", "bgr", "image", "images", "img"), "color"),
    **dict.fromkeys(("gray", "grey", "mono", "ir", "infra", "infrared"), "gray"),
    **dict.fromkeys(PROXIMITY_NAMES, "proximity"),
    **dict.fromkeys(TACTILE_NAMES, "tactile"),
    **dict.fromkeys(("mask", "masks", "visib", "truth", "label", "labels", "seg", "normals", "confidence"), "other"),
    **dict.fromkeys(("untouched", "vis", "preview", "colormap", "colorized"), "other"),
}
_MAX_LIST_BYTES: Final = 20_000_000
#: Whole numbers of at least this many digits are times since 1970, in ms, us or ns.
_STAMP_DIGITS: Final = 13
_RATE_HZ: Final = 30.0


@dataclass(frozen=True)
class FrameFiles:
    """The images of one frame by slot, and its times; our own ``folder`` has ``frame.json`` and truth."""

    images: dict[str, Path]
    folder: Path | None = None
    proximity_time_s: float = 0.0
    tactile_time_s: float = 0.0


@dataclass(frozen=True)
class Layout:
    """The frames of a folder; ``unmatched`` depth images have no partner, ``counts_per_m`` is fixed by some layouts."""

    name: str
    frames: tuple[FrameFiles, ...]
    unmatched: int = 0
    counts_per_m: float | None = None

    @property
    def slots(self) -> tuple[str, ...]:
        """The slots of which any frame has an image."""
        return tuple(slot for slot in SLOTS if any(slot in frame.images for frame in self.frames))


def find_frames(path: Path) -> Layout:
    """Return the frames of a folder; `SourceError` says what it lacks."""
    numbered = [entry for entry in path.iterdir() if re.fullmatch("[0-9]+", entry.name) and entry.is_dir()]
    numbered.sort(key=lambda folder: int(folder.name))
    single = own_images(path)
    ours = numbered and own_images(numbered[0])
    if single and ours:
        raise SourceError(f"{path} has images and numbered subfolders ({numbered[0].name}); keep one of the two")
    if single or ours:
        folders = [path] if single else numbered
        frames = tuple(
            FrameFiles(own_images(folder), folder, index / _RATE_HZ, index / _RATE_HZ)
            for index, folder in enumerate(folders)
        )
        return Layout("frames by folder", frames)
    return _foreign(path)


def own_images(folder: Path) -> dict[str, Path]:
    """Return the images of a frame that lie in a folder under the names of our own layout."""
    found: dict[str, Path] = {}
    for entry in folder.iterdir():
        if entry.stem in SLOTS and entry.suffix.lower() in IMAGE_SUFFIXES:
            if entry.stem in found:
                raise SourceError(f"{folder} has {found[entry.stem].name} and {entry.name}; remove one")
            found[entry.stem] = entry
    return found


@dataclass(frozen=True)
class _Image:
    path: Path
    number: int | None
    stamp_s: float | None


def _foreign(path: Path) -> Layout:
    listed = _lists(path)
    found: dict[str, list[_Image]] = {}
    for file in _image_files(path):
        if (slot := _slot(file.relative_to(path))) is not None:
            found.setdefault(slot, []).append(_keyed(file, path, listed))
    for role in ("proximity", "tactile"):
        gray = found.pop(f"{role}_gray", None)  # of an infrared camera, beside a colour camera or in its place
        if gray is not None:
            found.setdefault(f"{role}_color", gray)
    for slot, images in found.items():
        stamped = [image for image in images if image.path in listed]
        found[slot] = _ordered(stamped or images)
    if not any(slot.endswith("depth") for slot in found):
        raise SourceError(
            f"{path} has no frames: neither proximity_depth.png, nor numbered subfolders such as 000000 with one, nor "
            "images in folders or files named depth; open the folder in which depth and rgb lie"
        )
    if "tactile_depth" not in found and "prox" in str(found["proximity_depth"][0].path.relative_to(path)).lower():
        raise SourceError(
            f"{path} has depth of the proximity camera only; copy the other's, or name that of the only camera depth"
        )
    if "proximity_depth" not in found:  # the only camera
        found = {slot.replace("tactile", "proximity"): images for slot, images in found.items()}
    is_tum = any(image.path in listed for image in found["proximity_depth"])
    is_bop = (path / "scene_camera.json").is_file()
    name = "TUM" if is_tum else "BOP" if is_bop else "numbered files"
    return _paired(path, name, found)


def _paired(path: Path, name: str, found: dict[str, list[_Image]]) -> Layout:
    """Return frames of the images that belong together: by time, at most half a period apart, or by number."""
    first = found["proximity_depth"]
    kept = list(range(len(first)))
    partners: dict[str, list[int]] = {}
    unmatched = 0
    if "tactile_depth" in found:
        there, back = _partners(first, found["tactile_depth"]), _partners(found["tactile_depth"], first)
        kept = [index for index, other in enumerate(there) if other >= 0 and back[other] == index]
        unmatched = len(first) + len(found["tactile_depth"]) - 2 * len(kept)
        if not kept:
            raise SourceError(
                f"{path}: none of the {counted(len(first), 'depth image')} of proximity ({first[0].path.name}, …) has "
                f"a partner of tactile ({found['tactile_depth'][0].path.name}, …) by number or time; rename them"
            )
        partners["tactile_depth"] = [there[index] for index in kept]
    depth = {"proximity": [first[index] for index in kept]}
    depth["tactile"] = [found["tactile_depth"][index] for index in partners.get("tactile_depth", ())]
    for role, images in depth.items():
        if images and f"{role}_color" in found:
            partners[f"{role}_color"] = _partners(images, found[f"{role}_color"])
    frames = []
    for index, image in enumerate(depth["proximity"]):
        chosen = {slot: found[slot][each[index]].path for slot, each in partners.items() if each[index] >= 0}
        stamp = index / _RATE_HZ if image.stamp_s is None else image.stamp_s
        second = depth["tactile"][index].stamp_s if depth["tactile"] else None
        frames.append(
            FrameFiles({"proximity_depth": image.path, **chosen}, None, stamp, stamp if second is None else second)
        )
    return Layout(name, tuple(frames), unmatched, 5000.0 if name == "TUM" else None)


def _partners(images: Sequence[_Image], others: Sequence[_Image]) -> list[int]:
    """Return the index of the image of another camera that belongs to each image, by time or number, or -1."""
    times, their_times = _stamps_s(images), _stamps_s(others)
    if times is not None and their_times is not None:
        return list(nearest_within(times, their_times, period_s(their_times) / 2).tolist())
    place = {image.number: index for index, image in enumerate(others)}
    return [place.get(image.number, -1) for image in images]


def _stamps_s(images: Iterable[_Image]) -> Float64Array | None:
    stamps = [image.stamp_s for image in images]
    return None if None in stamps else np.array(stamps, np.float64)


def _image_files(path: Path) -> list[Path]:
    """Return the images in a folder and in two levels below it."""
    files: list[Path] = []
    for folder, below, names in os.walk(path):
        depth = len(Path(folder).relative_to(path).parts)
        below[:] = sorted(name for name in below if not name.startswith(".") and depth < 2)
        files += [Path(folder, name) for name in names if name.lower().endswith(IMAGE_SUFFIXES) and name[0] != "."]
    return files


def _slot(relative: Path) -> str | None:
    """Return the slot that the names of a file and of its folders tell, the file's own name first."""
    kind, role = None, "proximity"
    for part in reversed(relative.with_suffix("").parts):
        meanings = [_WORDS[word] for word in re.findall(f"{_MODELS}|[a-z]+", part.lower()) if word in _WORDS]
        if "other" in meanings:
            return None
        kind = kind or next((word for word in meanings if word in ("depth", "color", "gray")), None)
        role = next((word for word in meanings if word in ("proximity", "tactile")), role)
    if kind is None and relative.suffix.lower() in _DEPTH_SUFFIXES:
        kind = "depth"
    return None if kind is None else f"{role}_{kind}"


def _keyed(file: Path, root: Path, listed: dict[Path, float]) -> _Image:
    """Return a file with its number, the last one in its name or its folders', and the time that the name is."""
    numbers = re.findall("[0-9]+", re.sub(_MODELS, "", str(file.relative_to(root).with_suffix("")).lower()))
    number = int(numbers[-1]) if numbers and len(numbers[-1]) <= 19 else None
    stamp = listed.get(file)
    if stamp is None and re.fullmatch(r"[0-9]{1,12}\.[0-9]{1,9}", file.stem):
        stamp = float(file.stem)
    elif stamp is None and number is not None and len(file.stem) >= _STAMP_DIGITS and file.stem.isdigit():
        stamp = number / 10.0 ** (len(file.stem) - 10)
    return _Image(file, number, stamp)


def _ordered(images: list[_Image]) -> list[_Image]:
    """Return images in the order of time or number; `SourceError` if two are of the same."""
    by_time = _stamps_s(images) is not None
    images = sorted(images, key=lambda image: (image.stamp_s if by_time else image.number) or 0)
    for one, other in pairwise(images):
        if not by_time and one.number == other.number:
            raise SourceError(
                f"{one.path} and {other.path} would be the same image of one frame; number them, keep one, open the "
                "folder of one, or name the folders of two cameras proximity and tactile"
            )
    return images


def _lists(path: Path) -> dict[Path, float]:
    """Return the times of the images that TUM's lists name, lines such as ``1305031102.175304 rgb/1305031102.png``."""
    stamps: dict[Path, float] = {}
    for file in sorted(path.glob("*.txt")):
        try:
            lines = read_file(file, _MAX_LIST_BYTES).decode("utf-8-sig").splitlines()
        except (OSError, UnicodeDecodeError):
            continue  # a text that is no list
        for line in lines:
            words = line.split("#")[0].replace(",", " ").split()
            for time, name in pairwise(words):
                if name.lower().endswith(IMAGE_SUFFIXES) and re.fullmatch(r"[0-9]{1,12}(\.[0-9]*)?", time):
                    stamps[path / name] = float(time)
    return stamps
