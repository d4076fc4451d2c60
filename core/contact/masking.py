"""The mask's colours, and light that has changed since the untouched frame: the prints tell by how much."""

from __future__ import annotations

import math

import numpy as np

from ..model.arrays import BoolArray, Uint8Array
from ..model.sections import MaskSection

#: Most pixels on prints that are compared, and smallest share of the image that prints cover.
_MAX_SAMPLES, _MIN_SHARE = 500, 0.005
#: Brightness of pixels that are not saturated and tell a ratio.
_DARK, _BRIGHT = 20, 245
#: The light has changed if a channel has, by more than this share, and the mask covers less than a share of the prints;
#: it is understood if the mask then covers more, but not more than this multiple of them.
_CHANGED, _FEWER_PRINTS, _MORE_PRINTS = 0.1, 0.7, 1.5


def in_hsv_range(colors: Uint8Array, section: MaskSection) -> BoolArray:
    """Return which RGB colours (..., 3) lie in the mask's range of OpenCV's HSV; a low hue above the high wraps."""
    import cv2  # on demand: most presets have no mask

    inside = np.zeros(colors.shape[:-1], bool)
    if not colors.size:
        return inside
    hsv = cv2.cvtColor(colors.reshape(-1, *colors.shape[-2:]), cv2.COLOR_RGB2HSV)
    low, high = section.hue
    for hue in ((low, high),) if low <= high else ((low, 179), (0, high)):
        ends = np.array([hue, section.saturation, section.value]).T
        inside |= cv2.inRange(hsv, ends[0], ends[1]).reshape(inside.shape) > 0
    return inside


def masked_share(image: Uint8Array, section: MaskSection) -> float:
    """Return the share of a colour image (H, W, 3) that the mask covers, of large images from every n-th pixel."""
    step = max(1, len(image) // 120)
    masked = in_hsv_range(np.ascontiguousarray(image[::step, ::step]), section)
    return float(np.count_nonzero(masked) / masked.size)


class Light:
    """The colours of the prints in the untouched frame, to find the prints again in other light.

    Parameters
    ----------
    image : uint8, shape (H, W, 3)
        RGB, of the untouched membrane.
    mask : MaskSection
        Holds in the light of that image.
    """

    def __init__(self, image: Uint8Array, mask: MaskSection) -> None:
        self._mask = mask
        self._last = image, image  # the newest image and what was made of it
        #: Share of the image that prints cover; nan without enough of them.
        self.share = masked_share(image, mask) if mask.enabled else 0.0
        if self.share < _MIN_SHARE:
            self.share = math.nan
            return
        usable = in_hsv_range(image, mask) & (image > _DARK).all(axis=2) & (image < _BRIGHT).all(axis=2)
        places = np.flatnonzero(usable)
        self._places = places[:: max(len(places) // _MAX_SAMPLES, 1)]
        self._colors = image.reshape(-1, 3)[self._places].astype(np.float32)

    def as_before(self, image: Uint8Array) -> Uint8Array:
        """Return an image in the light of the untouched frame; the image itself if the light is about the same."""
        if math.isnan(self.share) or image.size == 0 or len(self._places) == 0:
            return image
        before, relit = self._last
        if before is not image:
            relit = self._relit(image)
            self._last = image, relit  # another thread may ask for another image meanwhile
        return relit

    def _relit(self, image: Uint8Array) -> Uint8Array:
        ratios = np.median(image.reshape(-1, 3)[self._places] / self._colors, axis=0)
        if not ((ratios > 0) & np.isfinite(ratios)).all() or (np.abs(ratios - 1) < _CHANGED).all():
            return image
        import cv2

        raw = masked_share(image, self._mask)
        if raw > _FEWER_PRINTS * self.share:
            return image  # the mask was tuned in this light
        table = np.clip(np.round(np.arange(256)[:, None] / ratios), 0, 255).astype(np.uint8)[None]
        relit = np.asarray(cv2.LUT(image, table), np.uint8)
        relit.flags.writeable = False
        # where a press has displaced most prints, the ratios are not those of the light
        return relit if raw < masked_share(relit, self._mask) < _MORE_PRINTS * self.share else image

    def covered(self, image: Uint8Array) -> float:
        """Return how much of an image the mask covers, as a share of what it covers in the untouched frame."""
        return masked_share(self.as_before(image), self._mask) / self.share
