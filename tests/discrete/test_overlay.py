"""The overlay of two surfaces: pieces cover the slave, the images are on the master, and what is opposite is found."""

import numpy as np
import pytest

from signorini_fenicsx.discrete.overlay import Pieces, Surface, overlay

rng = np.random.default_rng(0)


def line(x: np.ndarray, y: np.ndarray, up: int) -> Surface:
    """A polygonal line over x, whose normals point up or down."""
    points = np.column_stack([x, y])
    corners = np.stack([points[:-1], points[1:]], axis=1)
    along = corners[:, 1] - corners[:, 0]
    normals = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    return Surface(corners, normals * np.sign(normals[:, 1:]) * up)


def square(n: int, z: float, up: int, seed: int) -> Surface:
    """Triangles over the unit square, whose inner vertices are moved at random."""
    x = np.stack(np.meshgrid(*[np.linspace(0, 1, n + 1)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    inside = ((x > 1e-9) & (x < 1 - 1e-9)).all(axis=1)
    x[inside] += 0.2 / n * np.random.default_rng(seed).uniform(-1, 1, (inside.sum(), 2))
    a = np.add.outer(np.arange(n) * (n + 1), np.arange(n)).ravel()
    cells = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 1, a + n + 2], 1)])
    corners = np.column_stack([x, np.full(len(x), z)])[cells]
    return Surface(corners, np.tile([0.0, 0.0, float(up)], (len(cells), 1)))


def check(pieces: Pieces, slave: Surface, master: Surface, directions: np.ndarray) -> None:
    """χ(x) = x + γd on each piece, by both coordinates; J by measures."""
    on_slave = np.einsum("nva,nai->nvi", pieces.on_slave, slave.corners[pieces.slave])
    on_master = np.einsum("nva,nai->nvi", pieces.on_master, master.corners[pieces.master])
    d = directions[pieces.slave]
    gamma = pieces.gap / np.einsum("ni,ni->n", d, slave.normals[pieces.slave])[:, None]
    np.testing.assert_allclose(on_slave + gamma[..., None] * d[:, None], on_master, atol=1e-13)
    assert (pieces.on_master > -1e-11).all()
    assert (pieces.on_slave > -1e-11).all()
    two = [Surface(x, np.zeros((len(x), x.shape[2]))).measure for x in (on_slave, on_master)]
    np.testing.assert_allclose(two[1], pieces.stretch * two[0], rtol=1e-6, atol=1e-15)


@pytest.mark.parametrize("apart", [0.0, 0.2, -0.05])
@pytest.mark.parametrize("dim", [2, 3])
def test_surfaces_at_any_distance(dim: int, apart: float) -> None:
    """Flat surfaces that touch, are apart or overlap: all is covered, the weights are those of the hats."""
    if dim == 2:
        slave = line(np.append(np.sort(rng.random(9)), 1.0), np.full(10, apart), -1)
        master = line(np.linspace(0, 1, 14), np.zeros(14), 1)
    else:
        slave, master = square(4, apart, -1, 1), square(5, 0.0, 1, 2)
    pieces = overlay(slave, master, slave.normals, 0.5)
    check(pieces, slave, master, slave.normals)
    number = len(slave.corners)
    np.testing.assert_allclose(pieces.covered(number), 1.0, atol=1e-12)
    np.testing.assert_allclose(pieces.gap, apart, atol=1e-14)
    np.testing.assert_allclose(pieces.means(number), apart, atol=1e-14)
    sums = np.zeros((number, dim))
    np.add.at(sums, pieces.slave, pieces.weights.sum(axis=2))
    np.testing.assert_allclose(sums, 1.0, atol=1e-12)


def test_partly_covered_facing_away_and_touching_in_a_point() -> None:
    """Only what is opposite and faces the slave has a χ."""
    slave = line(np.linspace(0, 1, 4), np.full(4, 0.1), -1)
    beside = line(np.linspace(0.4, 1.4, 3), np.zeros(3), 1)
    np.testing.assert_allclose(overlay(slave, beside, slave.normals, 0.5).covered(3), [0, 0.8, 1], atol=1e-12)
    away, point = line(np.linspace(0, 1, 3), np.zeros(3), -1), line(np.linspace(1, 2, 3), np.zeros(3), 1)
    assert len(overlay(slave, away, slave.normals, 0.5)) == 0
    assert len(overlay(slave, point, slave.normals, 0.5)) == 0
    assert len(overlay(slave, line(np.array([0.0, 1.0]), np.zeros(2), 1), slave.normals, 0.05)) == 0


