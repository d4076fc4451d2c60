"""Names of new files: taken by one of two programs, never by both."""

import os
from pathlib import Path

import pytest

from kinds import KINDS
from tactune.core.errors import ExportError

WRITERS = {name: kind.new for name, kind in KINDS.items() if kind.new and not kind.grows}


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("kind", WRITERS)
def test_a_name_that_another_program_takes_meanwhile_is_refused(kind, links, tmp_path, monkeypatch):
    """The second program writes its whole file at the moment when the first is about to name its own."""
    others = []

    def contents():
        return {str(file.relative_to(tmp_path)): file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}

    def after_the_other(name):
        def call(*words):
            if not others:
                others.append({})
                hidden = set(contents())
                WRITERS[kind](tmp_path, 1)
                others[0] = {file: data for file, data in contents().items() if file not in hidden}
            return name(*words)

        return call

    def no_links(*_):
        raise PermissionError

    monkeypatch.setattr(os, "link", after_the_other(os.link if links else no_links))
    monkeypatch.setattr(Path, "rename", after_the_other(Path.rename))
    with pytest.raises(ExportError, match=r"already there|not empty"):
        WRITERS[kind](tmp_path, 0)
    assert others[0]
    assert contents() == others[0]
