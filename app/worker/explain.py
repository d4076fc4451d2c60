"""Errors as sentences for the person."""

from __future__ import annotations

from ...core.errors import TactuneError


def explain(error: Exception, what: str) -> str:
    """Turn an error into one sentence; the tool's own errors speak for themselves."""
    if isinstance(error, TactuneError):
        return str(error)
    return f"{what[0].upper()}{what[1:]} ({type(error).__name__}: {error})."
