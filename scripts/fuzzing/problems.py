"""Valid problems of which something is known: their solution, its size, its contact, or that there is one.

Let w(x, y) be pulses along one coordinate, and L a lower bound of ‖σ‖, or ‖σ‖ itself:

- *f, c, κ*: u depends on x alone, so ‖σ‖ is that of a problem on an interval.
- *g_N, q_S*: the other side has u = 0, and no other flux enters. With v linear across, L = (σ, ∇v) = ∫w.
- *u_D, ψ*: with τ constant across, L = |(σ, τ)| is ∫w, and for u = −2 above and u ≥ w below it is 2 + ∫w.
- *obstacle*: −Δu ≥ 0, and u = 0 on both sides. With v = x(1 − x)/2, ∫u = (∇u, ∇v) ≥ ∫w and ‖∇v‖² = 1/12.
- *g* of a law of friction with u = 1 opposite: g is so small that u > 0, and L = ∫g.
"""

import json
import math
import random
from pathlib import Path

import numpy as np
import numpy.typing as npt
from broken_input import msh_text, square_msh
from makers.quantities import Known, bar, membrane
from scipy.linalg import solveh_banded

from fuzzing import CASE, OUTPUT, Broken, Valid
from fuzzing.judge import Ending, Runner, make_folders
from fuzzing.texts import LAWS
from signorini_fenicsx import Contact, Dirichlet, Signorini
from signorini_fenicsx.expressions import read, values
from signorini_fenicsx.quantities import Kind

NAMES = (
    r"$\bm{\sigma}$", "in_$flow_$", "$$", "$", r"\$", "$x^2$", "5$, $b", "a % $ \\", "接触 🦆", "{_^}", "$\\frac{1$",
    "#x", "$" + 400 * "{" + "$", 300 * "x", 90 * "long, ",
)  # fmt: skip
CONTROLS = ("\x1b[31m", "a\nb$\nc$", "\t", "\x00", "\u202eabc")
"""These are no names of parts in a file of Gmsh."""


