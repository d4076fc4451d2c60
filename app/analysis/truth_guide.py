"""What a person does next with a scan, in one sentence."""

from __future__ import annotations

from .truth_flow import TruthFlow
from .truth_state import LEAST_PAIRS, TruthState

#: A pair that is left so far apart was clicked wrongly, or the scan is of another shape.
_FAR_MM = 5.0


def next_step(flow: TruthFlow) -> str:
    """Say the next step."""
    loaded, contact, patch = flow.loaded, flow.contact, flow.patch
    if loaded is None:
        words = "Reading the scan…" if flow.busy_loading else "Open the object's painted scan, or drop it here."
    elif contact is None:
        words = "Finding the paint…"
    elif not contact.vertices.any():
        words = "Nothing on the scan has the touched paint's colour: pick it with the eyedropper."
    elif patch is None:
        words = "There is no frame yet: open a source in the main window, to have a patch to align to."
    elif not len(patch.points):
        words = "The patch is empty: show a frame in the main window in which the object touches."
    elif flow.busy_refining:
        words = "Refining…"
    elif flow.state.pending is not None or flow.state.pose is None:
        words = _picking(flow.state)
    else:
        words = _nudging(flow)
    return words


def _picking(state: TruthState) -> str:
    pending, left = state.pending, LEAST_PAIRS - len(state.matched[0])
    if pending is not None:
        other = "patch" if pending.patch is None else "scan"
        return f"Pair {len(state.pairs)}: now click the same point on the {other}."
    if left == LEAST_PAIRS:
        return f"Click a point on the scan, then the same point on the patch: {LEAST_PAIRS} pairs are needed."
    if left > 0:
        return f"{left} more pair{'s' if left > 1 else ''}: click far from the others, on the scan or the patch."
    return "These pairs give no pose: add one elsewhere, or delete one that is wrong."


def _nudging(flow: TruthFlow) -> str:
    if flow.state.origin == "ICP":
        return "Refined. Look from several sides; save the transform, or correct by the handles and refine again."
    if flow.state.origin != "pairs":
        return "Bring the scan's contact onto the patch: drag arrows and rings, or type numbers; then refine by ICP."
    worst = max(flow.residuals_mm(), default=0.0)
    if worst > _FAR_MM:
        return f"One pair is {worst:.1f} mm off: delete or click it again, or refine by ICP where it looks right."
    return f"Fitted: the pairs agree within {worst:.1f} mm. Refine by ICP, or drag the handles."
