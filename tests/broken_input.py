"""Case files and meshes that are broken at random, from a seed, in likely and unlikely ways."""

import random
import re
import shutil
from collections.abc import Callable
from pathlib import Path

from signorini_fenicsx.base.shipped import data_folder

JUNK = (
    "true", "-1", "0", "[]", "{}", '""', '"nonsense"', "nan", "inf", "1e999", "-1e308", "[[[[1]]]]",
    "{a = {b = {c = 1}}}", "1979-05-27", "\"__import__('os').system('true')\"", '"' + "(" * 500 + '"', '"x" * 3',
    "9" * 400, '["bottom", 3, false]', '"\\u0000"',
)  # fmt: skip


def write_broken_case(folder: Path, rng: random.Random, index: int) -> Path:
    """Write a case that is broken in one to three places; a few stay valid."""
    for name in ("dam.msh", "electropainting.msh"):
        if not (folder / name).exists():
            shutil.copyfile(data_folder("meshes") / name, folder / name)
    original = rng.choice(sorted(data_folder("cases").glob("*.toml")))
    text = original.read_text(encoding="utf-8").replace("../meshes/", "")
    path = folder / f"case{index}.toml"
    data = text.encode()
    for _ in range(rng.randint(1, 3)):
        data = rng.choice(CASE_MUTATIONS)(rng, data)
    path.write_bytes(data)
    return path


def _key_lines(lines: list[str]) -> list[int]:
    return [i for i, line in enumerate(lines) if re.match(r"\s*\w+\s*=", line)]


def _in_lines(change: Callable[[random.Random, list[str]], None]) -> Callable[[random.Random, bytes], bytes]:
    def mutation(rng: random.Random, data: bytes) -> bytes:
        lines = data.decode(errors="replace").splitlines()
        if lines and _key_lines(lines):
            change(rng, lines)
        return "\n".join(lines).encode()

    return mutation


def _value(rng: random.Random, lines: list[str]) -> None:
    i = rng.choice(_key_lines(lines))
    lines[i] = lines[i].partition("=")[0] + "= " + rng.choice(JUNK)


def _rename(rng: random.Random, lines: list[str]) -> None:
    i = rng.choice(_key_lines(lines))
    lines[i] = lines[i].replace(lines[i].strip()[0], rng.choice("qxZ_"), 1)


def _delete(rng: random.Random, lines: list[str]) -> None:
    del lines[rng.randrange(len(lines))]


def _repeat(rng: random.Random, lines: list[str]) -> None:
    i = rng.choice(_key_lines(lines))
    lines.insert(i, lines[i])


def _section(rng: random.Random, lines: list[str]) -> None:
    header = rng.choice(["[solve]", "[nothing]", "[problem.f]", "[[geometry]]", "[", "]]"])
    lines.insert(rng.randrange(len(lines)), header)


def _letter(rng: random.Random, lines: list[str]) -> None:
    i = rng.choice(_key_lines(lines))
    at = rng.randrange(len(lines[i]))
    lines[i] = lines[i][:at] + rng.choice("'\"\\[]{}=,()^*xyzf5 \t") + lines[i][at + 1 :]


def _cut(rng: random.Random, data: bytes) -> bytes:
    return data[: rng.randrange(len(data))] if data else data


def _binary(rng: random.Random, data: bytes) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.randbytes(rng.randint(1, 40)) + data[at:]


CASE_MUTATIONS = [*map(_in_lines, (_value, _value, _rename, _delete, _repeat, _section, _letter)), _cut, _binary]

CASE_FOR_MESH = """
[geometry]
file = "{file}"
[boundary]
signorini = ["bottom"]
dirichlet = ["others"]
[problem]
f = "10*(x - 0.4)"
"""


def square_msh(n: int) -> tuple[list[str], list[str]]:
    """Nodes and elements of a square in Gmsh's format 2.2, as lines; bottom is group 1, the other sides are group 2."""
    number = {(i, j): 1 + i + (n + 1) * j for j in range(n + 1) for i in range(n + 1)}
    nodes = [f"{k} {i / n!r} {j / n!r} 0" for (i, j), k in number.items()]
    lines = [(1, number[i, 0], number[i + 1, 0]) for i in range(n)]
    lines += [(2, number[i, n], number[i + 1, n]) for i in range(n)]
    lines += [(2, number[a, j], number[a, j + 1]) for j in range(n) for a in (0, n)]
    elements = [f"1 2 {group} {group} {a} {b}" for group, a, b in lines]
    for i in range(n):
        for j in range(n):
            a, b, c, d = number[i, j], number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]
            elements += [f"2 2 3 3 {a} {b} {c}", f"2 2 3 3 {a} {c} {d}"]
    return nodes, [f"{k} {element}" for k, element in enumerate(elements, 1)]


def msh_text(nodes: list[str], elements: list[str]) -> str:
    """A mesh in Gmsh's format 2.2."""
    return "\n".join(
        [
            *("$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", "3"),
            *('1 1 "bottom"', '1 2 "others"', '2 3 "inside"', "$EndPhysicalNames"),
            *("$Nodes", str(len(nodes)), *nodes, "$EndNodes"),
            *("$Elements", str(len(elements)), *elements, "$EndElements", ""),
        ]
    )


