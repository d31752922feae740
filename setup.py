"""Puts `signorini_fenicsx.pth` beside the package, for which pyproject.toml has no key; all else is there."""

from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithStart(build_py):
    """Lets Python import the package when it starts, see `signorini_fenicsx.base.mpi_first`."""

    def run(self) -> None:
        """Write the file into the wheel, editable or not."""
        super().run()
        place = self.get_finalized_command("install").install_lib if self.editable_mode else self.build_lib
        Path(place, "signorini_fenicsx.pth").write_text("import signorini_fenicsx\n", encoding="utf-8")


setup(cmdclass={"build_py": BuildWithStart})
