"""Names of new files: taken by one of two programs, never by both."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from kinds import KINDS
from tactune.core.errors import ExportError

#: A picture that is there is replaced, since the dialog has asked, but none that was made while this one was written.
WRITERS = {name: kind.new for name, kind in KINDS.items() if kind.new and not kind.grows} | {
    "picture": KINDS["picture"].write
}


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("kind", WRITERS)
def test_a_name_that_another_program_takes_meanwhile_is_refused(
    kind: str, links: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second program writes its whole file at the moment when the first is about to name its own."""
    others: list[dict[str, bytes]] = []

    def contents() -> dict[str, bytes]:
        return {str(file.relative_to(tmp_path)): file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}

    def after_the_other(name: Callable[..., Any]) -> Callable[..., Any]:
        def call(*words: Any) -> Any:
            if not others:
                others.append({})
                hidden = set(contents())
                WRITERS[kind](tmp_path, 1)
                others[0] = {file: data for file, data in contents().items() if file not in hidden}
            return name(*words)

        return call

    def no_links(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "link", after_the_other(os.link if links else no_links))
    monkeypatch.setattr(Path, "rename", after_the_other(Path.rename))
    with pytest.raises(ExportError, match=r"already there|not empty"):
        WRITERS[kind](tmp_path, 0)
    assert others[0]
    assert contents() == others[0]
