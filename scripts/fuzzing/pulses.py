"""Pulses that may lie between the points of all quadratures, on every datum; the flux of the solution is known.

Let w(x, y) be such pulses along one coordinate, and L a lower bound of ‖σ‖, or ‖σ‖ itself:

- *f, c, κ*: u depends on x alone, so ‖σ‖ is that of a problem on an interval.
- *g_N, q_S*: the other side has u = 0, and no other flux enters. With v linear across, L = (σ, ∇v) = ∫w.
- *u_D, ψ*: with τ constant across, L = |(σ, τ)| is ∫w, and for u = −2 above and u ≥ w below it is 2 + ∫w.
- *obstacle*: −Δu ≥ 0, and u = 0 on both sides. With v = x(1 − x)/2, ∫u = (∇u, ∇v) ≥ ∫w and ‖∇v‖² = 1/12.
- *g* of a law of friction with u = 1 opposite: g is so small that u > 0, and L = ∫g.
"""

import json
import random
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.linalg import solveh_banded

from fuzzing.broken import OUTPUT, Broken, Valid
from signorini_fenicsx.expressions import read, values

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
