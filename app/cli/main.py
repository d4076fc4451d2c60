"""The command ``tactune``: its subcommands, the window, and exit statuses.

Everything heavy is imported inside the commands, so that ``tactune --help`` answers at once.
"""

from __future__ import annotations

import ctypes
import os
import sys
from importlib.metadata import version
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ...core.errors import MissingExtraError, TactuneError, foreign
from ...core.model.files import check_writable
from .calibrate import calibrate, check, create_rig
from .common import PresetOption, SourceOption, say, warn
from .doctor import devices, doctor, warmup
from .lab import lab_commands
from .preset import preset_commands
from .record import convert, record
from .run import run
from .serve import serve
from .suggest import findings, suggest
from .track import track
from .tune import tune

#: Exit status of errors that the person can correct: a wrong option, a wrong file.
USAGE_STATUS = 2
#: The commands as the help lists them.
GROUPS = {
    "Every day": ("gui", "run", "calibrate", "record", "convert", "devices", "doctor"),
    "Robot": ("serve", "track", "check", "warmup", "preset"),
    "Lab": ("tune", "lab"),
}
#: What a message about missing or wrong arguments shows.
EXAMPLES = {
    "run": "tactune run --source sim",
    "calibrate": "tactune calibrate --points points.csv --rig folder:scene --out cup.json",
    "record": "tactune record --source cameras: --out press.mcap",
    "convert": "tactune convert press.mcap images",
    "serve": "tactune serve --source cameras: --ros2",
    "track": "tactune track --source 'sim:cup?press=medium' --mesh cup.stl --out poses.csv",
    "check": "tactune check --source cameras: --preset cup.json",
    "tune": "tactune tune --source 'sim:cup?press=medium' --out best.json",
    "preset new": "tactune preset new --rig folder:scene --out cup.json",
    "preset suggest": "tactune preset suggest --source sim --out cup.json",
    "preset findings": "tactune preset findings --source sim",
    "preset capture-untouched": "tactune preset capture-untouched --source cameras: --preset cup.json",
    "preset measure-rig": "tactune preset measure-rig --source cameras: --preset cup.json",
    "preset calibrate-force": "tactune preset calibrate-force --source press.mcap --forces scale.csv --preset cup.json",
    "preset create-rig": "tactune preset create-rig images --proximity L515 --tactile D405",
}
#: A wrong option or argument; click, which raises it, is typer's own or a package, depending on typer's version.
_UsageError: type[Any] = typer.BadParameter.__mro__[1]


class _Commands(TyperGroup):
    """The command ``tactune``, whose help is one screen: commands in groups, no summary cut."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Read the options before a command."""
        try:
            return super().parse_args(ctx, args)
        except _UsageError as error:
            raise TactuneError(
                f"{error.format_message().rstrip('.')}; options follow a command, as in tactune gui --source sim"
            ) from error

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]
        """Run a command; what is missing or wrong in its arguments is one sentence with an example."""
        try:
            return super().invoke(ctx)
        except _UsageError as error:
            if type(error).__name__ == "NoArgsIsHelpError":  # its text is the help
                raise
            command = "tactune" if error.ctx is None else error.ctx.command_path
            name = command.removeprefix("tactune").strip()
            more = f"for example: {EXAMPLES[name]}" if name in EXAMPLES else f"{command} --help says what there is"
            said = error.format_message().rstrip(".").removeprefix("Invalid value: ").replace("\n", " ")
            said = said.replace("Value error, ", "")
            raise TactuneError(f"{name}{': ' if name else ''}{said[0].lower() + said[1:]}; {more}") from error

    def format_help(self, ctx: typer.Context, formatter: Any) -> None:  # type: ignore[override]
        """Write usage, the groups of commands, and the options in a line."""
        self.format_usage(ctx, formatter)
        self.format_help_text(ctx, formatter)
        formatter.write_paragraph()
        wide = max(map(len, self.commands))
        for title, names in GROUPS.items():
            formatter.write(f"{title}:\n")
            for name in names:
                formatter.write(f"  {name:{wide}}  {self.commands[name].get_short_help_str(80)}\n")
        formatter.write("\nOptions: --version, --help, --install-completion (of the Tab key, in this shell)\n")


