"""The command as a whole: version, help, the window, and start-up time."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
import typer

from tactune.app.cli import main
from tactune.core.sources.presets import default_preset


def test_version(tactune):
    assert tactune("--version").out == f"tactune {version('tactune')}\n"


def test_help_is_one_screen_with_every_command(tactune):
    finished = tactune("--help")
    assert finished.status == 0
    lines = finished.out.splitlines()
    assert len(lines) <= 24 and max(map(len, lines)) <= 80, "one screen"
    assert not any(line.endswith("...") for line in lines[1:]), "no summary is cut"
    commands = typer.main.get_command(main.commands).commands
    assert [line.split()[0] for line in lines if line.startswith("  ") and line.split()[0] in commands] == [
        name for names in main.GROUPS.values() for name in names
    ]
    shown = [name for name, command in commands.items() if not command.hidden]
    assert sorted(shown) == sorted(name for names in main.GROUPS.values() for name in names)


def test_the_tab_key_completes_commands():
    words = {"COMP_WORDS": "tactune re", "COMP_CWORD": "1", "_TACTUNE_COMPLETE": "complete_bash"}
    done = subprocess.run(
        [sys.executable, "-m", "tactune.app"], capture_output=True, text=True, env=os.environ | words, check=False
    )
    assert done.stdout.split() == ["record"]


@pytest.mark.parametrize("sent", ["SIGINT", "SIGTERM"])
def test_a_signal_while_the_command_is_imported_has_no_traceback(sent):
    program = (
        "import os, signal, sys; from tactune.app.__main__ import main\n"
        "class Sender:\n"
        f"    def find_spec(name, *_): name == 'typer' and os.kill(os.getpid(), signal.{sent})\n"
        "sys.meta_path.insert(0, Sender); sys.exit(main())"
    )
    done = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True)
    assert (done.returncode, done.stderr) == (130, b"")


@pytest.fixture
def opened(monkeypatch):
    """Stand in for the window and note what it is asked to show."""
    monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")
    from tactune.app import gui

    calls = []
    monkeypatch.setattr(gui, "run_gui", lambda *words: calls.append(words))
    return calls


def test_the_window_opens_on_the_simulator_or_what_it_is_told(tactune, opened):
    assert tactune().status == 0
    assert tactune("gui", "--source", "sim:cup", "--preset", "default", "--screenshot", "window.png").status == 0
    assert opened == [(None, None, None), ("sim:cup", "default", Path("window.png"))]


@pytest.mark.parametrize(
    ("obstacle", "remedy"),
    [
        ("sys.modules['PyQt6'] = None", 'pip install "tactune[gui]"'),
        ("sys.meta_path.insert(0, WithoutLibrary)", "libEGL.so.1"),
    ],
)
def test_a_window_that_cannot_open_says_what_to_install(obstacle, remedy):
    program = f"""
import sys
class WithoutLibrary:
    def find_spec(name, path=None, target=None):
        if name == "PyQt6.QtGui":
            raise ImportError("libEGL.so.1: cannot open shared object file: No such file or directory")
{obstacle}
sys.argv = ["tactune", "gui"]
from tactune.app.cli.main import main
sys.exit(main())
"""
    environment = os.environ | {"QT_QPA_PLATFORM": "offscreen"}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert done.returncode == 2
    assert done.stderr.startswith("tactune: ")
    assert done.stderr.count("\n") == 1
    assert remedy in done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_a_display_that_is_missing_or_does_not_answer_is_said_in_words(tactune, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    assert "tactune run" in tactune().sentence
    monkeypatch.setenv("DISPLAY", ":9999")
    assert "display :9999 does not answer" in tactune().sentence


@pytest.mark.parametrize(
    ("source", "preset"),
    [("sim", "simulator"), ("sim:cup?seed=3", "simulator"), ("live:sim", "simulator"), ("live:sim:cube", "simulator"),
     ("folder:sim", "default"), ("cameras:", "default"), ("live:folder:x", "default"), ("similar.bag", "default")],
)  # fmt: skip
def test_the_simulator_has_a_preset_of_its_own(source, preset):
    assert default_preset(source) == preset
