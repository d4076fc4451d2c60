"""Reads an HTML page: its text, and its pictures, which must be inside."""

from __future__ import annotations

import base64
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np

_VOID = {"meta", "img", "br"}


class HtmlPage(HTMLParser):
    """A page whose tags all close in order.

    Attributes
    ----------
    text : str
    images : dict of alternative text to uint8 (H, W, 3), BGR
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.text, self.images, self._open = "", {}, []
        self.feed(path.read_text("utf-8"))
        self.close()
        assert not self._open

    def handle_starttag(self, tag, attrs):
        if tag not in _VOID:
            self._open.append(tag)
        if tag == "img":
            values = dict(attrs)
            kind, _, data = values["src"].partition(",")
            assert kind == "data:image/png;base64"
            image = cv2.imdecode(np.frombuffer(base64.b64decode(data, validate=True), np.uint8), cv2.IMREAD_COLOR)
            assert image is not None
            self.images[values["alt"]] = image

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        self.text += data
