"""What the window publishes of each processed frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .results import Result

if TYPE_CHECKING:
    from ...core.output.publisher import Publisher


def publish(publisher: Publisher, result: Result) -> None:
    """Publish a frame with its patch and tilt; the tilt is computed if a client listens to it."""
    from ...core.estimation.tilt import TiltEstimator
    from ...core.model.patch import Lazy

    patch = result.patch
    if patch is not None:
        tilt = Lazy(lambda: TiltEstimator(result.preset, patch.rig).estimate(patch).record())
        publisher.put(result.frame, patch, result.preset, tilt)
