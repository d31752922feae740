"""The law of the material, ε = 𝔸σ + ε₀, in points: isotropic or orthotropic, with strain or stress of its own.

𝔸 is made in space, where it acts on six entries. In plane stress, σ_zz = 0, its rows of the plane are taken; in plane
strain, ε_zz = 0, σ_zz is eliminated: 𝔸_ij − 𝔸_iz 𝔸_zj/𝔸_zz, and likewise of ε₀. A stress σ₀ without strain is the ε₀ of
−𝔸σ₀.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, ClassVar

import numpy as np
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.tolerances import ROUNDING
from signorini_fenicsx.discrete.data_values import check_means, extent
from signorini_fenicsx.discrete.datum import Datum, largest_degree, regional_datum
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.part_laws import COMPLEX_STEP
from signorini_fenicsx.discrete.points import CellPoints
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import entries, symmetric, to_entries
from signorini_fenicsx.physics.elasticity.problem import ElasticProblem, PlaneState

SPACE = entries(3)
BEYOND = SPACE.index((2, 2))
POSITIVE = 1e-12
"""Least eigenvalue of the 𝔸 of three normal stresses, of diagonal 1."""
STIFF_VOLUME = 1e6
"""The bulk modulus over 2μ that stands for none that is finite, see `regular`."""
DEPENDENT = 1e-6
"""Directions whose part across the others is less than this share are no axes."""


@dataclass(frozen=True)
class Strain:
    """A symmetric matrix on the mesh: a number times the unit matrix of space, or a matrix in the plane or in space.

    Attributes:
        name: Its key.
        datum: The number or the matrix.
        beyond: In the plane its zz.
    """

    name: str
    datum: Datum
    beyond: Datum

    def values(self, points: CellPoints) -> Array:
        """Entries of the eigenstrain in space, shape (cells, points, 6) (collective)."""
        values, dim = self.datum.values(points), points.mesh.geometry.dim
        if not self.datum.shape:
            values = values[..., None, None] * np.eye(dim)
        beyond = self.beyond.values(points) if dim == 2 else values[..., 2, 2]
        matrix = np.zeros((*points.shape, 3, 3), dtype=np.result_type(values, beyond))
        matrix[..., 2, 2] = beyond
        matrix[..., :dim, :dim] = values
        return to_entries(matrix)


@dataclass(frozen=True)
class _Moved:
    """A datum, or the entry of a matrix, with an imaginary step."""

    datum: Datum
    entry: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        return self.datum.shape

    def values(self, points: CellPoints) -> Array:
        step = np.zeros(self.datum.shape)
        step[self.entry] = COMPLEX_STEP
        return self.datum.values(points) + 1j * step


@dataclass(frozen=True)
class Material:
    """The law on a mesh.

    Attributes:
        dim: d.
        plane: What a problem in the plane is a section of.
        young: E, or E₁, E₂, E₃ along the axes.
        poisson: ν, or ν₁₂, ν₁₃, ν₂₃: under a stress along the first axis alone ε₂ = −ν₁₂ε₁.
        shear: G₁₂, G₁₃, G₂₃, with 0 for E₁/(2 + 2ν₁₂); none where the material is isotropic.
        axes: The components of the directions 1 and, in space, 2; none for those of the coordinates.
        strains: ε₀ and −σ₀, where they are given.
    """

    dim: int
    plane: str
    young: tuple[Datum, ...]
    poisson: tuple[Datum, ...]
    shear: tuple[Datum, ...]
    axes: tuple[tuple[Datum, ...], ...]
    strains: tuple[Strain, ...]

    incompressible = False
    words: ClassVar[tuple[str, ...]] = ("young", "poisson")

    def seen(self, stresses: Array) -> Array:
        """What of stresses, the last two axes, has an energy: all of them, or their deviators."""
        return stresses

    @property
    def uniform(self) -> bool:
        """Whether the elastic constants and axes are numbers, perhaps one for each region."""
        axes = [component for axis in self.axes for component in axis]
        return largest_degree([*self.young, *self.poisson, *self.shear, *axes]) == 0

    @property
    def in_strain(self) -> bool:
        """Whether the material is in plane strain."""
        return self.dim == 2 and self.plane == PlaneState.STRAIN

    @property
    def degree(self) -> int | None:
        """The degree of the polynomial that ε₀ and σ₀ are known to be, or None."""
        return largest_degree(strain.datum for strain in self.strains) if self.strains else 0

    def compliance(self, points: CellPoints) -> Array:
        """𝔸 in points, shape (cells, points, entries, entries) (collective)."""
        in_space = self._in_space(points)
        keep = self._kept
        in_plane = in_space[..., keep[:, None], keep]
        if self.in_strain:
            column = in_space[..., keep, BEYOND]
            in_plane = (
                in_plane - column[..., :, None] * column[..., None, :] / in_space[..., BEYOND, BEYOND, None, None]
            )
        return in_plane

    def strain(self, points: CellPoints) -> Array:
        """ε₀ in points, shape (cells, points, entries) (collective)."""
        if not self.strains:
            return np.zeros((*points.shape, len(self._kept)))
        in_space, eps0 = self._in_space(points), self._own(points)
        if self.in_strain:
            eps0 = eps0 - in_space[..., BEYOND] * (eps0[..., BEYOND] / in_space[..., BEYOND, BEYOND])[..., None]
        return eps0[..., self._kept]

    def moved(self) -> "Iterator[tuple[str, Expr, Material]]":
        """Each number in UFL by a name, with itself and the material in which it has an imaginary step."""
        return _moved(self, "material")

    def change_of_strain(self, points: CellPoints, stress: Array) -> Array:
        """How ε = 𝔸σ + ε₀ changes with the number that has an imaginary step, for the entries of σ (collective)."""
        strain = np.einsum("nqef,nqf->nqe", self.compliance(points), stress) + self.strain(points)
        return np.asarray(strain.imag / COMPLEX_STEP)

    def out_of_plane(self, points: CellPoints) -> tuple[Array, Array]:
        """The σ_zz of plane strain by the entries of σ, shape (cells, points, 3), and without σ (collective)."""
        in_space = self._in_space(points)
        unit = in_space[..., BEYOND, BEYOND]
        return -in_space[..., BEYOND, self._kept] / unit[..., None], -self._own(points)[..., BEYOND] / unit

    def looked_at(self, points: CellPoints) -> Iterator[tuple[str, Array]]:
        """Quantities of the material that have to be checked in points (collective)."""
        with np.errstate(all="ignore"):
            young, poisson = self.constants(points)
            yield "young", young
            if len(self.young) == len(self.poisson) == 1:
                yield "poisson", poisson
            else:
                unit = np.zeros((*points.shape, 3, 3)) + np.eye(3)  # 𝔸 of stresses along the axes, with diagonal 1
                for k, (i, j) in enumerate(SPACE[3:]):
                    unit[..., i, j] = unit[..., j, i] = -poisson[..., k] * np.sqrt(young[..., j] / young[..., i])
                eigenvalues = np.linalg.eigvalsh(np.nan_to_num(unit, nan=2.0, posinf=2.0, neginf=2.0))
                yield "energy", eigenvalues[..., 0].astype(np.float64)
            for datum in self.shear:
                yield "shear", datum.values(points)
            if self.axes:
                yield "axes", np.isfinite(self.directions(points)).astype(np.float64)
            yield from self._own_looked_at(points)

    def _own_looked_at(self, points: CellPoints) -> Iterator[tuple[str, Array]]:
        """What of ε₀ and σ₀ has to be checked in points (collective)."""
        for strain in self.strains:
            yield strain.name, strain.values(points)
            values = strain.datum.values(points)
            yield f"{strain.name}, skew", values - values.swapaxes(-1, -2) if strain.datum.shape else 0 * points.x

    @property
    def _kept(self) -> Array:
        """The entries in space that are those of the plane or of space."""
        return np.array([SPACE.index(pair) for pair in entries(self.dim)])

    def _own(self, points: CellPoints) -> Array:
        """ε₀ in space."""
        entries: Array = np.zeros((*points.shape, len(SPACE)))
        for strain in self.strains:
            values = strain.values(points)
            if strain.name == "initial_stress":
                values = -np.einsum("nqij,nqj->nqi", self._in_space(points), values)
            entries = entries + values
        return entries

    def _in_space(self, points: CellPoints) -> Array:
        """𝔸 in space, shape (cells, points, 6, 6)."""
        E, nu = self.constants(points)
        shear = [datum.values(points) for datum in self.shear]
        compliance = np.zeros((*points.shape, len(SPACE), len(SPACE)), dtype=np.result_type(E, nu, *shear))
        for k, (i, j) in enumerate(SPACE):
            if i == j:
                compliance[..., k, k] = 1 / E[..., i]
                continue
            compliance[..., i, j] = compliance[..., j, i] = -nu[..., k - 3] / E[..., i]
            compliance[..., k, k] = (1 + nu[..., k - 3]) / E[..., i]
            if shear:
                G, free = shear[k - 3], shear[k - 3].real == 0
                compliance[..., k, k] = np.where(free, compliance[..., k, k], 1 / np.where(free, 1.0, 2 * G))
        if not self.axes:
            return compliance
        turn = self._turn(points)
        return turn @ compliance @ turn.swapaxes(-1, -2)

    def softness_in_space(self, points: CellPoints) -> Array:
        """The eigenvalues of 𝔸 in space, ascending, shape (cells, points, 6) (collective)."""
        return np.linalg.eigvalsh(self._in_space(points))

    def constants(self, points: CellPoints) -> tuple[Array, Array]:
        """E₁, E₂, E₃ and ν₁₂, ν₁₃, ν₂₃ in points, the last axis (collective)."""
        young, poisson = ([datum.values(points) for datum in data] for data in (self.young, self.poisson))
        return np.stack(young * (3 // len(young)), axis=-1), np.stack(poisson * (3 // len(poisson)), axis=-1)

    def directions(self, points: CellPoints) -> Array:
        """The axes in points as rows, orthogonal and of length 1, or NaN, shape (cells, points, 3, 3) (collective)."""
        components = [[component.values(points) for component in axis] for axis in self.axes]
        axes = np.zeros(
            (*points.shape, 2, 3), dtype=np.result_type(float, *(each for axis in components for each in axis))
        )
        axes[..., 1, 1] = 1.0
        for k, axis in enumerate(components):
            for i, values in enumerate(axis):
                axes[..., k, i] = values
        if self.dim == 2:
            axes[..., 1, :] = np.stack([-axes[..., 0, 1], axes[..., 0, 0], 0 * axes[..., 0, 0]], axis=-1)
        first, second = axes[..., 0, :], axes[..., 1, :]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            first, second = first / _length(first), second / _length(second)
            second = second - (second * first).sum(axis=-1, keepdims=True) * first
            size = _length(second)
            second = np.where(size.real > DEPENDENT, second / size, np.nan)
        return np.stack([first, second, np.cross(first, second)], axis=-2)

    def _turn(self, points: CellPoints) -> Array:
        """The map from the entries of a matrix along the axes to those in coordinates."""
        axes, units = self.directions(points), np.moveaxis(symmetric(np.eye(len(SPACE)), 3), -1, 0)
        turned = np.einsum("nqki,bkl,nqlj->nqbij", axes, units, axes, optimize=True)
        return to_entries(turned).swapaxes(-1, -2)


def _length(vectors: Array) -> Array:
    """The lengths of vectors, also of those with an imaginary step."""
    return np.asarray(np.sqrt((vectors**2).sum(axis=-1, keepdims=True)))


def _moved(given: Any, name: str) -> Iterator[tuple[str, Expr, Any]]:
    """Each number in UFL in a given datum: its name, itself, and the datum in which it has an imaginary step."""
    if isinstance(given, Datum):
        for entry in np.ndindex(given.shape) if given.pieces is None else ():
            yield ".".join([name, *map(str, entry)]), given.ufl[entry] if entry else given.ufl, _Moved(given, entry)
    elif isinstance(given, tuple):
        for i, each in enumerate(given):
            for key, number, changed in _moved(each, f"{name}.{i}"):
                yield key, number, (*given[:i], changed, *given[i + 1 :])
    elif is_dataclass(given) and not isinstance(given, type):
        for field in fields(given):
            for key, number, changed in _moved(getattr(given, field.name), f"{name}.{field.name}"):
                yield key, number, replace(given, **{field.name: changed})


def mean_compliances(compliance: Array) -> tuple[Array, Array]:
    """The mean of a compliance over deviators, and that under pressure: 1/2μ and (1 − dθ)/2μ if it is isotropic."""
    number = compliance.shape[-1]
    dim = {3: 2, 6: 3}[number]
    under_pressure = compliance[..., :dim, :dim].sum(axis=(-1, -2)) / dim
    return (np.trace(compliance, axis1=-2, axis2=-1) - under_pressure) / (number - 1), under_pressure


def regular(compliance: Array) -> Array:
    """A compliance, or near one that leaves the volume as it is another whose inverse there is, shape (…, n, n).

    It is larger, so that an energy of stresses by it is one above.
    """
    of_shape, of_volume = mean_compliances(compliance)
    if (of_volume > ROUNDING * of_shape).any():
        return compliance
    dim = {3: 2, 6: 3}[compliance.shape[-1]]
    of_pressures = np.zeros(compliance.shape[-2:])
    of_pressures[:dim, :dim] = 1 / (dim**2 * STIFF_VOLUME)
    return np.asarray(compliance + of_shape[..., None, None] * of_pressures)


def material_of(spaces: MeshSpaces, problem: ElasticProblem) -> Material:
    """Read the law of the material (collective).

    Raises:
        InputError: If something has the wrong shape, or a region has no value; if plane stress is asked for in space;
            if the material has axes and is isotropic.
    """
    dim = spaces.mesh.geometry.dim
    if dim == 3 and problem.plane != PlaneState.STRAIN:
        raise InputError(f"[problem] plane: a body in space is not in plane {problem.plane}; leave it out")
    young = _along_axes(spaces, "young", problem.young)
    if len(young) > 1 and problem.shear is None:
        raise InputError("[problem] shear: where young has three values it is [G12, G13, G23]")
    axes = _filled(problem, problem.axes, np.eye(dim)[: dim - 1].tolist())
    directions = () if axes is None else [_entry("axes", axes, k, dim - 1, "directions") for k in range(dim - 1)]
    material = Material(
        dim=dim,
        plane=problem.plane,
        young=young,
        poisson=_along_axes(spaces, "poisson", problem.poisson),
        shear=() if problem.shear is None else _along_axes(spaces, "shear", _filled(problem, problem.shear, 0.0)),
        axes=tuple(
            tuple(read_datum(spaces, "axes", _entry("axes", each, i, dim, "components")) for i in range(dim))
            for each in directions
        ),
        strains=strains_of(spaces, problem),
    )
    if material.axes and not material.shear and len(young) == len(material.poisson) == 1:
        raise InputError("[problem] axes: do nothing for an isotropic material; give young along each of them")
    return material


def strains_of(spaces: MeshSpaces, problem: ElasticProblem) -> tuple[Strain, ...]:
    """ε₀ and −σ₀, where they are given (collective)."""
    return tuple(
        Strain(name, read_datum(spaces, name, given, matrix=True), read_datum(spaces, name, _beyond(given)))
        for name, given in (("eigenstrain", problem.eigenstrain), ("initial_stress", problem.initial_stress))
        if given is not None
    )


def read_datum(spaces: MeshSpaces, key: str, given: Any, *, matrix: bool = False) -> Datum:
    """A datum that may have a value for each region (collective)."""
    names = "xyz"[: spaces.mesh.geometry.dim]
    return regional_datum(spaces, key, parsed(given, names, f"[problem] {key}"), matrix=matrix)


def _along_axes(spaces: MeshSpaces, key: str, given: Any) -> tuple[Datum, ...]:
    """One datum, or three if somewhere three are given (collective)."""
    lists = [given, *given.values()] if isinstance(given, Mapping) else [given]
    number = 3 if any(isinstance(each, list | tuple) for each in lists) else 1
    return tuple(
        read_datum(spaces, key, _entry(key, given, i, 3, "values along axes", alone=True)) for i in range(number)
    )


def _entry(key: str, given: Any, i: int, number: int, what: str, *, alone: bool = False) -> Any:
    """An entry of a list, or of one for each region; or what is no list, if it may stand alone.

    Raises:
        InputError: If there are not so many.
    """
    if isinstance(given, Mapping):
        return {name: _entry(f"{key}.{name}", each, i, number, what, alone=alone) for name, each in given.items()}
    if isinstance(given, list | tuple):
        if len(given) != number:
            raise InputError(f"[problem] {key}: has {len(given)} {what}, not {number}")
        return given[i]
    if not alone:
        raise InputError(f"[problem] {key}: must be a list of {number} {what}")
    return given


def _filled(problem: ElasticProblem, given: Any, other: Any) -> Any:
    """A table by region, with another value in those regions of E that it lacks."""
    if not isinstance(given, Mapping) or not isinstance(problem.young, Mapping):
        return given
    return dict.fromkeys(problem.young, other) | dict(given)


def _beyond(given: Any) -> Any:
    """The zz of a strain in the plane: that of a number, 0 of a matrix."""
    if isinstance(given, Mapping):
        return {name: _beyond(each) for name, each in given.items()}
    return 0.0 if isinstance(given, list | tuple | np.ndarray) or bool(getattr(given, "ufl_shape", None)) else given


def check_material(spaces: MeshSpaces, material: Material, blocks: Iterable[CellPoints]) -> None:
    """Make sure of the law in points (collective).

    Raises:
        InputError: If something is not finite, E ≤ 0, ν is not between −1 and ½, a shear modulus is negative, the
            energy is not positive, or something is no direction or no symmetric matrix.
    """
    extremes: dict[str, tuple[float, float]] = {}
    for points in blocks:
        for key, values in material.looked_at(points):
            (low, high), values = extremes.get(key, (np.inf, -np.inf)), np.nan_to_num(values, nan=-np.inf)
            extremes[key] = min(low, float(values.min(initial=np.inf))), max(high, float(values.max(initial=-np.inf)))
    seen = {key: np.array(pair if pair[0] <= pair[1] else []) for key, pair in extremes.items()}  # none without cells
    ends = {key: extent(values, spaces.mesh.comm) for key, values in seen.items()}
    for key in ("viscosity", "young", "poisson", "shear", "energy", "axes"):
        if key in ends:
            _check_ends(key, *ends[key])
    first = next(iter(ends))
    check_means(first, "in the domain", np.array(ends[first]), spaces)
    for strain in material.strains:
        check_means(strain.name, "in the domain", np.array(ends[strain.name]), spaces)
        skew, size = (np.abs(ends[name]).max() for name in (f"{strain.name}, skew", strain.name))
        if skew > ROUNDING * size:
            raise InputError(f"[problem] {strain.name}: must be a number or a symmetric matrix")


def _check_ends(key: str, low: float, high: float) -> None:
    """Refuse data of the material whose values reach from a low to a high one.

    Raises:
        InputError: If they may not.
    """
    if key in ("young", "viscosity") and not (low > 0 and high < np.inf):
        raise InputError(f"[problem] {key}: must be positive and finite everywhere; its smallest value is {low:.3g}")
    if key == "poisson" and not (low > -1 and high < 0.5):
        wrong = low if not low > -1 else high
        raise InputError(f"[problem] poisson: must be above -1 and below 1/2; it is {wrong:.6g} somewhere")
    if key == "shear" and not (low >= 0 and high < np.inf):
        raise InputError(f"[problem] shear: must be positive and finite everywhere; its smallest value is {low:.3g}")
    if key == "energy" and not low > POSITIVE:
        raise InputError("[problem] poisson: with these three and young there would be strains of negative energy")
    if key == "axes" and low < 1:
        raise InputError("[problem] axes: must be finite directions, in space two that are not parallel")