commands = typer.Typer(
    cls=_Commands,
    help="Tune a soft-membrane tactile sensor with two depth cameras, and run it headless. "
    "Without a command: open the window.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
# The first sentence of each docstring is the summary in the lists of commands.
for command in (run, calibrate, record, convert, devices, doctor, serve, track, check, warmup, tune):
    commands.command()(command)
for command in (suggest, findings):
    preset_commands.command()(command)
preset_commands.command("create-rig")(create_rig)
commands.command("create-rig", hidden=True)(create_rig)  # the name by which scripts know it
commands.add_typer(preset_commands, name="preset")
commands.add_typer(lab_commands, name="lab")


def main() -> int:
    """Run the command line and return its exit status.

    0: done; 1: a check failed, or the reader of standard output has gone; 2: an error that the person can correct, in
    one sentence; 130: interrupted.
    """
    # The matrices are small: more threads of NumPy's BLAS would only spin while they wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files need not be valid Unicode
    try:
        commands(prog_name="tactune")
    except TactuneError as error:
        warn(str(error))
        return USAGE_STATUS
    except OSError as error:
        where = f"{foreign(error.filename)}: " if error.filename else ""
        warn(f"{where}{error.strerror or error}; check the path, its permissions and the disk")
        return USAGE_STATUS
    except SystemExit as end:
        return int(end.code or 0)
    except KeyboardInterrupt:
        return 130
    return 0


@commands.callback(invoke_without_command=True)
def _start(
    context: typer.Context,
    show_version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
) -> None:
    if show_version:
        say(f"tactune {version('tactune')}")
    elif context.invoked_subcommand is None:
        raise typer.Exit(_open_window(None, None, None))


@commands.command()
def gui(
    *,
    source: SourceOption = "",
    preset: PresetOption = None,
    screenshot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Save a picture of the window to a .png or .jpg file and close it."),
    ] = None,
) -> None:
    """Open the window, as without a command. It has the last source and preset unless others are named."""
    if screenshot is not None and screenshot.suffix.lower() not in (".png", ".jpg"):
        raise typer.BadParameter(f"--screenshot is {screenshot}; give a file that ends in .png or .jpg")
    check_writable(screenshot)
    raise typer.Exit(_open_window(source, preset, screenshot))


def _check_x_display() -> None:
    """Raise an error if the X display does not answer; Qt would abort the process."""
    display = os.environ.get("DISPLAY", "")
    platform = os.environ.get("QT_QPA_PLATFORM", "xcb")
    if sys.platform != "linux" or not display or os.environ.get("WAYLAND_DISPLAY") or not platform.startswith("xcb"):
        return
    try:
        xcb = ctypes.CDLL("libxcb.so.1")
    except OSError:
        return  # importing Qt reports the missing library better
    xcb.xcb_connect.restype = ctypes.c_void_p
    connection = ctypes.c_void_p(xcb.xcb_connect(None, None))
    refused = xcb.xcb_connection_has_error(connection)
    xcb.xcb_disconnect(connection)
    if refused:
        raise TactuneError(
            f"the display {display} does not answer; set DISPLAY to one that does, use tactune run, "
            "or QT_QPA_PLATFORM=offscreen for a picture"
        )


def _open_window(source: str | None, preset: str | None, screenshot: Path | None) -> int:
    if sys.platform == "linux" and not any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"))):
        raise TactuneError(
            "there is no display to open a window on; use tactune run, or QT_QPA_PLATFORM=offscreen for a picture"
        )
    _check_x_display()
    try:
        from ..gui import run_gui
    except ImportError as error:
        raise MissingExtraError(
            f'the window cannot be opened ({error}): pip install "tactune[gui]", or let tactune doctor say what is '
            "missing; tactune run works without it"
        ) from error
    return run_gui(source, preset, screenshot)
