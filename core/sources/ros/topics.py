"""Which topic of a ROS recording is which image of the rig: what there is, a guess, and what a person says.

The guess reads types, encodings and names, as realsense-ros, OrbbecSDK_ROS2, depthai-ros and Tactune's own recordings
write them. Where it does not know, it says so and does not choose.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from ...errors import ExportError, SourceError, counted, foreign
from ...model.files import atomic_path, user_path
from ...model.loading import read_json
from ..base import PROXIMITY_NAMES, TACTILE_NAMES, split_topics
from ..ros_image import RawImage
from .messages import CAMERA_INFO, IMAGE, Bag

COMPRESSED: Final = "sensor_msgs/msg/CompressedImage"
#: What a person may name, as in ``proximity.depth=/camera/depth/image_rect_raw``; ``info`` may be a lens file, too.
SLOTS: Final = tuple(f"{role}.{what}" for role in ("proximity", "tactile") for what in ("depth", "color", "info"))

#: Parts of a name that say which stream of a camera it is. What is left names the camera.
_STREAM_WORDS: Final = {
    *("aligned", "align", "to", "depth", "color", "colour", "rgb", "ir", "infra", "infra1", "infra2", "infrared"),
    *("mono", "stereo", "image", "raw", "rect", "rectified", "registered", "sensor", "data"),
    *("compressed", "compressedDepth", "theora"),
}
_TRANSPORT = re.compile(r"/(compressed|compressedDepth)$")
_INFRARED: Final = frozenset(["ir", "infra", "infra1", "infra2", "infrared", "mono"])


@dataclass(frozen=True)
class ImageTopic:
    """One stream of images. ``info`` is the topic of its lens, or empty; ``frame`` the frame in its headers."""

    name: str
    type: str
    kind: Literal["depth", "color"]
    encoding: str
    width: int
    height: int
    count: int
    frame: str
    info: str

    @property
    def words(self) -> frozenset[str]:
        return frozenset(re.split(r"[/_]", self.name))

    @property
    def is_rectified(self) -> bool:
        """Whether the name says that image_pipeline, or the camera, has removed the distortion."""
        return not self.words.isdisjoint(("rect", "rectified"))

    @property
    def camera(self) -> str:
        return camera_of(self.name)

    def __str__(self) -> str:
        return f"{self.name} ({self.width} x {self.height}, {self.encoding}, {counted(self.count, 'image')})"


def camera_of(topic: str) -> str:
    """Return the part of a name that is the camera's, such as ``camera`` or ``left/d405``."""
    parts = ("_".join(w for w in part.split("_") if w not in _STREAM_WORDS) for part in topic.split("/"))
    return "/".join(filter(None, parts))


#: A topic for each of `SLOTS` that is used.
Topics = dict[str, str]
#: Returns the pose between two coordinate frames, or None.
Pose = Callable[[str, str], object]


def survey(bag: Bag) -> tuple[ImageTopic, ...]:
    """Return the image streams of a recording, by name; those that are no images are left out."""
    infos = {topic for topic, kind in bag.types.items() if kind == CAMERA_INFO}
    frames = {topic: bag.message(topic, 0).header.frame_id for topic in infos}
    found = []
    for topic in sorted(bag.types):
        if bag.types[topic] not in (IMAGE, COMPRESSED):
            continue
        try:
            message = bag.message(topic, 0)
            image = RawImage.of(message)
        except (ValueError, SourceError):  # damaged, or of an encoding that is not known
            continue
        words = frozenset(re.split(r"[/_]", topic))
        says_depth = "depth" in words or "stereo" in words
        is_depth = image.is_depth and (says_depth or (image.encoding != "mono16" and not words & _INFRARED))
        kind: Literal["depth", "color"] = "depth" if is_depth else "color"
        frame, stated, count = message.header.frame_id, (image.encoding, image.width, image.height), bag.count(topic)
        info = _info_of(topic, frame, infos, frames)
        found.append(ImageTopic(topic, bag.types[topic], kind, *stated, count, frame, info))
    return tuple(found)


