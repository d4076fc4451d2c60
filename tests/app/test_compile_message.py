"""Whoever waits for the compiler is told so: in the window while a source opens, on the command line before frames."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from tactune.app.cli.main import commands
from tactune.app.worker.reading import OpeningCancelledError, SourceRequest, open_requested
from tactune.core.contact import warmup


@pytest.mark.parametrize("compiled", [False, True])
def test_opening_in_the_window_tells_of_compiling(monkeypatch, compiled):
    monkeypatch.setattr(warmup, "is_compiled", lambda: compiled)
    told = []
    source = open_requested(SourceRequest("it", lambda progress: "source"), lambda: True, lambda *it: told.append(it))
    assert source == "source"
    assert (warmup.COMPILING in [text for _, text in told]) is not compiled


def test_compiling_can_be_cancelled(monkeypatch):
    monkeypatch.setattr(warmup, "is_compiled", lambda: False)
    with pytest.raises(OpeningCancelledError):
        open_requested(SourceRequest("it", lambda progress: "source"), lambda: False, lambda share, text: None)


@pytest.mark.parametrize("compiled", [False, True])
def test_running_without_a_window_tells_of_compiling(monkeypatch, compiled):
    monkeypatch.setattr(warmup, "is_compiled", lambda: compiled)
    done = CliRunner().invoke(commands, ["run", "--source", "sim:cup", "--frames", "1", "--json"])
    assert done.exit_code == 0, done.stderr
    assert (warmup.COMPILING in done.stderr) is not compiled
    assert warmup.COMPILING not in done.stdout
