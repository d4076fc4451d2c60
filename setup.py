"""Build step of wheels: the guide as web pages, which Help > Documentation opens. All else is in pyproject.toml."""

import os
import subprocess
import sys
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithGuide(build_py):
    """Copies the packages and builds the guide beside them; an editable install gets it from `make guide`."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            site = Path(self.build_lib).resolve() / "tactune" / "app" / "guide"
            command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--config-file", "docs/mkdocs.yml"]
            environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
            subprocess.run([*command, "--site-dir", str(site)], check=True, env=environment)


setup(cmdclass={"build_py": BuildWithGuide})
