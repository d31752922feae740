"""Broken inputs of all kinds, the processes that run them, and the judge of the results."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "tests"))  # the folder of `broken_input`