@pytest.mark.parametrize("dim", [2, 3])
def test_the_nearest_of_two_layers(dim: int) -> None:
    """Where two masters are behind each other the nearer one counts, also if it covers a facet in part."""
    if dim == 2:
        slave, near, far = (
            line(np.linspace(a, b, 4), np.full(4, y), s)
            for a, b, y, s in [(0, 1, 0.2, -1), (0.5, 2, 0.1, 1), (-1, 2, 0, 1)]
        )
    else:
        slave, far, near = square(3, 0.2, -1, 1), square(4, 0.0, 1, 2), square(2, 0.1, 1, 3)
        near.corners[..., 0] += 0.5
    master = Surface(np.concatenate([near.corners, far.corners]), np.concatenate([near.normals, far.normals]))
    pieces = overlay(slave, master, slave.normals, 0.5)
    check(pieces, slave, master, slave.normals)
    np.testing.assert_allclose(pieces.covered(len(slave.corners)), 1.0, atol=1e-12)
    x = np.einsum("nva,nai->nvi", pieces.on_slave, slave.corners[pieces.slave]).mean(axis=1)[:, 0]
    np.testing.assert_allclose(pieces.gap.mean(axis=1), np.where(x > 0.5, 0.1, 0.2), atol=1e-13)


def test_chords_of_one_arc() -> None:
    """Two polygons of one circle along the normals of the slave: covered, but for ends that are stretched."""

    def arc(n: int, radius: float) -> Surface:
        angle = np.linspace(-2.5, -0.6, n + 1)
        return line(radius * np.cos(angle), radius * np.sin(angle), -1)

    slave, inner = arc(7, 1.0), arc(11, 1.01)
    master = Surface(inner.corners, -inner.normals)
    pieces = overlay(slave, master, slave.normals, 0.5)
    np.testing.assert_allclose(pieces.covered(7), 1.0, atol=1e-12)
    assert np.abs(pieces.stretch - 1).max() < 0.1
    assert np.abs(pieces.gap - 0.01).max() < 0.02


def octant(n: int, radius: float, out: int) -> Surface:
    """Triangles over an octant of a sphere, whose normals point out or in."""
    steps = [(i, j) for i in range(n) for j in range(n - i)]
    numbers = [[(i, j), (i + 1, j), (i, j + 1)] for i, j in steps]
    numbers += [[(i + 1, j), (i + 1, j + 1), (i, j + 1)] for i, j in steps if i + j < n - 1]
    x = np.array(numbers, dtype=float)
    x = np.concatenate([x, n - x.sum(axis=2, keepdims=True)], axis=2)
    x *= radius / np.linalg.norm(x, axis=2, keepdims=True)
    normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    normals /= out * np.linalg.norm(normals, axis=1, keepdims=True)
    return Surface(x, normals * np.sign((normals * x[:, 0]).sum(axis=1) * out)[:, None])


@pytest.mark.parametrize(("slaves", "masters", "out"), [(4, 4, 1), (5, 7, -1), (8, 5, 1), (8, 11, -1)])
def test_facets_of_one_sphere(slaves: int, masters: int, out: int) -> None:
    """Polyhedra of one octant along the normals of the slave: covered, with corners and sides that are stretched."""
    slave, master = octant(slaves, 1.0, out), octant(masters, 1.0 + 0.02 * out, -out)
    pieces = overlay(slave, master, slave.normals, 0.5)
    np.testing.assert_allclose(pieces.covered(len(slave.corners)), 1.0, atol=1e-9)
    sums = np.zeros((len(slave.corners), 3))
    np.add.at(sums, pieces.slave, pieces.weights.sum(axis=2))
    np.testing.assert_allclose(sums, 1.0, atol=1e-9)
    assert (pieces.on_slave > -1e-11).all()
    assert (pieces.on_master > -1e-11).all()
    assert pieces.share[np.abs(pieces.stretch - 1) > 0.6].sum() < 0.01 * len(slave.corners)


def test_many_facets_far_away() -> None:
    """The search does not compare all with all: 4000 and 3000 facets of very different sizes, far apart."""
    x = np.append(0.0, np.geomspace(1e-4, 1, 4000))
    slave, master = line(x, np.full(len(x), 0.4), -1), line(np.linspace(0, 1, 3001), np.zeros(3001), 1)
    pieces = overlay(slave, master, slave.normals, 1.0)
    np.testing.assert_allclose(pieces.covered(4000), 1.0, atol=1e-9)
