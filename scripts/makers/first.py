"""Random first problems of engineers and hydrologists, as case files with the default options.

Even seeds are elastic: plates, brackets and blocks with holes, in the plane and in space, one body or two, with gaps,
weights, loads and heat, on supports, held by contact alone, or by friction alone. Odd seeds are water: hillslopes,
dams, aquifers with wells and rivers, in layers, some with thin barriers. Each has a solution, or a sentence says why
there is none (exit status 2). No run may fail (exit status 1).
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from makers import Found
from signorini_fenicsx import InputError, NumericalFailure
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case

NO_SOLUTION = ("can move rigidly", "slides away", "no solution", "cannot carry")
"""What is said of problems without a solution."""
AXES = "xyz"
FOLDER = Path("results/first")


@dataclass
class Geometry:
    """A text in Gmsh's language with named parts of the boundary.

    Attributes:
        dim: Its dimension.
        lines: The text up to its parts.
        inner: Names of parts inside.
        is_free: Whether some of the boundary is in no other part.
    """

    dim: int
    lines: list[str]
    inner: list[str] = field(default_factory=list)
    is_free: bool = True

    def part(self, name: str, low: list[float], high: list[float]) -> None:
        """Name what of the boundary is within a box; later names do not take what has one."""
        entity = "Curve" if self.dim == 2 else "Surface"
        box = [*np.subtract(low, 1e-4 * self.size), *np.add(high, 1e-4 * self.size)]
        numbers = ", ".join(f"{x:.9g}" for x in ([*box[:2], -1, *box[2:], 1] if self.dim == 2 else box))
        self.lines += [f"p() = {entity} In BoundingBox {{{numbers}}};"]
        if name in self.inner:
            self.lines += [f'p() -= r(); Physical {entity}("{name}") = {{p()}};']
        else:
            self.lines += [f'q() = p(); q() -= r(); p() -= q(); Physical {entity}("{name}") = {{p()}}; r() -= p();']

    def rest(self, name: str) -> str:
        """Name all other facets of the boundary; return the whole text."""
        last = f'Physical {"Curve" if self.dim == 2 else "Surface"}("{name}") = {{r()}};'
        return "\n".join([*self.lines, *([last] if self.is_free else [])])

    @property
    def size(self) -> float:
        """A length of it."""
        return float(self.lines[0].removeprefix("size = ").rstrip(";"))


def blocks(rng: np.random.Generator, dim: int, lengths: np.ndarray, *, bracket: bool, touching: bool) -> Geometry:
    """A block of these lengths, perhaps with holes or as an angle bracket, perhaps with another one on it."""
    size, last = float(lengths.min()), dim - 1
    h = float(lengths.max() / (rng.integers(8, 16) if dim == 2 else rng.integers(3, 5)))
    make = "Rectangle" if dim == 2 else "Box"
    entity = "Surface" if dim == 2 else "Volume"

    def block(number: int, low: np.ndarray, lengths: np.ndarray) -> str:
        values = [*low, 0, *lengths] if dim == 2 else [*low, *lengths]
        return f"{make}({number}) = {{{', '.join(f'{x:.9g}' for x in values)}}};"

    lines = [f"size = {size:.9g};", 'SetFactory("OpenCASCADE");', block(1, np.zeros(dim), lengths)]
    tops = [float(lengths[last])]
    if bracket:
        wall = np.where(np.arange(dim) == 0, 0.25, np.where(np.arange(dim) == last, rng.uniform(1, 3), 1.0)) * lengths
        lines += [block(2, np.zeros(dim), np.where(np.arange(dim) == last, lengths + wall, wall))]
        lines += [f"BooleanUnion{{ {entity}{{1}}; Delete; }}{{ {entity}{{2}}; Delete; }}"]
    elif touching:
        low, upper = np.zeros(dim), lengths * np.append(rng.choice([0.5, 1.0], last), rng.uniform(0.5, 1.5))
        low[last] = lengths[last]
        low[0] = rng.uniform(0, 1) * (lengths[0] - upper[0])
        lines += [block(2, low, upper)]
        lines += [f"BooleanFragments{{ {entity}{{1}}; Delete; }}{{ {entity}{{2}}; Delete; }}"]
        tops.append(float(lengths[last] + upper[last]))
    holes = int(rng.integers(0, 3)) if dim == 2 else int(rng.random() < 0.3)
    middles = []
    for hole in range(0 if bracket and dim == 2 else holes):
        radius = size * rng.uniform(0.12, 0.25)
        middles.append(np.array([lengths[0] * (0.6 + 0.25 * hole if holes > 1 else 0.6), lengths[1] / 2, radius]))
        x, y, _ = middles[-1]
        tool = (
            f"Disk(9) = {{{x:.9g}, {y:.9g}, 0, {radius:.9g}}};"
            if dim == 2
            else f"Cylinder(9) = {{{x:.9g}, {y:.9g}, {-size:.9g}, 0, 0, {sum(lengths) * 9:.9g}, {radius:.9g}}};"
        )
        if dim == 3 and touching:
            break
        lines += [tool, f"BooleanDifference{{ {entity}{{:}}; Delete; }}{{ {entity}{{9}}; Delete; }}"]
    lines += [f"MeshSize{{ PointsOf{{ {entity}{{:}}; }} }} = {h:.9g};", f"Mesh.MeshSizeMax = {h:.9g};"]
    lines += ["Mesh.MeshSizeFromCurvature = 8;"]
    lines += [f'Physical {entity}("body") = {{{entity}{{:}}}};' if not touching else ""]
    if touching:
        for name, low, high in (("lower", 0.0, tops[0]), ("upper", tops[0], tops[1])):
            box = [np.full(dim, -size), np.full(dim, 9 * lengths.sum())]
            box[0][last], box[1][last] = low - 1e-4 * size, high + 1e-4 * size
            numbers = [*box[0], -1, *box[1], 1] if dim == 2 else [*box[0], *box[1]]
            words = ", ".join(f"{x:.9g}" for x in numbers)
            lines += [f's() = {entity} In BoundingBox {{{words}}}; Physical {entity}("{name}") = {{s()}};']
    lines += [f"r() = Abs(CombinedBoundary{{ {entity}{{:}}; }});"]
    narrower = touching and bool((upper[:last] < lengths[:last]).any())
    geometry = Geometry(dim, lines, ["joint"] if touching else [], dim == 3 or bracket or narrower or len(middles) > 1)
    far = np.full(dim, 9 * lengths.sum())
    top = far.copy()
    top[last] = tops[-1] if not bracket else far[last]
    low = np.zeros(dim)

    def at(axis: int, value: float) -> tuple[list[float], list[float]]:
        one, two = -0.01 * far, far.copy()
        one[axis] = two[axis] = value
        return one.tolist(), two.tolist()

    geometry.part("bottom", *at(last, 0.0))
    if touching:
        geometry.part("joint", *at(last, tops[0]))
    geometry.part("left", *at(0, 0.0))
    geometry.part("right", *at(0, float(lengths[0])))
    geometry.part("top", *at(last, float(lengths[last] + wall[last]) if bracket else tops[-1]))
    if middles and not (dim == 3 and touching):
        x, y, radius = middles[0]
        low, high = [x - radius, y - radius, -size], [x + radius, y + radius, 9 * lengths.sum()]
        geometry.part("hole", low[:dim], high[:dim])
    return geometry


def elastic(rng: np.random.Generator) -> tuple[str, str]:
    """The geometry and the case of an engineer's problem."""
    dim = int(rng.choice([2, 2, 3]))
    unit = float(rng.choice([1e-3, 1.0, 1.0]))
    young = float(rng.choice([5.0, 2.6e3, 70e3, 210e3])) * (1e6 if unit < 1 else 1.0)
    lengths = unit * np.array([rng.uniform(20, 80), *rng.uniform(8, 40, dim - 1)])
    if rng.random() < 0.3:
        lengths[-1] = rng.uniform(0.1, 0.2) * lengths[0]  # a plate
    bracket, touching = ((True, False), (False, True), (False, False), (False, False))[int(rng.integers(4))]
    geometry = blocks(rng, dim, lengths, bracket=bracket, touching=touching)
    text, last, length = geometry.rest("free"), dim - 1, lengths[0]
    names = [name for name in ("left", "right", "top", "hole") if f'"{name}")' in text]
    stress = young * 10 ** rng.uniform(-6, -3)

    def gap() -> str:
        small = 10 ** rng.uniform(-5, -3)
        middle = length * rng.uniform(0.2, 0.8)
        return str(
            rng.choice(
                [
                    "0",
                    "0",
                    f"{small:.3g}*(x - {middle:.6g})^2/{length:.6g}",
                    f"max(0, {small:.3g}*(x - {middle:.6g}))",
                    f"{small:.3g}*x",
                    f"{small * length:.3g}*(1 - cos(6*x/{length:.6g}))",
                    f"{small * length:.3g}",
                ]
            )
        )

    def law(part: str) -> str:
        bound = [f"mu = {rng.uniform(0.1, 1):.2g}", f"g = {stress * rng.uniform(0.05, 1):.3g}"][int(rng.random() < 0.3)]
        kind = f'kind = "friction"\n{bound}' if rng.random() < 0.5 else 'kind = "contact"'
        apart = gap() if part == "bottom" or rng.random() < 0.4 else "0"
        return f'[[law]]\nparts = ["{part}"]\n{kind}\ngap = "{apart}"\n'

    fixed: dict[str, str] = {}
    hold = int(rng.integers(6))
    if hold == 0:
        fixed["left"] = AXES[:dim]
    elif hold == 1:
        fixed["left"] = "x"
    elif hold == 2 and "hole" in names:
        fixed["hole"] = "xy"
    elif hold == 3:
        fixed["left"], fixed["right"] = "x", "x"
    elif hold == 4:
        fixed["right"] = str(rng.choice(["n", AXES[:dim], AXES[last]]))
    if touching and rng.random() < 0.5:
        fixed.setdefault("top", str(rng.choice([AXES[:last], AXES[:dim]])))
    loads = {}
    if "top" not in fixed or fixed["top"] != AXES[:dim]:
        pull = np.zeros(dim)
        pull[last] = -stress * rng.uniform(0, 1)
        if rng.random() < 0.5:
            pull[0] = stress * rng.uniform(-0.3, 0.3)
        if dim == 3 and rng.random() < 0.3:
            pull[1] = stress * rng.uniform(-0.2, 0.2)
        if "top" in fixed:
            pull[[AXES.index(axis) for axis in fixed["top"]]] = 0.0
        loads["top"] = [f"{x:.4g}" for x in pull]
    if "right" not in fixed and rng.random() < 0.4:
        pull = np.zeros(dim)
        pull[[0, last]] = stress * rng.uniform(-0.3, 0.3), stress * rng.uniform(-0.2, 0.1)
        loads["right"] = [f"{x:.4g}" for x in pull]
    weight = ["0"] * last + [f"{-stress / length * rng.choice([0, 0.01, 0.3]):.4g}"]
    neumann = [name for name in [*names, *(["free"] if geometry.is_free else [])] if name not in fixed]
    lines = ['physics = "elasticity"', "[geometry]", 'file = "GEO"', "[boundary]", f"neumann = {neumann}"]
    if fixed:
        lines += [f"fixed = {{{', '.join(f'{k} = "{v}"' for k, v in fixed.items())}}}"]
    if touching:
        lines += ['inner = ["joint"]', 'sides = {joint = "upper"}']
    lines += [law(part) for part in ["bottom", *geometry.inner]]
    lines += ["[problem]", f"young = {young}", f"poisson = {rng.choice([0.0, 0.2, 0.3, 0.45])}", f"f = {weight}"]
    lines += [f"g_N = {{{', '.join(f'{k} = {v}' for k, v in loads.items())}}}"] if loads else []
    if rng.random() < 0.2:
        warm, cold, middle = rng.choice([1e-4, 1e-3]), rng.choice([0.0, 5e-4]), 0.5 * lengths[last]
        lines += [f'eigenstrain = "{warm} if {AXES[last]} < {middle:.6g} else {cold}"']
    if dim == 2 and rng.random() < 0.4:
        lines += ['plane = "stress"']
    return text, "\n".join(lines)


