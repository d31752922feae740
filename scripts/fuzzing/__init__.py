"""Broken inputs of all kinds, the processes that run them, and the judge of the results."""

import sys
from pathlib import Path

for folder in ("scripts", "tests"):  # folders of `fuzz_expressions` and `broken_input`
    sys.path.append(str(Path(__file__).parents[2] / folder))
