"""The views over a stretch of frames as an animated GIF or an MP4."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Final

import numpy as np
from PyQt6.QtCore import QObject, Qt, pyqtSignal
from PyQt6.QtGui import QImage

from ...core.errors import ExportError
from ...core.model.arrays import Uint8Array
from ...core.model.files import atomic_path
from ..context import Context
from ..worker.jobs import Progress, Work
from ..worker.playback import PlaybackState
from ..worker.results import Result
from .view_area import ViewArea

SUFFIXES: Final = (".gif", ".mp4")
#: Size limits of a GIF, whose pictures are large: width in pixels, and pictures a second.
_GIF_WIDTH_PX, _GIF_RATE_HZ = 900, 10.0
#: How often the writing thread looks whether it was cancelled while it waits for a picture, seconds.
_LOOK_S: Final = 0.1


class Animation(QObject):
    """Shows one frame after the other, and hands the picture of the views to the thread that writes it."""

    _asked = pyqtSignal(int)  # for the picture of this frame
    _ended = pyqtSignal()

    def __init__(self, context: Context, views: ViewArea) -> None:
        super().__init__(context)
        self._context, self._views = context, views
        self._wanted: int | None = None
        self._width_px: int | None = None
        self._pictures: SimpleQueue[Uint8Array | ExportError] = SimpleQueue()
        self._source: object = None
        self._before: PlaybackState | None = None
        self._asked.connect(self._show)
        self._ended.connect(self._go_back)
        context.frameShown.connect(self._take)
        context.worker.failed.connect(self._fail)

    def work(self, path: Path, frames: range, shown: Result) -> Work:
        """Return the work that writes an animation; afterwards the window shows the frame that it showed before."""
        rate_hz, is_gif = shown.source.frame_rate_hz, path.suffix.lower() == ".gif"
        step = max(1, round(rate_hz / _GIF_RATE_HZ)) if is_gif else 1
        chosen, self._width_px = frames[::step], _GIF_WIDTH_PX if is_gif else None
        self._pictures = SimpleQueue()
        self._source, self._before = shown.source, self._context.playback

        def work(progress: Progress) -> str:
            try:
                with atomic_path(path) as temporary:
                    write = _write_gif if is_gif else _write_mp4
                    write(temporary, self._filmed(chosen, progress), rate_hz / step)
            finally:
                self._ended.emit()
            return f"Frames {chosen[0]} to {chosen[-1]} ({len(chosen)}) written to {path}."

        return work

    def _filmed(self, frames: Sequence[int], progress: Progress) -> Iterator[Uint8Array]:
        for number, frame in enumerate(frames):
            self._asked.emit(frame)
            picture = None
            while picture is None:
                progress(number / len(frames), f"picture {number + 1} of {len(frames)}")
                try:
                    picture = self._pictures.get(timeout=_LOOK_S)
                except Empty:
                    continue
            if isinstance(picture, ExportError):
                raise picture
            yield picture

    def _show(self, frame: int) -> None:
        self._wanted = frame
        self._context.worker.pause()
        self._take()

    def _fail(self, sentence: str) -> None:
        if self._wanted is not None:
            self._wanted = None
            self._pictures.put(ExportError(sentence))

    def _go_back(self) -> None:
        self._wanted = None
        result = self._context.result
        if self._before is not None and result is not None and result.source is self._source:
            self._context.worker.seek(self._before.index)
            if self._before.playing:
                self._context.worker.play()

    def _take(self) -> None:
        """Take the picture if the frame is on the screen, or else ask for the frame."""
        result = self._context.result
        if self._wanted is None or result is None:
            return
        if result.source is not self._source:
            self._fail("another source was opened meanwhile; open the recording and export again")
            return
        if result.frame_number != self._wanted:
            self._context.worker.seek(self._wanted)
            return
        self._wanted = None
        self._pictures.put(_pixels(self._views.picture().toImage(), self._width_px))


def _pixels(image: QImage, width_px: int | None) -> Uint8Array:
    """Return an image as (H, W, 3), at most so wide, with even sides, as videos need them."""
    if width_px is not None and image.width() > width_px:
        image = image.scaledToWidth(width_px, Qt.TransformationMode.SmoothTransformation)
    image = image.convertToFormat(QImage.Format.Format_RGB888)
    bits = image.constBits()
    assert bits is not None
    rows = np.frombuffer(bits.asstring(image.sizeInBytes()), np.uint8).reshape(image.height(), image.bytesPerLine())
    pixels = rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3)
    return np.ascontiguousarray(pixels[: image.height() // 2 * 2, : image.width() // 2 * 2])


def _write_gif(path: Path, pictures: Iterator[Uint8Array], rate_hz: float) -> None:
    from PIL import Image

    images = (Image.fromarray(picture).quantize(128) for picture in pictures)
    next(images).save(path, save_all=True, append_images=images, duration=round(1000 / rate_hz), loop=0)


def _write_mp4(path: Path, pictures: Iterator[Uint8Array], rate_hz: float) -> None:
    import cv2

    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # quiet: what is wrong is told below
    first = next(pictures)
    size = (first.shape[1], first.shape[0])
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate_hz, size)
    if not video.isOpened():
        raise ExportError(f"cannot write {path.suffix}: the disk is full or OpenCV has no encoder for it; choose .gif")
    try:
        video.write(first[:, :, ::-1])
        count = 1
        for picture in pictures:  # the window may be resized meanwhile
            video.write(cv2.resize(picture, size)[:, :, ::-1])
            count += 1
    finally:
        video.release()
    reader = cv2.VideoCapture(str(path))
    written = int(reader.get(cv2.CAP_PROP_FRAME_COUNT))
    reader.release()
    if written < count:  # the writer says nothing of a full disk
        raise ExportError(f"only {max(written, 0)} of {count} pictures could be written; make room on the disk")
