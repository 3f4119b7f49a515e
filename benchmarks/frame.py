"""A robot arm in one pose as a frame of elastic beams on joint springs: finite elements in NumPy, nothing reduced.

Link i runs straight from points[i] to points[i + 1], as a uniform Euler-Bernoulli beam or as a rigid body; a spring of
compliance c_i about the axis k_i carries its start on the end of the link before, the first on the ground. Beams are cut
into equal elements of two nodes with three displacements u and three rotations r each. Along the chain these follow from
the coordinates q, which are the turns of the springs and six deformations (u_e, r_e) of each element:

    across a joint:         u' = u,               r' = r + k_i turn_i
    across a rigid link:    u' = u + r x d,       r' = r                 with d the way from one point to the other
    across an element:      u' = u + r x d + u_e, r' = r + r_e

All nodes move as T q, and M = T' M_e T with the matrices of all elements and bodies. An element that moves as one piece
is not strained, so that K has a block of each element and 1/c of each joint, and rounding does not grow with the elements.

Motions are small and all vectors are in the axes of the base. It shares no code with the engine, which makes it an oracle.
What loads at the ends of beams do at rest is exact, however few the elements. Frequencies are above those of the beams:
where a mode has waves of wave number k [rad/m] along elements of length h, by a part of (k h)^4/1440 in bending, (k h)^2/24
in twist and stretch.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import eigh, solve

LINEAR = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6
"""Integral of N' N along an element of length 1 with straight N, of stretch and of twist."""
SPRING = np.array([[1.0, -1.0], [-1.0, 1.0]])
"""Of the derivatives of the same."""
CUBIC = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]) / 420
"""Integral of N' N with the cubic N of deflection and slope at the start, then at the end, of bending."""
SLOPES = np.array([[36, 3, -36, 3], [3, 4, -3, -1], [-36, -3, 36, -3], [3, -1, -3, 4]]) / 30
"""Of their first derivatives: rotary inertia."""
CURVATURES = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])
"""Of their second derivatives: stiffness."""


@dataclass(frozen=True)
class Beam:
    """A link that bends, twists and stretches. One of no length is a rigid point of its mass.

    **Arguments:**

    - `young`, `shear`: moduli E, G [Pa].
    - `area`: A [m²]. With the length and the mass it makes the density, m/(A L).
    - `second_moment_y`, `second_moment_z`: I_y, I_z [m⁴], against deflection along z, and along y.
    - `torsion`: J [m⁴], so that the stiffness against twist is G J. The inertia against it is that of I_y + I_z.
    - `side`: shape (3,), any length. Local x is along the beam, y along what of this is across the beam, z completes them.
    - `mass`: m [kg].
    """

    young: float
    shear: float
    area: float
    second_moment_y: float
    second_moment_z: float
    torsion: float
    side: np.ndarray
    mass: float


@dataclass(frozen=True)
class Rigid:
    """A rigid body: a link that couples its ends rigidly, or what a link carries.

    **Arguments:**

    - `mass`: [kg]; may be 0.
    - `centre`: of mass [m], shape (3,).
    - `inertia`: about the centre of mass [kg m²], shape (3, 3); none by default.
    """

    mass: float
    centre: np.ndarray
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))


@dataclass(frozen=True)
class Arm:
    """An arm of n links in one pose.

    **Arguments:**

    - `points`: where links begin, and where the last one ends [m], shape (n + 1, 3).
    - `axes`: unit vectors k_i of the joints, shape (n, 3).
    - `compliance`: c_i [rad/(N m)], shape (n,); a joint of 0 is locked.
    - `links`: n of them.
    - `carried`: pairs of i and a body that moves with the start of link i, beyond its joint. With i = n it moves with the
      end of the last link, as tools do.
    - `tip`: tool centre point [m], shape (3,), fixed to the end of the last link; that end by default.
    - `elements`: of each beam.
    """

    points: np.ndarray
    axes: np.ndarray
    compliance: np.ndarray
    links: Sequence[Beam | Rigid]
    carried: Sequence[tuple[int, Rigid]] = ()
    tip: np.ndarray | None = None
    elements: int = 20


def shift(way) -> np.ndarray:
    """(u, r) at one point of a rigid body from (u, r) at another, the `way` [m] to it: shape (6, 6)."""
    x, y, z = way
    matrix = np.eye(6)
    matrix[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]  # r x way
    return matrix


