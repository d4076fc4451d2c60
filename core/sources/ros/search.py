"""Finds the topics of live cameras in a ROS 2 domain."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from ...errors import SourceError, foreign
from ...model.arrays import Int64Array
from ..base import Progress
from ..mcap.bag import Bag
from ..mcap.messages import CAMERA_INFO, IMAGE, TRANSFORMS
from .dds import Listener, Reader
from .source import Frames
from .topics import COMPRESSED, ImageTopic, Topics, guess_topics, list_topics, survey

#: Longest search, seconds, and how long nothing further may appear before it ends.
_SEARCH_S: Final = 6.0
_SETTLED_S: Final = 1.0
_POLL_S: Final = 0.05
#: How long `depth_topics` listens, seconds: images come at least every 0.2 s.
_LOOK_S: Final = 2.0


@dataclass(frozen=True)
class Found:
    """The topic of each slot, the streams of images and the message types by topic, and the poses between frames."""

    topics: Topics
    images: Mapping[str, ImageTopic]
    types: Mapping[str, str]
    frames: Frames

    def lens_topic(self, slot: str) -> str:
        """Return the topic of the lens of ``proximity.depth``, say; empty if it is unknown."""
        role, _, what = slot.partition(".")
        named = self.topics.get(f"{role}.info", "") if what == "depth" else ""
        return named or self.images[self.topics[slot]].info

    def gap(self) -> str:
        """Return a clause that says which image or lens is missing; empty if none is."""
        if "tactile.depth" not in self.topics:
            return "no topic is named as tactile.depth"
        for slot, topic in self.topics.items():
            if slot.endswith(".info"):
                continue
            if topic not in self.images:
                return f"no image has come on {topic}, which is to be {slot}"
            if not self.lens_topic(slot):
                return f"the lens of {topic} is missing (a topic camera_info)"
        return ""


def find_topics(name: str, listener: Listener, chosen: Topics, progress: Progress) -> Found:
    """Listen until the topics of the cameras are known; `SourceError` names the source and says what was heard."""
    heard = _Heard(listener)
    began_s = changed_s = time.monotonic()
    found, gap = Found({}, {}, {}, Frames(heard)), "no topic has depth images"
    while (now_s := time.monotonic()) - began_s < _SEARCH_S and (gap or now_s - changed_s < _SETTLED_S):
        progress(0.2 * (now_s - began_s) / _SEARCH_S, "looking for ROS 2 topics")
        if heard.listen():
            changed_s = now_s
            images, frames = survey(heard), Frames(heard)
            topics, gap = (chosen, "") if chosen else guess_topics(images, frames.joined)
            if "tactile.depth" not in topics:  # a camera alone is a tactile one
                topics = {slot.replace("proximity", "tactile"): topic for slot, topic in topics.items()}
            found = Found(topics, {image.name: image for image in images}, heard.types, frames)
            gap = gap or found.gap()
        time.sleep(_POLL_S)
    if not gap:
        return found
    if not heard.announced:
        raise SourceError(
            f"{name}: nobody has published in ROS 2 domain {listener.domain} for {_SEARCH_S:.0f} s; start the camera's "
            "ROS 2 driver, name its domain as in ros2:?domain=3, and check that the network lets UDP through"
        )
    silent = [foreign(topic, 60) for topic in sorted(set(heard.announced) - set(heard.types))]
    raise SourceError(
        f"{name}: {gap} in ROS 2 domain {listener.domain}; name the topics with --topics "
        f"proximity.depth=/topic,tactile.depth=/topic; {list_topics(list(found.images.values()), heard.types)}"
        + (f"; without messages so far: {', '.join(silent[:8])}" if silent else "")
    )


def depth_topics(listener: Listener) -> list[ImageTopic]:
    """Return the topics of depth images that come now."""
    heard, end_s = _Heard(listener), time.monotonic() + _LOOK_S
    while time.monotonic() < end_s:
        heard.listen()
        time.sleep(_POLL_S)
    return [image for image in survey(heard) if image.kind == "depth"]


class _Heard(Bag):
    """The first message of each topic of cameras, and all fixed transforms, as a recording would hold them."""

    def __init__(self, listener: Listener) -> None:
        super().__init__()
        self.announced: dict[str, str] = {}
        self._listener = listener
        self._readers: dict[str, Reader] = {}
        self._messages: dict[str, list[bytes]] = {}

    def listen(self) -> bool:
        """Take what has come since; return whether there is anything new."""
        before = self.announced, sum(map(len, self._messages.values()))
        self.announced = self._listener.topics()
        for topic, kind in self.announced.items():
            is_fixed = kind == TRANSFORMS and topic.endswith("tf_static")
            if topic not in self._readers and topic not in self.types and (is_fixed or kind in _KINDS):
                self._readers[topic] = self._listener.read(topic, kind)
        for topic, reader in list(self._readers.items()):
            if messages := reader.take():
                self.types[topic] = self.announced.get(topic, "")
                self._messages.setdefault(topic, []).extend(messages)
                if self.types[topic] in _KINDS:
                    del self._readers[topic]
        return (self.announced, sum(map(len, self._messages.values()))) != before

    def count(self, topic: str) -> int:
        return len(self._messages.get(topic, ()))

    def raw(self, topic: str, index: int) -> memoryview:
        return memoryview(self._messages[topic][index])

    def times_ns(self, topic: str) -> Int64Array:
        return np.zeros(self.count(topic), np.int64)

    def close(self) -> None:
        self._readers.clear()


#: Types of which one message tells enough.
_KINDS: Final = (IMAGE, COMPRESSED, CAMERA_INFO)