def unread_depth(images: Mapping[str, ImageTopic], types: Mapping[str, str], used: str) -> list[str]:
    """Return what is depth of another camera than ``used`` by its name, but has an encoding that cannot be read."""
    found = []
    for topic, kind in sorted(types.items()):
        if kind not in (IMAGE, COMPRESSED) or "depth" not in re.split(r"[/_]", topic):
            continue
        image = images.get(topic)
        if camera_of(topic) != camera_of(used) and (image is None or image.kind != "depth"):
            encoding = f" ({foreign(image.encoding, 40)!r})" if image is not None else ""
            found.append(foreign(topic, 60) + encoding)
    return found


def _info_of(topic: str, frame: str, infos: set[str], frames: Mapping[str, str]) -> str:
    """Return the topic of an image's lens: beside it, or else the only one of its frame."""
    plain = _TRANSPORT.sub("", topic)
    for candidate in (f"{plain.rpartition('/')[0]}/camera_info", f"{plain}/camera_info"):
        if candidate in infos:
            return candidate
    same = [info for info in sorted(infos) if frame and frames[info] == frame]
    return same[0] if len(same) == 1 else ""


def guess_topics(images: Sequence[ImageTopic], pose: Pose) -> tuple[Topics, str]:
    """Return the topics of a rig, or a clause about what is missing; a ``pose`` joins colour to its depth."""
    cameras: defaultdict[str, list[ImageTopic]] = defaultdict(list)
    for image in images:
        cameras[image.camera].append(image)
    with_depth = {name: group for name, group in cameras.items() if any(each.kind == "depth" for each in group)}
    if not with_depth:
        return {}, "no topic has depth images"
    roles = _roles(list(with_depth))
    if roles is None:
        if len(with_depth) == 1:
            return {}, "it has depth of the proximity camera only, that of the tactile camera is missing"
        return {}, "its names do not say which camera is proximity and which is tactile"
    topics: Topics = {}
    for role, name in roles.items():
        depth, color = _streams(with_depth[name], pose)
        topics[f"{role}.depth"] = depth.name
        if color is not None:
            topics[f"{role}.color"] = color.name
    return topics, ""


def _roles(cameras: list[str]) -> dict[str, str] | None:
    """Return the camera of each role, by their names; None if these do not tell it."""
    if len(cameras) == 1:
        return None if "prox" in cameras[0].lower() else {"tactile": cameras[0]}
    near = [name for name in cameras if any(word in name.lower() for word in PROXIMITY_NAMES)]
    touch = [name for name in cameras if any(word in name.lower() for word in TACTILE_NAMES)]
    if len(cameras) == 2:  # the other one is the other camera
        near = near or [name for name in cameras if name not in touch]
        touch = touch or [name for name in cameras if name not in near]
    if len(near) == len(touch) == 1 and near != touch:
        return {"proximity": near[0], "tactile": touch[0]}
    return None


def _streams(group: Sequence[ImageTopic], pose: Pose) -> tuple[ImageTopic, ImageTopic | None]:
    """Return the depth and the colour of one camera: raw before compressed, in the camera's own frame if possible."""

    def depth_rank(image: ImageTopic) -> tuple[bool, ...]:
        words = image.words
        return ("aligned" in words or "registered" in words, "compressedDepth" in words, "rect" not in words)

    def color_rank(image: ImageTopic) -> tuple[bool, ...]:
        words = image.words
        return (bool(words & _INFRARED), not words & {"color", "colour", "rgb"}, "compressed" in words)

    depths = sorted((image for image in group if image.kind == "depth"), key=depth_rank)
    colors = sorted((image for image in group if image.kind == "color"), key=color_rank)
    for color in colors:
        for depth in depths:
            if depth.frame == color.frame or pose(depth.frame, color.frame) is not None:
                return depth, color
    return depths[0], None


