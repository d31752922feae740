"""Broken inputs of all kinds, the processes that they are given to, and the judge of what comes out."""

import sys
from pathlib import Path

for folder in ("scripts", "tests"):  # `fuzz_expressions` and `broken_input` are there
    sys.path.append(str(Path(__file__).parents[2] / folder))
