"""What to say over pictures that are old: which camera is missing, what to do, how old the picture is."""

from __future__ import annotations

from ...core.sources.base import CameraHealth, CameraRole
from ..worker.results import SourceState

_OTHER: dict[CameraRole, CameraRole] = {"proximity": "tactile", "tactile": "proximity"}
_STATES = {"missing": "is not connected: plug it in", "stalled": "sends no images: check its cable"}


def camera_sentence(camera: CameraHealth) -> str:
    """Say what is wrong with a camera and what to do; nothing while it streams."""
    if camera.state == "streaming":
        return ""
    if camera.message:
        return camera.message.rstrip(".") + "."
    serial = f"(serial {camera.serial})" if camera.serial else ""
    name = " ".join(part for part in (camera.role.capitalize(), "camera", camera.model, serial) if part)
    return f"{name} {_STATES[camera.state]}."


def age(seconds: float) -> str:
    """Return an age as people say it."""
    whole = max(0, int(seconds))
    return f"{whole} s" if whole < 60 else f"{whole // 60} min"


def badge(state: SourceState, roles: tuple[CameraRole, ...], now_s: float, shown: bool) -> str:
    """Return what to write over a view of one camera or of both; nothing while all is well.

    Parameters
    ----------
    state : SourceState
    roles : tuple of "proximity", "tactile"
        The cameras that the view needs.
    now_s : float
        By ``time.monotonic``.
    shown : bool
        Whether there is a last frame to be seen.
    """
    sentences = [sentence for camera in state.health.cameras if (sentence := camera_sentence(camera))]
    own = [camera_sentence(camera) for camera in state.health.cameras if camera.role in roles]
    parts = [sentence for sentence in own if sentence]
    if not state.stale and not parts:
        return ""
    if not parts and sentences:
        parts = [f"Waits for the {_OTHER[roles[0]]} camera."]
    if not parts:
        parts = [state.problem or "No new frame has come."]
    if state.stale and shown:
        parts.append(f"Shown is the last frame, {age(now_s - state.last_frame_s)} old.")
    return " ".join(parts)


def short_badge(state: SourceState, now_s: float) -> str:
    """Return the same for a small image: that it is old, and how old."""
    return f"{age(now_s - state.last_frame_s)} old" if state.stale else ""


def source_sentence(state: SourceState) -> str:
    """Return what concerns the source as a whole and no camera's view says already."""
    said = " ".join(camera_sentence(camera) for camera in state.health.cameras)
    sentence = state.health.message
    return "" if sentence and sentence.rstrip(".") in said else sentence