def element(beam: Beam, way, length: float, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """K_e and M_e of one of equal `parts` of a beam, in the u, r of its start and of its end: shapes (12, 12)."""
    x = way / length
    y = beam.side - np.dot(beam.side, x) * x
    assert np.linalg.norm(y) > 1e-6 * np.linalg.norm(beam.side), "the side vector must not be along the beam"
    y = y / np.linalg.norm(y)
    h, density, polar = length / parts, beam.mass / (beam.area * length), beam.second_moment_y + beam.second_moment_z
    stiffness, mass = np.zeros((2, 12, 12))
    for k, elastic, inert in ((0, beam.young * beam.area, beam.area), (3, beam.shear * beam.torsion, polar)):
        stiffness[k::6, k::6] = elastic / h * SPRING
        mass[k::6, k::6] = density * inert * h * LINEAR
    # The slope along y is a turn about z, and that along z one about -y.
    for u, r, sign, moment in ((1, 5, 1, beam.second_moment_z), (2, 4, -1, beam.second_moment_y)):
        rows, unit = np.ix_([u, r, u + 6, r + 6], [u, r, u + 6, r + 6]), np.array([1, sign * h, 1, sign * h])
        unit = np.outer(unit, unit)
        stiffness[rows] = beam.young * moment / h**3 * unit * CURVATURES
        mass[rows] = density * unit * (beam.area * h * CUBIC + moment / h * SLOPES)
    local = np.kron(np.eye(4), [x, y, np.cross(x, y)])
    return local.T @ stiffness @ local, local.T @ mass @ local


def matrices(arm: Arm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """K and M, shapes (q, q), and the motion of the tool centre point for coordinates, shape (6, q), u [m] above r [rad]."""
    points, axes = np.asarray(arm.points, float), np.asarray(arm.axes, float)
    assert np.allclose(np.linalg.norm(axes, axis=1), 1), "axes must be unit vectors"
    assert {at for at, _ in arm.carried} <= set(range(len(points))), "bodies are carried by no link"
    ways = np.diff(points, axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    beams = sum(isinstance(link, Beam) and length > 0 for link, length in zip(arm.links, lengths, strict=True))
    size = np.count_nonzero(arm.compliance) + 6 * arm.elements * beams
    unused = iter(np.eye(size))  # coordinates, each to be taken once
    stiffness, mass = np.zeros((2, size, size))
    motion = np.zeros((6, size))  # (u, r) of where the chain has got to: the ground so far

    def add(body, point):
        at_centre = shift(body.centre - point) @ motion
        mass[:] += body.mass * at_centre[:3].T @ at_centre[:3] + at_centre[3:].T @ body.inertia @ at_centre[3:]

    for i, (link, axis, compliance) in enumerate(zip(arm.links, axes, arm.compliance, strict=True)):
        if compliance:
            turn = next(unused)
            stiffness += np.outer(turn, turn) / compliance
            motion = motion + np.outer([0, 0, 0, *axis], turn)
        for body in (body for at, body in arm.carried if at == i):
            add(body, points[i])
        if isinstance(link, Beam) and lengths[i] > 0:
            k, m = element(link, ways[i], lengths[i], arm.elements)
            for _ in range(arm.elements):
                deformation = np.array([next(unused) for _ in range(6)])
                stiffness += deformation.T @ k[6:, 6:] @ deformation
                ends = np.concatenate([motion, shift(ways[i] / arm.elements) @ motion + deformation])
                mass += ends.T @ m @ ends
                motion = ends[6:]
        else:
            add(Rigid(link.mass, points[i]) if isinstance(link, Beam) else link, points[i])
            motion = shift(ways[i]) @ motion
    for body in (body for at, body in arm.carried if at == len(arm.links)):
        add(body, points[-1])
    tip = points[-1] if arm.tip is None else np.asarray(arm.tip)
    return stiffness, mass, shift(tip - points[-1]) @ motion


def tip_compliance(arm: Arm) -> np.ndarray:
    """Motion (u, r) of the tool centre point by a force [N] and a moment [N m] there: shape (6, 6)."""
    stiffness, _, tip = matrices(arm)
    return tip @ solve(stiffness, tip.T, assume_a="pos")


def modes(arm: Arm, number: int) -> tuple[np.ndarray, np.ndarray]:
    """The lowest frequencies f [Hz], ascending, shape (number,), and what the tool centre point does in these modes.

    Column k of the shapes, (6, number), is its (u, r) in mode k of unit modal mass, in 1/sqrt(kg) and rad/(m sqrt(kg)): at
    the angular frequency w, undamped, a force and a moment F there move it by the sum of s_k (s_k' F)/((2 pi f_k)² - w²).
    """
    stiffness, mass, tip = matrices(arm)
    size = len(mass)
    # M v = K v/w², not K v = w² M v: there may be coordinates without inertia, but none without stiffness.
    inverse, vectors = eigh(mass, stiffness, subset_by_index=(size - number, size - 1))
    rate = 1 / np.sqrt(inverse[::-1])  # [rad/s]
    return rate / (2 * np.pi), tip @ vectors[:, ::-1] * rate


def frequencies(arm: Arm, number: int) -> np.ndarray:
    """The lowest natural frequencies [Hz], ascending, shape (number,)."""
    return modes(arm, number)[0]
