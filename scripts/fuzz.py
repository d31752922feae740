"""Breaks inputs of all kinds, runs the program on each in a separate process, and prints a table of the results.

    uv run python scripts/fuzz.py --count 2000 [--seed 0] [--kind mesh --kind geo] [--ranks 2]
    uv run python scripts/fuzz.py --only mesh17 [--seed 0]      # that input again; its folder is kept

Each input is run in a folder with files of the user. It must be solved (0), fail (1) or be refused (2) with one
sentence. For no input may the program crash, hang, write outside the output folder or lose a file. The columns on the
right, explained in `fuzzing/judge.py`, count such events; if one of them is not 0, the exit status is 1. Seed, kind and
number determine the input.
"""

import argparse
import random
import shlex
import shutil
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from importlib import import_module
from pathlib import Path

from fuzzing import put_configuration
from fuzzing.judge import (
    BAD,
    ENDINGS,
    Ending,
    Runner,
    Verdict,
    begin_again,
    import_everything,
    judged,
    make_folders,
    put_files_of_the_user,
    snapshot,
)

KINDS = {
    **{"case": ("texts", "case_file"), "option": ("texts", "option"), "mesh": ("files", "mesh_file")},
    **{"geo": ("files", "geometry"), "checkpoint": ("files", "checkpoint"), "study": ("texts", "study")},
    **{"forged": ("files", "forged"), "killed": ("texts", "killed")},
}
"""For each kind of input the module of `fuzzing` with the function that makes it."""


def main() -> None:
    """Run all inputs; print each bad outcome at once, and the table at the end."""
    options = _options()
    begin_again()
    pencil = Path(tempfile.mkdtemp(prefix="signorini-fuzz-"))
    import_everything(pencil)
    fuzz = Fuzz(pencil, options.seed, Runner(options.jobs, options.ranks))
    began = time.monotonic()
    if options.only:
        fuzz.replay(options.only)
        return
    kinds = options.kind or list(KINDS)
    for number in range(options.count):
        fuzz.run(kinds[number % len(kinds)], number // len(kinds))
    fuzz.runner.finish()
    seconds = (time.monotonic() - began) / options.count
    print(fuzz.table())
    print(f"{options.count} inputs, seed {options.seed}, {seconds:.2f} s each with {options.jobs} at a time")
    shutil.rmtree(pencil)
    sys.exit(1 if fuzz.found_bad else 0)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for option, default in (("--count", 2000), ("--seed", 0), ("--ranks", 1), ("--jobs", 2)):
        parser.add_argument(option, type=int, default=default)
    parser.add_argument("--kind", action="append", choices=KINDS, help="only this kind; may be repeated")
    parser.add_argument("--only", help="run this input alone and keep its folder")
    return parser.parse_args()


class Fuzz:
    """Makes, runs and judges inputs, and counts the verdicts."""

    def __init__(self, pencil: Path, seed: int, runner: Runner):
        self._generators = {
            kind: getattr(import_module(f"fuzzing.{module}"), name) for kind, (module, name) in KINDS.items()
        }
        self._pencil, self._seed, self.runner = pencil, seed, runner
        self._valid = import_module("fuzzing.files").make_valid(pencil, runner)
        self._counts: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}

    def run(self, kind: str, index: int, keep: bool = False) -> None:
        """Make an input and start its run, which is judged later."""
        name = f"{kind}{index}"
        root = self._pencil / name
        rng = random.Random(f"{self._seed}/{name}")
        make_folders(root)
        (root / "home" / ".profile").write_text("the user's", encoding="utf-8")
        (root / "work" / "notes.txt").write_text("the user's", encoding="utf-8")
        broken = self._generators[kind](rng, root / "work", self._valid)
        if rng.random() < 0.5:
            put_configuration(rng, root / "work")
        if broken.earlier:
            shutil.copytree(self._valid.shape, root / "work" / "out")
            put_files_of_the_user(root / "work" / "out")
        before = snapshot(root)

        def done(ending: Ending) -> None:
            after = {path: digest for path, digest in snapshot(root).items() if not path.startswith("said/")}
            verdict = judged(broken, ending, before, after, root)
            self._counts[kind].update([verdict.ending, *verdict.bad])
            if verdict.bad or keep:
                self._show(name, broken.about, broken.words, verdict)
            if not keep:
                shutil.rmtree(root)

        start = partial(self.runner.start, broken.words, root, homeless=broken.homeless)
        if broken.killed is None:
            start(done)
        else:
            start(lambda _: start(done), seconds=broken.killed)

    def _show(self, name: str, about: str, words: list[str], verdict: Verdict) -> None:
        command = shlex.join(["signorini", *words])[:200]
        line = f"{name}: {verdict.ending}, {', '.join(sorted(verdict.bad)) or 'good'} | {about} | {command}"
        print("".join(c if c.isprintable() else repr(c)[1:-1] for c in line))
        for detail in verdict.details:
            print("    " + detail.replace("\n", "\n    "), flush=True)

    def replay(self, name: str) -> None:
        """Run one input alone, show all its output, and keep its folder."""
        kind = name.rstrip("0123456789")
        self.run(kind, int(name.removeprefix(kind)), keep=True)
        self.runner.finish()
        said = self._pencil / name / "said"
        print(*((said / stream).read_text(errors="replace") for stream in ("stdout", "stderr")), sep="\n")
        print(f"kept: {self._pencil / name}")

    @property
    def found_bad(self) -> bool:
        """Whether anything was bad."""
        return any(counts[bad] for counts in self._counts.values() for bad in BAD)

    def table(self) -> str:
        """Verdicts by kind."""
        columns = [*ENDINGS.values(), *BAD]
        total: Counter[str] = sum(self._counts.values(), Counter())
        lines = [f"{'kind':<11}" + " ".join(f"{column:>9}" for column in columns)]
        for kind, counts in [*self._counts.items(), ("all", total)]:
            lines.append(f"{kind:<11}" + " ".join(f"{counts[column]:>9}" for column in columns))
        return "\n".join(lines)


if __name__ == "__main__":
    main()
