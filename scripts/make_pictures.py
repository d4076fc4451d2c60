"""Make the pictures of README and guide from the program itself: ``make pictures``.

Each function below brings the window into the state that its picture shows, through the same actions that a person
uses. The source is the simulator, so pictures change only when the program does.

    QT_QPA_PLATFORM=offscreen .venv/bin/python scripts/make_pictures.py --only window,mask
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

from PIL import Image
from PyQt6.QtCore import QBuffer, QIODevice, Qt
from PyQt6.QtWidgets import QWidget

from tactune.app.calibration.wizard import CalibrationWizard
from tactune.app.gui import make_application
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.app.worker.results import ColorBy
from tactune.core.sources.presets import load_preset
from tactune.widgets.basics.controls import new_gesture

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "guide" / "images"
#: The deepest frame of the simulator's press.
PRESSED_FRAME = 45
#: Size of the main window in the pictures, in px.
SIZE = (1600, 1000)
MAX_WAIT_S = 300.0


def wait(condition: Callable[[], object], what: str) -> None:
    """Handle events until a condition holds; raise `TimeoutError` if it never does."""
    application, end = make_application(), time.monotonic() + MAX_WAIT_S
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"no {what} within {MAX_WAIT_S:.0f} s")
        application.processEvents()
        time.sleep(0.01)


def settle(seconds: float = 1.0) -> None:
    """Handle events for a while, so that queued drawing is done."""
    end = time.monotonic() + seconds
    wait(lambda: time.monotonic() > end, "end")


def show_frame(window: MainWindow, index: int) -> None:
    """Pause at a frame, counted from 0."""
    window.worker.pause()
    window.worker.seek(index)

    def shown() -> bool:
        result = window.result
        return result is not None and result.frame.sequence == index and result.patch is not None

    wait(shown, f"patch of frame {index}")


@contextmanager
def opened(changes: dict[str, object] | None = None) -> Iterator[MainWindow]:
    """Open a window of its own on the simulator, with changes to its preset; close it afterwards."""
    with tempfile.TemporaryDirectory(prefix="tactune-pictures-") as folder:
        preset = load_preset("simulator").with_values(changes or {})
        window = MainWindow(preset, Settings(Path(folder) / "window.json"), Path(folder), native_dialogs=False)
        window.set_theme("light", remember=False)
        window.resize(*SIZE)
        window.show()
        try:
            window.actions_.tune.trigger()
            window.open_source("sim:cup")
            wait(lambda: window.result is not None, "frame")
            show_frame(window, PRESSED_FRAME)
            settle()
            yield window
        finally:
            window.close_without_asking()
            settle(0.2)


def save(widget: QWidget, name: str) -> None:
    """Write what a widget shows when its drawing is done."""
    settle()
    path = FOLDER / f"{name}.png"
    if not widget.grab().save(str(path)):
        raise OSError(f"{path} cannot be written")
    print(f"{path.name}: {widget.width()} x {widget.height()}")


def window() -> None:
    """The main window, and beside it the press as an animation for README."""
    with opened() as window:
        wait(lambda: not window.time_strip.words, "time strip")
        save(window, "window")
        images = []
        for index in range(15, 76, 3):
            show_frame(window, index)
            settle(0.1)
            buffer = QBuffer()
            buffer.open(QIODevice.OpenModeFlag.ReadWrite)
            smaller = window.views.picture().scaledToWidth(900, Qt.TransformationMode.SmoothTransformation)
            smaller.save(buffer, "PNG")
            with Image.open(BytesIO(buffer.data().data())) as image:
                images.append(image.convert("P", palette=Image.Palette.ADAPTIVE, colors=64))
        path = FOLDER / "press.gif"
        images[0].save(path, save_all=True, append_images=images[1:], duration=100, loop=0, optimize=True)
        print(f"{path.name}: {path.stat().st_size / 1e6:.1f} MB")


def set_up() -> None:
    """The guided set-up with its verdict."""
    with opened() as window:
        window.actions_.set_up.trigger()
        window.resize(1280, 720)
        window.set_up.start.click()
        wait(lambda: not window.set_up.running, "verdict")
        save(window.set_up, "set-up")


def mask() -> None:
    """The images while the eyedropper is in use."""
    with opened() as window:
        window.eyedropper.use("set")
        save(window.strip, "mask")


def panel_membrane() -> None:
    """The parameters with the membrane test."""
    with opened() as window:
        save(window.panel, "panel-membrane")


def panel_tolerance() -> None:
    """The parameters with the tolerance test and its histogram."""
    with opened({"contact_test": "tolerance"}) as window:
        save(window.panel, "panel-tolerance")


def pressure() -> None:
    """The views in the colours of contact pressure, with the force."""
    with opened() as window:
        window.actions_.capture_untouched.trigger()
        window.set_up.untouched.work.start.click()
        wait(lambda: window.document.preset.untouched is not None, "untouched frame")
        window.document.edit_many({"contact_test": "pressure", "pressure.gauge_pa": 1500.0}, new_gesture())
        window.views.choose_colors(ColorBy.PRESSURE)
        show_frame(window, PRESSED_FRAME)
        wait(lambda: window.result is not None and window.result.rendered.color_by is ColorBy.PRESSURE, "colours")
        save(window.views, "pressure")


def suggestions() -> None:
    """Suggestions for a preset without a mask and with a wrong depth offset."""
    with opened({"mask.enabled": False, "alignment.depth_offset_m": 0.008}) as window:
        window.suggest.open("all")
        shown = window.suggest.window
        assert shown is not None
        wait(lambda: not shown.job.busy, "suggestion")
        save(shown, "suggestions")


@contextmanager
def calibrated() -> Iterator[CalibrationWizard]:
    """Open the wizard and let it find pairs in a snapshot of the pressed membrane."""
    with opened() as window:
        window.calibration.open_wizard()
        wizard = window.calibration.wizard
        assert wizard is not None
        wizard.frames.take.click()
        wait(lambda: wizard.session.state.snapshots, "snapshot")
        wizard.go_to(wizard.pages.index(wizard.points))
        wizard.points.finder.search.click()
        wait(lambda: wizard.outcome.report, "fit")
        yield wizard


def wizard_points() -> None:
    """The wizard with the pairs that it found."""
    with calibrated() as wizard:
        wizard.go_to(wizard.pages.index(wizard.points))
        save(wizard, "wizard-points")


def quality() -> None:
    """The quality of the calibration."""
    with calibrated() as wizard:
        wizard.go_to(wizard.pages.index(wizard.quality))
        wait(lambda: not wizard.quality.map.notice.text(), "map")
        save(wizard, "quality")


_MAKERS = (window, set_up, mask, panel_membrane, panel_tolerance, pressure, suggestions, wizard_points, quality)
PICTURES = {make.__name__.replace("_", "-"): make for make in _MAKERS}


def main() -> None:
    """Make the pictures that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(PICTURES), help="names of pictures, separated by commas")
    names = parser.parse_args().only.split(",")
    if unknown := sorted(set(names) - set(PICTURES)):
        parser.error(f"no picture {', '.join(unknown)}; there are {', '.join(PICTURES)}")
    application = make_application()
    FOLDER.mkdir(exist_ok=True)
    for name in names:
        PICTURES[name]()
    application.quit()


if __name__ == "__main__":
    main()
