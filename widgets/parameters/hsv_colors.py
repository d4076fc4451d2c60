"""What positions on the sliders of a colour range look like."""

from __future__ import annotations

from PyQt6.QtGui import QColor

Span = tuple[int, int]


def groove_colors(hue: Span, saturation: Span, value: Span) -> dict[str, list[QColor]]:
    """Return the colours along the grooves of hue, saturation and value, by these names.

    Saturation and value are shown at the middle of the hue's range, OpenCV's 8-bit convention.
    """
    middle = (hue[0] + ((hue[1] - hue[0]) % 180) // 2) % 180
    typical_saturation, typical_value = sum(saturation) // 2, sum(value) // 2
    return {
        "hue": [QColor.fromHsv(2 * (h % 180), 230, 230) for h in range(0, 180, 15)] + [QColor.fromHsv(358, 230, 230)],
        "saturation": [QColor.fromHsv(2 * middle, s, max(typical_value, 120)) for s in range(0, 256, 51)],
        "value": [QColor.fromHsv(2 * middle, typical_saturation, v) for v in range(0, 256, 51)],
    }