def water(rng: np.random.Generator) -> tuple[str, str]:
    """The geometry and the case of a hydrologist's problem; u is the head."""
    conductivity = 10 ** rng.uniform(-9, 1)
    rain = conductivity * 10 ** rng.uniform(-4, -0.5)

    def kappa(height: str, middle: float, depth: float) -> str:
        weak = conductivity * 10 ** rng.uniform(-6, 0)
        return str(
            rng.choice(
                [
                    f'"{conductivity:.3g}"',
                    f'"{conductivity:.3g} if {height} > {middle:.4g} else {weak:.3g}"',
                    f'"{conductivity:.3g}*exp({rng.uniform(-3, 3) / max(depth, 1e-9):.3g}*{height})"',
                    f'"{conductivity:.3g} if abs({height} - {middle:.4g}) > {0.1 * depth:.3g} else {weak:.3g}"',
                ]
            )
        )

    kind = int(rng.integers(4))
    if kind == 0:  # a section of a hillslope with a stream
        L, H = rng.uniform(20, 200), rng.uniform(3, 20)
        rise = rng.uniform(0, 0.5) * H
        n = int(rng.integers(12, 30))
        text = f"""Point(1) = {{0, 0, 0, {L / n:.4g}}}; Point(2) = {{{L:.6g}, 0, 0, {L / n:.4g}}};
Point(3) = {{{L:.6g}, {H + rise:.6g}, 0, {L / n:.4g}}}; Point(4) = {{0, {H:.6g}, 0, {L / n / 2:.4g}}};
Line(1) = {{1, 2}}; Line(2) = {{2, 3}}; Line(3) = {{3, 4}}; Line(4) = {{4, 1}};
Curve Loop(1) = {{1, 2, 3, 4}}; Plane Surface(1) = {{1}}; Physical Surface("soil") = {{1}};
Physical Curve("base") = {{1}}; Physical Curve("far") = {{2}}; Physical Curve("top") = {{3}};
Physical Curve("stream") = {{4}};"""
        stage = H * rng.uniform(0.3, 1.0)
        bank = [
            f'[[law]]\nparts = ["stream"]\nkind = "river"\nr = {rain * 10 ** rng.uniform(0, 3):.3g}\nlevel = {stage:.4g}\n'  # noqa: E501
            f"bed = {stage * rng.uniform(0.3, 0.9):.4g}",
            f'[[law]]\nparts = ["stream"]\nkind = "seepage"\nlevel = "max(y, {stage:.4g})"',
            "",
        ][int(rng.integers(3))]
        neumann = ["base", "far"]
        lines = [f'[[law]]\nparts = ["top"]\nkind = "seepage"\nrain = {rain:.4g}\nlevel = "y"', bank]
        lines += ["[problem]", "f = 0", f"kappa = {kappa('y', H / 2, H)}", f"u_D = {stage:.4g}"]
    elif kind == 1:  # a dam with a core
        H = rng.uniform(4, 30)
        crest, a, b = H * rng.uniform(0.2, 0.5), H * rng.uniform(0, 2), H * rng.uniform(0, 2)
        up, down = H * rng.uniform(0.4, 0.9), H * rng.uniform(0.02, 0.3)
        size = H / rng.integers(6, 14)
        X = [0, a * up / H, a, a + crest, a + crest + b * (1 - down / H), a + crest + b]
        Y = [0, up, H, H, down, 0]
        points = " ".join(
            f"Point({i + 1}) = {{{x:.6g}, {y:.6g}, 0, {size:.4g}}};" for i, (x, y) in enumerate(zip(X, Y, strict=True))
        )
        text = f"""{points}
Line(1) = {{1, 2}}; Line(2) = {{2, 3}}; Line(3) = {{3, 4}}; Line(4) = {{4, 5}}; Line(5) = {{5, 6}}; Line(6) = {{6, 1}};
Curve Loop(1) = {{1:6}}; Plane Surface(1) = {{1}}; Physical Surface("dam") = {{1}};
Physical Curve("upstream") = {{1}}; Physical Curve("top") = {{2, 3}}; Physical Curve("face") = {{4}};
Physical Curve("downstream") = {{5}}; Physical Curve("base") = {{6}};"""
        neumann = ["base", "top"]
        middle = (X[2] + X[3]) / 2
        lines = ['[[law]]\nparts = ["face"]\nkind = "seepage"\nlevel = "y"']
        lines += ["[problem]", "f = 0", f"kappa = {kappa('x', middle, crest)}"]
        lines += [f'u_D = "{up:.5g} if x < {middle:.5g} else {down:.5g}"']
        lines += [f'g_N = "{rain:.4g} if y > {0.99 * H:.5g} else 0"'] if rng.random() < 0.5 else []
    elif kind == 2:  # an aquifer from above, with wells and rivers
        L, W = round(rng.uniform(200, 2000)), round(rng.uniform(200, 2000))
        wells, size = int(rng.integers(1, 4)), max(L, W) / rng.integers(10, 20)
        parts = [f"Rectangle(1) = {{0, 0, 0, {L:.6g}, {W:.6g}}};"]
        for well in range(wells):
            x, y, r = L * (0.2 + 0.25 * well), W * rng.uniform(0.3, 0.7), 0.02 * min(L, W)
            parts += [f"Disk({well + 2}) = {{{x:.6g}, {y:.6g}, 0, {r:.6g}}};"]
        parts += [f"BooleanDifference{{ Surface{{1}}; Delete; }}{{ Surface{{2:{wells + 1}}}; Delete; }}"]
        text = "\n".join(
            [
                'SetFactory("OpenCASCADE");',
                *parts,
                f"Mesh.MeshSizeMax = {size:.5g}; Mesh.MeshSizeFromCurvature = 8;",
                "r() = Abs(CombinedBoundary{ Surface{:}; });",
                *(
                    f"p() = Curve In BoundingBox {{{x0 - 1e-3:.7g}, {y0 - 1e-3:.7g}, -1, {x1 + 1e-3:.7g}, {y1 + 1e-3:.7g}, 1}};"  # noqa: E501
                    f' Physical Curve("{name}") = {{p()}}; r() -= p();'
                    for name, x0, y0, x1, y1 in (
                        ("west", 0, 0, 0, W),
                        ("east", L, 0, L, W),
                        ("south", 0, 0, L, 0),
                        ("north", 0, W, L, W),
                    )
                ),
                'Physical Curve("wells") = {r()}; Physical Surface("aquifer") = {Surface{:}};',
            ]
        )
        level = rng.uniform(5, 50)
        pumped = conductivity * rng.uniform(0.001, 0.3)
        of_wells = [
            f'[[law]]\nparts = ["wells"]\nkind = "regulator"\nk = {conductivity * rng.uniform(0.1, 10):.3g}\n'
            f"g_low = {-pumped:.3g}\ng_high = 0\na = {level * rng.uniform(0.2, 0.8):.4g}",
            f'[[law]]\nparts = ["wells"]\nkind = "seepage"\nlevel = {level * rng.uniform(0.3, 1.1):.4g}',
            f'[[law]]\nparts = ["wells"]\nkind = "two-sided"\npsi = {level * 0.4:.4g}\npsi_upper = {level:.4g}\nq_S = {-pumped:.3g}',  # noqa: E501
        ][int(rng.integers(3))]
        leak = conductivity * 10 ** rng.uniform(-4, 0)
        river = f'[[law]]\nparts = ["west"]\nkind = "river"\nr = {leak:.3g}\nlevel = {level:.4g}\nbed = {level - rng.uniform(0.5, 4):.4g}'  # noqa: E501
        neumann = ["north", "south", *(["east"] if rng.random() < 0.4 else [])]
        lines = [of_wells, river, "[problem]", f"f = {rain / L * rng.choice([0, 1, 10]):.4g}"]
        lines += [f"kappa = {kappa('x', L / 2, L)}", f"u_D = {level * rng.uniform(0.9, 1.2):.4g}"]
        if rng.random() < 0.3:
            lines += [f"obstacle = {level * 0.3:.4g}"]
    else:  # a slice of soil in space under rain, with a drain
        L, W, H = round(rng.uniform(20, 100)), round(rng.uniform(20, 100)), round(rng.uniform(3, 15))
        size = max(L, W) / rng.integers(5, 8)
        text = f"""SetFactory("OpenCASCADE"); Box(1) = {{0, 0, 0, {L:.6g}, {W:.6g}, {H:.6g}}};
Mesh.MeshSizeMax = {size:.5g}; Physical Volume("soil") = {{1}}; r() = Abs(Boundary{{ Volume{{1}}; }});
t() = Surface In BoundingBox {{-1, -1, {H - 1e-3:.7g}, {L + 1:.7g}, {W + 1:.7g}, {H + 1e-3:.7g}}}; r() -= t();
d() = Surface In BoundingBox {{-0.001, -1, -1, 0.001, {W + 1:.7g}, {H + 1:.7g}}}; r() -= d();
Physical Surface("top") = {{t()}}; Physical Surface("drain") = {{d()}}; Physical Surface("sides") = {{r()}};"""
        neumann = ["sides"]
        lines = [f'[[law]]\nparts = ["top"]\nkind = "seepage"\nrain = {rain:.4g}\nlevel = {H:.5g}']
        lines += [f'[[law]]\nparts = ["drain"]\nkind = "seepage"\nlevel = "max(z, {H * rng.uniform(0.2, 0.8):.4g})"']
        lines += ["[problem]", "f = 0", f"kappa = {kappa('z', H / 2, H)}"]
    return text, "\n".join(["[geometry]", 'file = "GEO"', "[boundary]", f"neumann = {neumann}", *lines])


def problem(seed: int, folder: Path) -> Path:
    """Write the geometry and the case of a seed; return the path of the case."""
    rng = np.random.default_rng(seed)
    text, case = (water if seed % 2 else elastic)(rng)
    geometry, path = folder / f"first{seed}.geo", folder / f"first{seed}.toml"
    geometry.write_text(text + "\n")
    path.write_text(case.replace("GEO", geometry.name) + "\n")
    return path


def ending(path: Path) -> str:
    """What comes of a case: "solved", "no solution", or what is wrong (collective)."""
    try:
        solve_case(load_case(str(path)))
    except InputError as error:
        return "no solution" if any(words in str(error) for words in NO_SOLUTION) else f"refused: {error}"
    except NumericalFailure as error:
        return f"failed: {error}"
    return "solved"


def first_problem(seed: int) -> list[Found]:
    """Write a problem and solve it (collective)."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    result = ending(problem(seed, FOLDER))
    good = result in ("solved", "no solution")
    return [Found(result, [result if good else result.partition(":")[0]], wrong=not good, shown=False)]