def drawn(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A small valid problem of any physics, with pictures."""
    body, in_time = rng.random() < 0.4, rng.random() < 0.3
    names = rng.sample(NAMES, rng.choice([0, 1, 2, 4]))
    geo = ['SetFactory("OpenCASCADE");', "Rectangle(1) = {0, 0, 0, 1, 1};", "Mesh.MeshSizeMin = 0.5;"]
    geo += [f'Physical Curve("{name}") = {{{number}}};' for number, name in enumerate(names, start=1)]
    region = rng.choice(NAMES)
    (folder / "square.geo").write_text("\n".join([*geo, f'Physical Surface("{region}") = {{1}};']), encoding="utf-8")
    some = names[: rng.randrange(len(names) + 1)]
    lines = [f"title = {_toml(rng.choice([*NAMES, *CONTROLS]))}", *['physics = "elasticity"'] * body]
    lines += ["[geometry]", 'file = "square.geo"', "[boundary]"]
    lines += [f"{'contact' if body else 'signorini'} = [{', '.join(map(_toml, some))}]"] * bool(some)
    lines += ["[problem]", *(["young = 1", "poisson = 0.3", "f = [0, -0.01]"] if body else ["f = -1", "psi = -0.05"])]
    lines += ["[time]", "end = 1", "steps = 2"] * in_time
    if not body:
        drawable = [text for text in NAMES if len(text) <= 30 and text.isprintable()]
        lines += ["[plot]", *(f"{key} = {_toml(rng.choice(drawable))}" for key in ("u", "unit", "flux"))]
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = ["solve", "case.toml", "--output", OUTPUT, "--plot", *["--html"] * (not in_time)]
    about = f"{names}, contact on {len(some)} of them" + " in time" * in_time + " of a body" * body
    return Broken(words, about, solved=True, homeless=rng.random() < 0.5)


def _toml(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "")


BODIES = (
    ("square", ("bottom", "left", "right", "top"), 2), ("half_disk", ("arc", "diameter"), 2),
    ("lshape", ("bottom", "left", "right", "top"), 2),
    ("cube", ("bottom", "top", "left", "right", "front", "back"), 3),
)  # fmt: skip
FEW_GAPS = ("0", "0.01", "2*x^2", "5*(x - 0.3)^2", "1 if x > 0.4 else 0", "0.1*abs(x - 0.4)", "-0.01", "x/9")
POISSON = ("0", "0.3", "0.49", "0.4999999", "-0.5")
LOADS = ("0", "-0.02", "0.02", "-0.3", "-0.01*x", "0.05*(x - 0.5)", "sin(9*x)/50")
FEW = (0.36, 0.5, 0.8, 1.5)
"""Values of h in the plane; with these there are one to six facets of Γ_C on a side."""


def few_facets(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A valid case with few facets in contact; it may have no solution, but no bound of it may be beyond all sense."""
    shape, parts, dim = rng.choice(BODIES[:3] * 3 + BODIES[3:])
    order = rng.sample(parts, len(parts))
    number = rng.choice([1, 1, 2])
    contact, others = order[:number], order[number:]
    loaded = others[: rng.randrange(len(others) + 1)]
    held = [part for part in others if part not in loaded]
    fixed = {part: rng.choice(["x", "y", "n", "xy"]) for part in held if rng.random() < 0.6}

    def vector(entries: tuple[str, ...]) -> str:
        return "[" + ", ".join(f'"{rng.choice(entries)}"' for _ in range(dim)) + "]"

    lines = ['physics = "elasticity"', "[geometry]", f'shape = "{shape}"']
    lines += ["[boundary]", f"contact = {contact}", f"neumann = {loaded}"]
    lines += ["fixed = {" + ", ".join(f'{part} = "{way}"' for part, way in fixed.items()) + "}"]
    if dim == 2 and rng.random() < 0.3:
        bound = rng.choice(["mu = 0.3", "mu = 0.05", "mu = 0.9", "g = 0.004", 'g = "0.01*x^2"'])
        lines += ["[[law]]", 'kind = "friction"', f"parts = {contact[:1]}", bound]
    lines += ["[problem]", "young = 1", f"poisson = {rng.choice(POISSON)}", f'gap = "{rng.choice(FEW_GAPS)}"']
    lines += [f"f = {vector(LOADS[:3])}", f"u_D = {vector(('0', '0', '-0.01', '0.01*y'))}"]
    lines += [f"g_N = {{{loaded[0]} = {vector(LOADS)}}}"] if loaded else []
    lines += ["[solve]", f"h = {rng.choice(FEW) if dim == 2 else 1.7}"]
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    about = f"{shape}, contact on {', '.join(contact)}, loads on {', '.join(loaded)}, fixed {fixed}"
    return Broken(["solve", "case.toml", "--output", OUTPUT], about[:120], bounded=True)


GAPS = ("0", "0", "0.01*x", "max(0, x - 0.4)/50", "0.1*(x - 0.3)^2", "0.002*(1 - cos(20*x))", "0.3")
FRICTION = ("mu = 0.3", "g = 0.01", 'g = "0.02*x"')
LIFTED = """physics = "elasticity"
[geometry]
shape = "square"
[boundary]
contact = ["bottom"]
neumann = ["left", "right"]
[problem]
young = 1
poisson = 0.3
f = [0, 0]
u_D = [0, 0.1]
[solve]
h = 0.5
"""
"""A body without contact, from which others start."""


def opened(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """Loads that press on the whole, and lift some of it; in steps they press and lift in turn."""
    body, way = rng.random() < 0.6, rng.choice(["predicted", "start", "start", "steps"])
    size, tilt = 10 ** rng.uniform(-4, -1), rng.choice([0, 2, rng.uniform(-40, 40)])
    load = f"{-size}*(1 + {tilt}*(x - 0.5))" if way != "steps" else f"{size}*cos(pi*t)*(1 + {tilt}*(x - 0.5))"
    lines = ["[geometry]", 'shape = "square"', f'mesh = "{rng.choice(["structured", "unstructured"])}"', "[boundary]"]
    if body:
        loads = [f'f = [0, "{load}"]', f'g_N = {{top = ["0", "{load}"]}}']
        lines = ['physics = "elasticity"', *lines, 'contact = ["bottom"]', 'neumann = ["top", "right"]']
        lines += [f'fixed = {{left = "{"xy" if way == "steps" else "x"}"}}']
        if rng.random() < 0.3:
            lines += ["[[law]]", 'kind = "friction"', 'parts = ["bottom"]', rng.choice(FRICTION)]
        lines += ["[problem]", "young = 1", f"poisson = {rng.choice([0, 0.3, 0.45])}", f'gap = "{rng.choice(GAPS)}"']
        lines += rng.choice([loads[:1], loads]) if way == "steps" else rng.choice([loads[:1], ["f = [0, 0]", loads[1]]])
    else:
        lines += ['signorini = ["bottom"]', 'neumann = ["left", "right", "top"]', "[problem]"]
        lines += [f'psi = "-({rng.choice(GAPS)})"', f'f = "{load}"']
    lines += ["[time]", "end = 3", "steps = 3"] if way == "steps" else []
    lines += ["[solve]", f"h = {rng.uniform(0.031, 0.034) if way == 'predicted' else rng.uniform(0.1, 0.4)}"]
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = ["solve", "case.toml", "--output", OUTPUT]
    words += ["--start-from", str(valid.opened if body else valid.shape)] if way == "start" else []
    return Broken(words, f"{way}: {'; '.join(lines)}"[:400], solved=True, bounded=way != "steps")


FAR = (0.0, 0.0, 1.0, 1e2, 1e4, 5e5, 4e6, 1e8, 1e12, 1e15)
DIGITS = 1e-9
"""A rectangle whose smaller side is this share of its coordinates or more is to be solved."""


def far_place(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A body pressed onto one side of a rectangle, of any physics."""
    size = 10 ** rng.uniform(-6, 6)
    sides = [size, size * 10 ** rng.choice([0, 0, rng.uniform(-8, 0), rng.uniform(0, 2)])]
    rng.shuffle(sides)
    begins = [rng.choice((-1, 1)) * far * rng.choice([1, 1, size]) for far in rng.choices(FAR, k=2)]
    ends = [begin + side for begin, side in zip(begins, sides, strict=True)]
    real = [end - begin for begin, end in zip(begins, ends, strict=True)]
    shape = " x ".join(f"[{begin!r}, {end!r}]" for begin, end in zip(begins, ends, strict=True))
    part = rng.choice(["bottom", "top", "left", "right"])
    along, across = real if part in ("bottom", "top") else real[::-1]
    others = [side for side in ("bottom", "top", "left", "right") if side != part]
    opposite = {"bottom": "top", "top": "bottom", "left": "right", "right": "left"}[part]
    free = [side for side in others if side != opposite]
    lines = ["[geometry]", f'shape = "{shape}"', f'mesh = "{rng.choice(["structured", "unstructured"])}"']
    if rng.random() < 0.4:
        sign = -1 if part in ("bottom", "left") else 1
        push = [0.0, 0.0]
        push[part in ("bottom", "top")] = sign * 1e-3 * across
        lines = ['physics = "elasticity"', *lines, "[boundary]", f'contact = ["{part}"]', f"neumann = {free}"]
        lines += ["[problem]", "young = 1", "poisson = 0", f"u_D = {[repr(value) for value in push]}"]
    else:
        lines += ["[boundary]", f'signorini = ["{part}"]', f"neumann = {free}"]
        lines += ["[problem]", "f = 0", f"u_D = {-across!r}"]
    lines += ["[solve]", f"h = {max(min(real) / 3, max(real) / 40)!r}"]
    (folder / "case.toml").write_text("\n".join(lines).replace("'", '"') + "\n", encoding="utf-8")
    share = min(real) / max(map(abs, (*begins, *ends)))
    solved = share > DIGITS and max(real) <= 100 * min(real)
    contact = along if math.isfinite(along) and along > 0 else None
    words = ["solve", "case.toml", "--output", OUTPUT]
    return Broken(words, f"{shape}, {part}", solved=solved, contact=contact)


type Array = npt.NDArray[np.float64]

POINTS = 400_000
"""Intervals of the fine grid on which integrals are computed."""


def pulses(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A case with pulses in one datum, of which a guaranteed bound must not be below the error."""
    kind = rng.choice(["f", "f", "c", "c", "kappa", "g_N", "g_N", "q_S", "u_D", "psi", "obstacle", "g"])
    height = 10 ** (rng.uniform(-2, -0.1) if kind == "g" else rng.uniform(-2, 3))
    w = _train(rng, "y" if kind in ("g_N", "u_D") else "x")
    middle = (np.arange(POINTS) + 0.5) / POINTS
    shape = np.broadcast_to(values(read(w, "xy"), np.column_stack([middle, middle])), middle.shape)
    data, sides, law, flux = _posed(kind, w, height, shape, middle)
    if "psi" not in data and not law:
        data["psi"] = repr(-10 - 10 * height)
    lines = ["[geometry]", 'shape = "square"', f'mesh = "{rng.choice(["structured", "unstructured"])}"']
    lines += ["[boundary]", *(f"{name} = {json.dumps(parts)}" for name, parts in sides.items())]
    lines += [law, "[problem]", *(f"{name} = {json.dumps(text)}" for name, text in data.items())]
    lines += ["[solve]", f"h = {rng.choice([0.4, 0.25, 0.18, 0.125]) * rng.choice([1, 0.97])}"]
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = ["solve", "case.toml", "--output", OUTPUT]
    return Broken(words, f"{kind}: {height:.3g}*{w}"[:120], flux=flux, at_least=kind not in ("f", "c", "kappa"))


def _train(rng: random.Random, axis: str) -> str:
    """Pulses of height 1 along an axis, smooth or not, regular or alone."""
    place = repr(rng.choice([0.3, 1 / 3, 0.5, rng.random()]))
    width = 10 ** rng.uniform(-3.5, -1)
    if rng.random() < 0.35:
        return rng.choice(
            [
                f"exp(-(({axis} - {place})/{width!r})^2)",
                f"max(0, 1 - abs({axis} - {place})/{width!r})",
                f"(1 if abs({axis} - {place}) < {width!r} else 0)",
                f"sqrt(max(0, 1 - (({axis} - {place})/{width!r})^2))",
                f"max(0, 1 - (({axis} - {place})/{width!r})^2)^3",
            ]
        )
    n = rng.choice([3, 4, 8, 16, 20, 32, 64, 128])
    sharp, turn = rng.uniform(1, 150), rng.uniform(0, 6.3)
    wave = f"cos(2*pi*{n}*{axis} - {turn!r})"
    return rng.choice(
        [
            f"exp({sharp!r}*({wave} - 1))",
            f"max(0, {wave} - 0.9)*10",
            f"(1 if {wave} > 0.9 else 0)",
            f"((1 + {wave})/2)^{rng.randrange(2, 40)}",
            f"{wave}",
            f"1/(1 + {sharp!r}*(1 - {wave})^2)",
        ]
    )


def _posed(
    kind: str, w: str, height: float, shape: Array, x: Array
) -> tuple[dict[str, str], dict[str, list[str]], str, float]:
    """The data, the boundary parts, a law, and L for pulses of these values in points x."""
    mean, wave = height * float(shape.mean()), f"{height!r}*({w})"
    across = {"signorini": ["bottom"], "neumann": ["top"]}
    down = {"signorini": ["bottom"], "neumann": ["left", "right"]}
    nothing = {"f": "0"}
    match kind:
        case "f":
            return {"f": wave}, across, "", _of_load(height * shape)
        case "c":
            return nothing | {"c": f"{wave}^2", "u_D": "1"}, across, "", _of_reaction(height * shape**2)
        case "kappa":
            flux = 1 / np.mean(1 + height * shape**2)
            return nothing | {"kappa": f"1/(1 + {wave}^2)", "u_D": "x"}, across, "", float(flux)
        case "g_N":
            sides = {"signorini": ["bottom", "top"], "neumann": ["right"]}
            return nothing | {"g_N": wave}, sides, "", abs(mean)
        case "q_S":
            return nothing | {"q_S": wave}, down, "", abs(mean)
        case "u_D":
            return nothing | {"u_D": f"{wave}*(1 - x)"}, across, "", abs(mean)
        case "psi":
            return nothing | {"psi": wave, "u_D": repr(-2 * height)}, down, "", 2 * height + mean
        case "obstacle":
            area = float(np.maximum(height * shape * x * (1 - x), 0).mean())
            return nothing | {"obstacle": f"{wave}*x*(1 - x)"}, across, "", 12**0.5 * area
        case _:
            law = f'[[law]]\nkind = "friction"\nparts = ["bottom"]\ng = "{wave}^2"'
            flux = height * float((shape**2).mean())
            return nothing | {"u_D": "1"}, down | {"signorini": []}, law, flux


def _of_load(f: Array) -> float:
    """‖u'‖ on (0, 1) for −u″ = f, u = 0 at both ends."""
    flux = -np.concatenate([[0.0], np.cumsum(f) / len(f)])
    flux = (flux[1:] + flux[:-1]) / 2
    return float(np.sqrt(np.mean((flux - flux.mean()) ** 2)))


def _of_reaction(c: Array) -> float:
    """‖u'‖ on (0, 1) for −u″ + cu = 0, u = 1 at both ends, by linear elements."""
    n = len(c)
    around = (c[1:] + c[:-1]) / (3 * n)
    band = np.array([np.concatenate([[0.0], -n + c[1:-1] / (6 * n)]), 2 * n + around])
    load = np.zeros(n - 1)
    load[0] -= -n + c[0] / (6 * n)
    load[-1] -= -n + c[-1] / (6 * n)
    u = np.concatenate([[1.0], solveh_banded(band, load), [1.0]])
    return float(np.sqrt(n * (np.diff(u) ** 2).sum()))


IN_TABLES = {
    "flux": {"kind": "flux", "parts": ["left"]},
    "p": {"kind": "integral", "parts": ["left"]},
    "resultant": {"kind": "force", "parts": ["right"], "direction": [1, 0]},
}
"""Quantities that are in the tables, by the names that these have there."""


def quantities(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A membrane or a bar whose quantities are known, or any law on a side, steady or in time."""
    asked, values = {}, {}
    if rng.random() < 0.5:
        known = rng.choice([membrane, bar])(np.random.default_rng(rng.randrange(2**32)))
        lines, shown = _of_known(known)
        for kind, value in rng.sample(known.kinds, 2):
            name = f"number {len(asked)}"
            asked[name], values[name] = _keys(kind), value
    else:
        law, in_time = rng.choice(LAWS), rng.random() < 0.5
        lines, shown = ["[boundary]", 'neumann = ["top", "bottom"]', "[[law]]", 'parts = ["left"]'], ["flux", "p"]
        lines += [f"{key} = {value}" for key, value in law.items()]
        lines += ["[problem]", f'f = "{rng.uniform(-20, 20)} if y < {rng.random()} else {rng.uniform(-20, 20)}"']
        lines += [f"u_D = {rng.uniform(-1, 1)}", *(["[time]", "end = 1", "steps = 2"] if in_time else [])]
    for name, keys in (asked | {name: IN_TABLES[name] for name in shown}).items():
        lines += ["[[quantity]]", f'name = "{name}"', *(f"{key} = {json.dumps(value)}" for key, value in keys.items())]
    lines += ["[geometry]", 'shape = "square"', f'mesh = "{rng.choice(["structured", "unstructured"])}"']
    lines += ["[solve]", f"h = {rng.uniform(0.3, 0.7)}"]
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = ["solve", "case.toml", "--output", OUTPUT]
    return Broken(words, "; ".join(lines)[:400], solved=True, values=values, shown=shown)


def _of_known(known: Known) -> tuple[list[str], list[str]]:
    """The lines of a problem on the unit square that depends on x alone, and which quantities tables have of it."""
    left, right, _ = known.problem.conditions
    sides, f = {"neumann": ["top", "bottom"]}, json.dumps(known.problem.f)
    if isinstance(right, Contact):
        lines = ['physics = "elasticity"', "[boundary]", 'neumann = ["top", "bottom"]', 'contact = ["right"]']
        lines += ['fixed = {left = "xy"}', "[problem]", "young = 2", "poisson = 0"]
        return [*lines, f"u_D = {left.value}", f"gap = {right.gap}", f"f = {f}"], ["resultant"]
    data = {"kappa": known.problem.kappa, "f": known.problem.f, "u_D": repr(right.value)}
    if isinstance(left, Signorini):
        sides["signorini"], data["psi"] = ["left"], repr(left.psi)
    elif isinstance(left, Dirichlet):
        data["u_D"] = f"{right.value!r} if x > 1/2 else {left.value!r}"
    else:
        sides["neumann"].append("left")
        data["g_N"] = f"{left.value!r} if x < 1e-9 else 0"
    lines = ["[boundary]", *(f"{name} = {json.dumps(parts)}" for name, parts in sides.items())]
    lines += ["[problem]", *(f"{name} = {json.dumps(text)}" for name, text in data.items())]
    return lines, ["flux", "p"] if isinstance(left, Signorini) else []


def _keys(kind: Kind) -> dict[str, object]:
    """A quantity as a case file has it."""
    return {"kind": type(kind).__name__.lower()} | {key: value for key, value in vars(kind).items() if value}


def make_valid(pencil: Path, runner: Runner) -> Valid:
    """Make some results with the program itself.

    Raises:
        RuntimeError: If it fails.
    """
    root = pencil / "valid"
    make_folders(root)
    work = root / "work"
    (work / "square.msh").write_text(msh_text(*square_msh(3)), encoding="utf-8")
    text = CASE.format(file="square.msh", part="bottom")
    (work / "mesh.toml").write_text(text, encoding="utf-8")
    (work / "lifted.toml").write_text(LIFTED, encoding="utf-8")

    def check(ending: Ending) -> None:
        if ending.status != 0:
            raise RuntimeError(f"a valid case is not solved: {ending.said}")

    cases = {"shape": ["example1", "--h", "1/4"], "file": ["mesh.toml"], "opened": ["lifted.toml"]}
    for output, words in cases.items():
        runner.start(["solve", *words, "--output", output], root, check)
    runner.finish()
    return Valid(*(work / output for output in cases), pencil)
