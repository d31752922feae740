"""The command that writes a first case: init."""

import sys
import tomllib
from pathlib import Path
from typing import Annotated

import typer
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.text import did_you_mean
from signorini_fenicsx.cli.report import Report


def init(
    case: Annotated[Path, typer.Argument(help="The file to write.")] = Path("my-case.toml"),
    shape: Annotated[str | None, typer.Option("--shape", help="A named shape, or '[-2, 2] x [0, 1]'.")] = None,
    mesh: Annotated[str | None, typer.Option("--mesh", help="A file instead: .msh, .geo, .step, …")] = None,
    body: Annotated[
        list[str] | None,
        typer.Option("--body", metavar="NAME=FILE", help="One of several bodies, with its mesh."),
    ] = None,
    physics: Annotated[str | None, typer.Option("--physics", help="diffusion (the default) or elasticity.")] = None,
    on: Annotated[
        list[str] | None,
        typer.Option("--on", metavar="PART=CONDITION", help="What holds on a part, or on several: left,right=neumann."),
    ] = None,
    title: Annotated[str, typer.Option("--title", help="Title of the case.")] = "My problem",
) -> None:
    """Write a first case file, from options or, on a terminal, from a few answers; check it as `check` does.

    On parts without a condition u is given. Conditions: dirichlet, neumann, and the laws of case files; with
    elasticity also contact and symmetry. Parts of different bodies that are near one another become pairs in contact;
    a condition on one of them is the kind of the pair, such as tied.

    Examples:
      signorini init
      signorini init my-dam.toml --mesh dam.msh --on face=seepage --on base=neumann
      signorini init block.toml --physics elasticity --on bottom=friction --on left,right=neumann
      signorini init press.toml --body punch=punch.msh --body die=die.msh --on punch.sides,die.sides=neumann
    """
    comm, report = MPI.COMM_WORLD, Report()
    if sum(map(bool, (shape, mesh, body))) > 1:
        raise InputError("init: give one of --shape, --mesh and --body")
    conditions, bodies = _conditions(on or []), _bodies(body or [])
    physics = physics or ("elasticity" if bodies else None)

    def text() -> str:
        from signorini_fenicsx.cases.first_case import Place, case_text, first_law
        from signorini_fenicsx.solving.physics import DIFFUSION

        if case.suffix != ".toml":
            raise InputError(f"init: {case} must end in .toml")
        if case.exists():
            raise InputError(f"init: {case} exists already; choose another name")
        if conditions or not sys.stdin.isatty():
            place = Place.of_bodies(bodies, case.parent) if bodies else Place.of(mesh or shape or "square", case.parent)
            if not conditions and not place.pairs:
                example = f"--on {place.parts[0] if place.parts else 'PART'}={first_law(physics or DIFFUSION)}"
                raise InputError(f"init: give a condition, such as {example}; the parts are {', '.join(place.parts)}")
            return case_text(title, place, physics or DIFFUSION, conditions)
        return _asked(case, bodies or mesh or shape, physics, title)

    _write(case, on_root(comm, text), comm)
    report.line(f"{case} is written and can be solved: signorini solve {case} --plot")


def _conditions(on: list[str]) -> dict[str, str]:
    """The word for each part that `--on` gives.

    Raises:
        InputError: If one is not PART=CONDITION, or a part has two.
    """
    conditions: dict[str, str] = {}
    for entry in on:
        parts, separator, word = entry.rpartition("=")
        for part in parts.split(","):
            if not separator or not part.strip() or not word:
                raise InputError(f"--on {entry}: must be PART=CONDITION, such as bottom=signorini")
            if part.strip() in conditions:
                raise InputError(f"--on {entry}: '{part.strip()}' has a condition already")
            conditions[part.strip()] = word.strip()
    return conditions


def _bodies(given: list[str]) -> dict[str, str]:
    """The mesh file of each body that `--body` gives.

    Raises:
        InputError: If one is not NAME=FILE, or there is but one.
    """
    from signorini_fenicsx.meshes.bodies import check_name

    bodies = dict[str, str]()
    for entry in given:
        name, _, file = entry.partition("=")
        if not name or not file or name in bodies:
            raise InputError(f"--body {entry}: must be NAME=FILE with a name of its own, such as punch=punch.msh")
        check_name(name)
        bodies[name] = file
    if len(bodies) == 1:
        raise InputError("init: one body is a --mesh; give --body for each of several")
    return bodies


def _asked(case: Path, where: str | dict[str, str] | None, physics: str | None, title: str) -> str:
    """The text of a case from answers (rank 0).

    Raises:
        InputError: If the answers end too early, or the mesh cannot be used.
    """
    from signorini_fenicsx.cases.first_case import GIVEN, HELD, SYMMETRIC, Place, case_text, first_law, words
    from signorini_fenicsx.meshes.shapes import SHAPES
    from signorini_fenicsx.solving.physics import DIFFUSION, PHYSICS

    try:
        where = where or typer.prompt(f"Shape ({', '.join(SHAPES)}, '[-2, 2] x [0, 1]') or mesh file", "square")
        place = Place.of(where, case.parent) if isinstance(where, str) else Place.of_bodies(where, case.parent)
        physics = physics or _choice("Physics", tuple(PHYSICS), DIFFUSION)
        typer.echo(f"Conditions: {', '.join(words(physics))}")
        conditions, kinds = dict[str, str](), PHYSICS[physics].case.first_pairs
        pairs = place.pairs if kinds else ()
        for pair in pairs:
            conditions[pair.slave] = _choice(f"  between {pair.slave} and {pair.master}", kinds, kinds[0])
        paired = [part for pair in pairs for part in (pair.slave, pair.master)]
        others = [part for part in place.parts if part not in paired]
        for left, part in enumerate(others, start=1 - len(others)):  # one part has a law, at last the last
            has_law = not {HELD, GIVEN, SYMMETRIC}.issuperset(conditions.values())
            default = HELD if left or has_law else first_law(physics)
            conditions[part] = _choice(f"  on {part}", words(physics), default)
    except typer.Abort:
        raise InputError("init: the answers ended; nothing is written") from None
    return case_text(title, place, physics, {part: word for part, word in conditions.items() if word != HELD})


def _choice(question: str, words: tuple[str, ...], default: str) -> str:
    """Ask for one of these words until it is one."""
    while (answer := typer.prompt(question, default).strip()) not in words:
        typer.echo(f"  unknown: use one of {', '.join(words)}{did_you_mean(answer, words)}")
    return str(answer)


def _write(case: Path, text: str, comm: MPI.Comm) -> None:
    """Write a case if it can be solved (collective).

    Raises:
        InputError: If it cannot, or the file cannot be written.
    """
    from signorini_fenicsx.cases import inspection
    from signorini_fenicsx.cases.case import case_of, seen_from_here

    first = on_root(comm, lambda: case_of(seen_from_here(tomllib.loads(text), case.parent), case))
    inspection.check(first, comm)
    on_root(comm, lambda: _put(case, text))


def _put(case: Path, text: str) -> None:
    try:
        with case.open("x", encoding="utf-8") as file:  # through no link
            file.write(text)
    except OSError as error:
        raise InputError(f"init: {case}: cannot be written ({error.strerror})") from None