def write_broken_mesh(folder: Path, rng: random.Random, index: int) -> Path:
    """Write a case with a mesh that is broken in one of the known ways; all of them are refused."""
    nodes, elements = square_msh(4)
    mutation = MESH_MUTATIONS[index % len(MESH_MUTATIONS)]
    result = mutation(rng, nodes, elements)
    data = msh_text(nodes, elements).encode() if result is None else result
    (folder / f"mesh{index}.msh").write_bytes(data)
    path = folder / f"mesh{index}.toml"
    path.write_text(CASE_FOR_MESH.format(file=f"mesh{index}.msh"), encoding="utf-8")
    return path


type Mutation = Callable[[random.Random, list[str], list[str]], bytes | None]


def _truncated(rng: random.Random, nodes: list[str], elements: list[str]) -> bytes:
    data = msh_text(nodes, elements).encode()
    return data[: rng.randrange(data.index(b"$Nodes"), data.index(b"$EndElements") - 40)]


def _empty(rng: random.Random, nodes: list[str], elements: list[str]) -> bytes:
    return b""


def _prose(rng: random.Random, nodes: list[str], elements: list[str]) -> bytes:
    return b'SystemCall "touch hacked";\n' * rng.randint(1, 5)


def _noise(rng: random.Random, nodes: list[str], elements: list[str]) -> bytes:
    return b"$MeshFormat\n4.1 1 8\n" + rng.randbytes(rng.randint(10, 3000))


def _not_finite(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    k = rng.randrange(len(nodes))
    nodes[k] = f"{k + 1} {rng.choice(['nan', 'inf', '-inf'])} 0 0"


def _deleted_node(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    del nodes[rng.randrange(len(nodes))]


def _coinciding_nodes(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    cell = rng.choice([line for line in elements if line.split()[1] == "2"]).split()
    a, b = int(cell[5]), int(cell[6])
    nodes[b - 1] = f"{b} " + nodes[a - 1].split(maxsplit=1)[1]


def _folded(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    k = 12  # the middle of the square
    nodes[k] = f"{k + 1} {rng.uniform(1.1, 3)} {rng.uniform(1.1, 3)} 0"


def _out_of_plane(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    k = rng.randrange(len(nodes))
    nodes[k] = nodes[k].rsplit(maxsplit=1)[0] + f" {rng.uniform(0.01, 5)}"


def _quadrilateral(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    elements.append(f"{len(elements) + 1} 3 2 3 3 1 2 7 6")


def _second_order(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    for i, line in enumerate(elements):
        number, kind, *rest = line.split()
        if kind == "2":
            elements[i] = " ".join([number, "9", *rest, *map(str, rng.sample(range(1, 26), 3))])


def _doubled_cell(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    cell = rng.choice([line for line in elements if line.split()[1] == "2"]).split()
    elements.append(" ".join([str(len(elements) + 1), *cell[1:]]))


def _third_cell(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    nodes.append(f"26 {rng.uniform(0.3, 0.5)} {rng.uniform(0.1, 0.4)} 0")
    elements.append(f"{len(elements) + 1} 2 2 3 3 7 13 26")


def _hanging(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    cells = [k for k, line in enumerate(elements) if line.split()[1] == "2"][::2]  # each has an edge a, c with the next
    k = rng.choice(cells)
    *about, a, b, c = elements[k].split()
    x, y = (sum(float(nodes[int(end) - 1].split()[i]) for end in (a, c)) / 2 for i in (1, 2))
    nodes.append(f"26 {x} {y} 0")
    elements[k] = " ".join([*about, a, b, "26"])
    elements.append(" ".join([str(len(elements) + 1), *about[1:], "26", b, c]))


def _no_group(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    elements[:] = [line for line in elements if line.split()[1:4] != ["1", "2", "1"]]


def _left_facet(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    del elements[rng.randrange(4, 16)]


def _overlap(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    line = elements[rng.randrange(4)].split()
    elements.append(" ".join([str(len(elements) + 1), "1", "2", "2", "9", *line[5:]]))


def _inside(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    elements.append(f"{len(elements) + 1} 1 2 {rng.choice([1, 2])} 9 7 13")


def _nowhere(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    elements.append(f"{len(elements) + 1} 1 2 {rng.choice([1, 2])} 9 1 25")


def _no_cells(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    elements[:] = [line for line in elements if line.split()[1] == "1"]


def _floating_component(rng: random.Random, nodes: list[str], elements: list[str]) -> None:
    nodes += ["26 5 5 0", "27 6 5 0", "28 5 6 0"]
    more = ["2 2 3 3 26 27 28", "1 2 1 1 26 27", "1 2 1 1 27 28", "1 2 1 1 28 26"]
    elements += [f"{number} {element}" for number, element in enumerate(more, len(elements) + 1)]


def _wrong_count(rng: random.Random, nodes: list[str], elements: list[str]) -> bytes:
    where, count = rng.choice([("Nodes", len(nodes)), ("Elements", len(elements))])
    wrong = rng.choice([count // 2, -3, 10**9, 10**30])
    return msh_text(nodes, elements).replace(f"${where}\n{count}", f"${where}\n{wrong}").encode()


MESH_MUTATIONS: list[Mutation] = [
    *(_truncated, _empty, _prose, _noise, _not_finite, _deleted_node, _coinciding_nodes, _folded, _out_of_plane),
    *(_quadrilateral, _second_order, _doubled_cell, _third_cell, _hanging, _no_group, _left_facet, _overlap, _inside),
    *(_nowhere, _no_cells, _floating_component, _wrong_count),
]