def complete_topics(chosen: Topics, guess: Topics, images: Sequence[ImageTopic], pose: Pose) -> tuple[Topics, str]:
    """Return the topics that a person named with what follows from them, and a clause that says what is missing."""
    topics = dict(chosen) if any(slot.endswith(".depth") for slot in chosen) else guess | chosen
    for role in ("proximity", "tactile"):
        if any(slot.startswith(f"{role}.") for slot in topics) and f"{role}.depth" not in topics:
            return topics, f"--topics names no {role}.depth"
        depth = [image for image in images if image.name == topics.get(f"{role}.depth")]
        if depth and f"{role}.color" not in topics:
            group = [image for image in images if image.kind == "color" and image.camera == depth[0].camera]
            if (color := _streams([*depth, *group], pose)[1]) is not None:
                topics[f"{role}.color"] = color.name
    if topics.get("proximity.depth") == topics.get("tactile.depth") is not None:
        return topics, "--topics names one topic as the depth of both cameras"
    return topics, "" if "tactile.depth" in topics else "--topics names no tactile.depth"


def split_name(name: str) -> tuple[str, Topics]:
    """Return a source's name without the topics at its end, ``?proximity.depth=/a,tactile.depth=/b``, and these."""
    plain, topics = split_topics(name)
    return plain, parse_topics(topics[1:])


def parse_topics(text: str) -> Topics:
    """Return the topics that a person names, with commas between; `SourceError` names what is wrong."""
    topics: Topics = {}
    # a comma that no slot follows belongs to the path of a lens
    for part in filter(None, (part.strip(" ,") for part in re.split(",(?=[^,/=]*=)", text))):
        slot, _, topic = (word.strip() for word in part.partition("="))
        is_file = slot.endswith(".info") and topic and not topic.startswith("/")
        if slot not in SLOTS or slot in topics or not (topic.startswith("/") or is_file):
            raise SourceError(
                f"the topics say {foreign(part)!r}; write proximity.depth=/a/topic, each once, with commas between; "
                f"known are {', '.join(SLOTS)}"
            )
        topics[slot] = str(user_path(topic).resolve()) if is_file else topic  # it is kept for other folders, too
    return topics


def stored_path(recording: Path) -> Path:
    """Return the file beside a recording that keeps its topics."""
    return recording / "topics.json" if recording.is_dir() else recording.with_name(f"{recording.name}.topics.json")


def load_topics(recording: Path) -> Topics:
    """Return the topics that were chosen for a recording before; empty if none were."""
    path = stored_path(recording)
    if not path.is_file():
        return {}
    try:
        found = read_json(path)
        return parse_topics(",".join(f"{slot}={topic}" for slot, topic in found.items()))
    except (OSError, ValueError, AttributeError) as error:
        raise SourceError(f"{path} names no topics ({foreign(error)}); correct or remove it") from error


def store_topics(recording: Path, topics: Topics) -> None:
    """Keep the topics beside a recording, unless nothing can be written there."""
    with suppress(ExportError), atomic_path(stored_path(recording)) as temporary:
        temporary.write_text(json.dumps(topics, indent=2) + "\n", "utf-8")


def list_topics(images: Sequence[ImageTopic], types: Mapping[str, str]) -> str:
    """Return what a recording has, for the end of a message."""
    if images:
        known = {image.name for image in images}
        rest = [topic for topic, kind in sorted(types.items()) if kind in (IMAGE, COMPRESSED) and topic not in known]
        unread = f"; not readable: {', '.join(foreign(topic, 60) for topic in rest[:4])}" if rest else ""
        return "its images: " + "; ".join(map(str, images[:8])) + ("; …" if len(images) > 8 else "") + unread
    names = ", ".join(f"{foreign(topic, 60)} ({foreign(kind, 60)})" for topic, kind in sorted(types.items())[:8])
    return f"its topics: {names}" if names else "it has no messages"
