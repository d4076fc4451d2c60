"""Make the pictures of README and guide from the program itself: ``make pictures``.

Each function below brings the window into the state that its picture shows, through the same actions that a person
uses. The source is the simulator, so pictures change only when the program does. Run it under a display or offscreen::

    xvfb-run -a -s "-screen 0 1920x1080x24" .venv/bin/python scripts/make_pictures.py
    QT_QPA_PLATFORM=offscreen .venv/bin/python scripts/make_pictures.py --only window,mask
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from PyQt6.QtWidgets import QWidget

from tactune.app.analysis.compare_tab import CompareTab
from tactune.app.calibration.wizard import CalibrationWizard
from tactune.app.gui import make_application
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.core.preset import Preset
from tactune.core.sources.presets import load_preset

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "guide" / "images"
#: The deepest frame of the simulator's press.
PRESSED_FRAME = 45
#: Size of the main window in the pictures, in px.
SIZE = (1600, 1000)
MAX_WAIT_S = 300.0


class Stage:
    """A main window that shows one frame of the simulator, paused."""

    def __init__(self, window: MainWindow) -> None:
        self.window = window

    def wait(self, condition: Callable[[], object], what: str) -> None:
        """Handle events until a condition holds; raise `TimeoutError` if it never does."""
        application, end = make_application(), time.monotonic() + MAX_WAIT_S
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"no {what} within {MAX_WAIT_S:.0f} s")
            application.processEvents()
            time.sleep(0.01)

    def settle(self, seconds: float = 1.0) -> None:
        """Handle events for a while, so that queued drawing is done."""
        end = time.monotonic() + seconds
        self.wait(lambda: time.monotonic() > end, "end")

    def show_frame(self, index: int) -> None:
        """Pause at a frame, counted from 0."""
        self.window.worker.pause()
        self.window.worker.seek(index)

        def shown() -> bool:
            result = self.window.result
            return result is not None and result.frame.sequence == index and result.patch is not None

        self.wait(shown, f"patch of frame {index}")
        self.settle()


@contextmanager
def stage(preset: Preset, source: str, frame: int = PRESSED_FRAME) -> Iterator[Stage]:
    """Open a window of its own on a source, at a frame; close it afterwards."""
    with tempfile.TemporaryDirectory(prefix="tactune-pictures-") as folder:
        window = MainWindow(preset, Settings(Path(folder) / "window.json"), Path(folder), native_dialogs=False)
        window.set_theme("light", remember=False)
        window.resize(*SIZE)
        window.show()
        made = Stage(window)
        try:
            window.open_source(source)
            made.wait(lambda: window.result is not None, "frame")
            made.show_frame(frame)
            yield made
        finally:
            window.close_without_asking()
            made.settle(0.2)


def save(widget: QWidget, name: str) -> None:
    """Write what a widget shows."""
    path = FOLDER / f"{name}.png"
    if not widget.grab().save(str(path)):
        raise OSError(f"{path} cannot be written")
    print(f"{path.name}: {widget.width()} x {widget.height()}")


def window() -> None:
    """The main window."""
    with stage(load_preset("simulator"), "sim:cup") as made:
        made.wait(lambda: not made.window.time_strip.words, "time strip")
        save(made.window, "window")


def mask() -> None:
    """The images while the eyedropper is in use."""
    with stage(load_preset("simulator"), "sim:cup") as made:
        made.window.eyedropper.use("set")
        made.settle()
        save(made.window.strip, "mask")


def panel_membrane() -> None:
    """The parameters with the membrane test."""
    with stage(load_preset("simulator"), "sim:cup") as made:
        save(made.window.panel, "panel-membrane")


def panel_tolerance() -> None:
    """The parameters with the tolerance test and its histogram."""
    with stage(load_preset("simulator").with_values({"contact_test": "tolerance"}), "sim:cup") as made:
        save(made.window.panel, "panel-tolerance")


def suggestions() -> None:
    """Suggestions for a preset without a mask and with a wrong depth offset."""
    spoiled = load_preset("simulator").with_values({"mask.enabled": False, "alignment.depth_offset_m": 0.008})
    with stage(spoiled, "sim:cup") as made:
        made.window.suggest.open("all")
        shown = made.window.suggest.window
        assert shown is not None
        made.wait(lambda: not shown.busy, "suggestion")
        made.settle()
        save(shown, "suggestions")


@contextmanager
def calibrated() -> Iterator[tuple[Stage, CalibrationWizard]]:
    """Open the wizard and let it find pairs in a snapshot of the pressed membrane."""
    with stage(load_preset("simulator"), "sim:cup") as made:
        made.window.calibration.open_wizard()
        wizard = made.window.calibration.wizard
        assert wizard is not None
        wizard.frames.take.click()
        made.wait(lambda: wizard.session.state.snapshots, "snapshot")
        wizard.go_to(wizard.pages.index(wizard.points))
        wizard.points.finder.search.click()
        made.wait(lambda: wizard.outcome.report, "fit")
        yield made, wizard


def wizard_points() -> None:
    """The wizard with the pairs that it found."""
    with calibrated() as (made, wizard):
        wizard.go_to(wizard.pages.index(wizard.points))
        made.settle()
        save(wizard, "wizard-points")


def quality() -> None:
    """The quality of the calibration."""
    with calibrated() as (made, wizard):
        wizard.go_to(wizard.pages.index(wizard.quality))
        made.wait(lambda: not wizard.quality.map.empty_label.text(), "map")
        made.settle()
        save(wizard, "quality")


def compare() -> None:
    """The patches of all methods beside the truth."""
    with stage(load_preset("simulator"), "sim:cup") as made:
        made.window.analysis.open("compare")
        analysis = made.window.analysis.window
        assert analysis is not None
        analysis.resize(1280, 860)
        tab = analysis.findChild(CompareTab)
        assert tab is not None
        compared: list[object] = []
        tab.shown.connect(compared.append)
        made.wait(lambda: compared and not tab.untouched.searching, "comparison")
        made.settle(2.0)
        save(analysis, "compare")


PICTURES: dict[str, Callable[[], None]] = {
    "window": window,
    "mask": mask,
    "panel-membrane": panel_membrane,
    "panel-tolerance": panel_tolerance,
    "suggestions": suggestions,
    "wizard-points": wizard_points,
    "quality": quality,
    "compare": compare,
}


def main() -> None:
    """Make the pictures that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--only", default=",".join(PICTURES), help="names of pictures, separated by commas")
    names = parser.parse_args().only.split(",")
    unknown = sorted(set(names) - set(PICTURES))
    if unknown:
        parser.error(f"no picture {', '.join(unknown)}; there are {', '.join(PICTURES)}")
    application = make_application()
    FOLDER.mkdir(exist_ok=True)
    for name in names:
        PICTURES[name]()
    application.quit()


if __name__ == "__main__":
    main()
