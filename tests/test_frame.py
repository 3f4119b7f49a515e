"""The finite-element model of an arm against closed forms: beams, rigid chains, loads at the tip at rest."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from benchmarks.frame import Arm, Beam, Rigid, element, frequencies, matrices, modes, shift, tip_compliance

X, Y, Z = np.eye(3)
LENGTH, MASS = 1.5, 60.0
STEEL = Beam(
    young=210e9, shear=80e9, area=5e-3, second_moment_y=2e-6, second_moment_z=7e-6, torsion=1.2e-6, side=Y, mass=MASS
)
"""A slender box 1.5 m long, half as deep as wide: its radii of gyration are 20 and 37 mm."""


def cantilever(beam=STEEL, **other) -> Arm:
    """One beam along x that stands on the ground without a joint."""
    return Arm(np.array([0 * X, LENGTH * X]), [Z], [0.0], [beam], **other)


def thin(beam: Beam, by: float) -> Beam:
    """A beam as stiff in bending and twist, of stiffer stuff in a thinner section: it has less inertia against turning."""
    names = {"young": by, "shear": by, "second_moment_y": 1 / by, "second_moment_z": 1 / by, "torsion": 1 / by}
    return replace(beam, **{name: getattr(beam, name) * factor for name, factor in names.items()})


def bending(beam: Beam, moment: float, count: int, mass=0.0, inertia=0.0):
    """Frequencies [Hz] of a cantilever of I = `moment`, rotary inertia included, with a body at its end, in closed form.

    E I W'''' + w² rho I W'' = w² rho A W with W = W' = 0 at the start; at the end E I W'' = w² j W' and
    E I W''' + w² (rho I W' + m W) = 0. W is made of cosh(a x) - cos(b x) and sinh(a x)/a - sin(b x)/b.
    """
    stiffness, density = beam.young * moment, MASS / (beam.area * LENGTH)

    def determinant(rate):
        turning, moving = density * moment * rate**2 / (2 * stiffness), density * beam.area * rate**2 / stiffness
        root = np.sqrt(turning**2 + moving)
        a, b = np.sqrt(root - turning), np.sqrt(root + turning)
        ch, sh, c, s = np.cosh(a * LENGTH), np.sinh(a * LENGTH), np.cos(b * LENGTH), np.sin(b * LENGTH)
        w = np.array([ch - c, sh / a - s / b])
        slope = np.array([a * sh + b * s, ch - c])
        curvature = np.array([a**2 * ch + b**2 * c, a * sh + b * s])
        third = np.array([a**3 * sh - b**3 * s, a**2 * ch + b**2 * c])
        couple = stiffness * curvature - rate**2 * inertia * slope
        force = stiffness * third + rate**2 * (density * moment * slope + mass * w)
        return (couple[0] * force[1] - couple[1] * force[0]) / ch

    # The roots of the beam alone lie near ((k - 1/2) pi)²; a body at the end lowers them, by one place at most.
    scale = np.sqrt(stiffness / (density * beam.area)) / LENGTH**2
    grid = scale * np.linspace(0.05, ((count + 0.2) * np.pi) ** 2, 4000)
    values = [determinant(rate) for rate in grid]
    found = [
        brentq(determinant, *grid[i : i + 2], xtol=1e-10) for i in range(len(grid) - 1) if values[i] * values[i + 1] < 0
    ]
    return np.array(found[:count]) / (2 * np.pi)


def nearest(found, expected):
    """Of frequencies in all directions, those that are to be `expected`."""
    return np.array([found[np.argmin(abs(found - f))] for f in expected])


def section_axes(way, side):
    """Rows x along the beam, y on the half-plane of the side vector, z."""
    z = np.cross(way, side)
    rows = np.array([way, np.cross(z, way), z])
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def random_arm(seed: int, elements: int = 3) -> Arm:
    """Beams in any directions with any side vectors, a rigid link, a point in the wrist, a tool; two joints are locked."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(6, 3)) * 0.5
    steps[4] = 0
    points = np.concatenate([[[0.1, -0.2, 0.3]], steps]).cumsum(axis=0)
    axes = rng.normal(size=(6, 3))

    def beam(mass):
        moments = rng.uniform(1e-5, 4e-5, 3)
        return Beam(70e9, 27e9, rng.uniform(4e-3, 9e-3), *moments, rng.normal(size=3), mass)

    def body(at):
        half = rng.normal(size=(3, 3))
        return Rigid(rng.uniform(5, 50), at + rng.normal(size=3) * 0.1, half @ half.T)

    return Arm(
        points=points,
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        compliance=np.array([1e-6, 5e-7, 0.0, 2e-6, 4e-6, 0.0]),
        links=[beam(200), beam(150), body(points[2]), beam(80), beam(20), beam(15)],
        carried=[(1, body(points[1])), (3, body(points[3])), (6, body(points[6]))],
        tip=points[6] + rng.normal(size=3) * 0.2,
        elements=elements,
    )


def turned(arm: Arm, rotation: np.ndarray) -> Arm:
    """The whole arm in other axes."""

    def link(one):
        if isinstance(one, Beam):
            return replace(one, side=rotation @ one.side)
        return Rigid(one.mass, rotation @ one.centre, rotation @ one.inertia @ rotation.T)

    return replace(
        arm,
        points=arm.points @ rotation.T,
        axes=arm.axes @ rotation.T,
        links=[link(one) for one in arm.links],
        carried=[(at, link(one)) for at, one in arm.carried],
        tip=rotation @ arm.tip,
    )


# Beams


@pytest.mark.parametrize("elements", [1, 20])
def test_what_a_load_at_the_end_of_a_cantilever_does(elements):
    found = tip_compliance(cantilever(elements=elements))
    e, iy, iz = STEEL.young, STEEL.second_moment_y, STEEL.second_moment_z
    expected = np.zeros((6, 6))
    expected[0, 0], expected[3, 3] = LENGTH / (e * STEEL.area), LENGTH / (STEEL.shear * STEEL.torsion)
    for u, r, sign, moment in ((1, 5, 1, iz), (2, 4, -1, iy)):  # a push along z turns the end about -y
        expected[u, u], expected[r, r] = LENGTH**3 / (3 * e * moment), LENGTH / (e * moment)
        expected[u, r] = expected[r, u] = sign * LENGTH**2 / (2 * e * moment)
    # Cubics are the exact shapes, so that only rounding is left.
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13 * abs(expected).max())


def test_moving_an_element_as_one_piece_needs_no_force():
    """What K without the motion of its start rests on."""
    way = np.array([0.3, -0.2, 0.5])
    k, m = element(STEEL, way, np.linalg.norm(way), 4)
    rigid = np.concatenate([np.eye(6), shift(way / 4)])
    np.testing.assert_allclose(k @ rigid, 0, atol=1e-13 * abs(k).max())
    np.testing.assert_allclose((rigid.T @ m @ rigid)[:3, :3], MASS / 4 * np.eye(3), atol=1e-13)


def test_slender_cantilever_bends_as_the_textbook_says():
    # Thin enough that rotary inertia, of a part of about ((k - 1/2) pi r/L)²/2, is nothing beside the elements' 2e-5.
    beam = thin(STEEL, 1e7)
    scale = np.sqrt(beam.young * beam.second_moment_y / (MASS * LENGTH**3)) / (2 * np.pi)
    rates = np.array([1.875104068711961, 4.694091132974175, 7.854757438237613])
    np.testing.assert_allclose(rates**2, [3.5160, 22.034, 61.697], rtol=3e-5)  # as they are printed
    found = nearest(frequencies(cantilever(beam), 9), rates**2 * scale) / (rates**2 * scale) - 1
    # From above by (beta h)⁴/1440: 5e-8, 2e-6, 1.7e-5.
    np.testing.assert_allclose(found, (rates / 20) ** 4 / 1440, rtol=0.05, atol=2e-8)


@pytest.mark.parametrize("body", [(0.0, 0.0), (25.0, 0.0), (25.0, 3.0)], ids=["bare", "mass", "inertia"])
def test_cantilever_with_a_body_at_its_end(body):
    mass, inertia = body
    arm = cantilever(carried=[(1, Rigid(mass, LENGTH * X, inertia * np.eye(3)))])
    found = frequencies(arm, 9)
    expected = np.array([bending(STEEL, moment, 3, *body) for moment in (STEEL.second_moment_y, STEEL.second_moment_z)])
    # The waves of the third mode are at most 7.9 to the beam's length: 1.7e-5.
    np.testing.assert_allclose(nearest(found, expected.ravel()), expected.ravel(), rtol=2e-5)
    np.testing.assert_allclose(nearest(found, expected[:, 0]), expected[:, 0], rtol=1e-7)


def test_light_beam_with_a_mass_at_its_end():
    arm = cantilever(replace(STEEL, mass=1e-6), carried=[(1, Rigid(25.0, LENGTH * X))])
    stiffness = 3 * STEEL.young * np.array([STEEL.second_moment_y, STEEL.second_moment_z]) / LENGTH**3
    np.testing.assert_allclose(frequencies(arm, 2), np.sqrt(stiffness / 25.0) / (2 * np.pi), rtol=1e-7)


def test_axial_and_torsional_frequencies():
    found = frequencies(cantilever(), 30)
    polar = STEEL.second_moment_y + STEEL.second_moment_z
    density = MASS / (STEEL.area * LENGTH)
    for speed in (np.sqrt(STEEL.young / density), np.sqrt(STEEL.shear * STEEL.torsion / (density * polar))):
        waves = (np.arange(2) + 0.5) * np.pi  # over the length
        expected = speed * waves / LENGTH / (2 * np.pi)
        # Straight elements raise frequencies by a part of (wave number h)²/24: 2.6e-4 and 2.3e-3.
        np.testing.assert_allclose(nearest(found, expected) / expected - 1, (waves / 20) ** 2 / 24, rtol=0.01)


def test_elements_converge_from_above_at_their_order():
    exact = bending(STEEL, STEEL.second_moment_y, 2)
    errors = np.array([nearest(frequencies(cantilever(elements=n), 5), exact) / exact - 1 for n in (5, 10, 20)])
    assert (errors > 0).all()
    np.testing.assert_allclose(errors[:-1] / errors[1:], 16, rtol=0.1)  # fourth order


# Rigid chains


def test_pendulum_on_a_spring():
    inertia, centre, tip = np.diag([1.0, 2.0, 3.0]), np.array([0.3, 0.4, 0.1]), np.array([0.9, 0.0, 0.0])
    arm = Arm(np.array([0 * X, X]), [Z], [2e-6], [Rigid(40.0, centre, inertia)], tip=tip)
    about = 3.0 + 40.0 * 0.25
    found, shape = modes(arm, 1)
    np.testing.assert_allclose(found, np.sqrt(1 / (2e-6 * about)) / (2 * np.pi), rtol=1e-14)
    np.testing.assert_allclose(abs(shape[:, 0]) * np.sqrt(about), [0, 0.9, 0, 0, 0, 1], atol=1e-14)
    np.testing.assert_allclose(tip_compliance(arm), 2e-6 * np.outer([0, 0.9, 0, 0, 0, 1], [0, 0.9, 0, 0, 0, 1]), rtol=1e-14)


def test_two_rigid_links_in_a_plane():
    first, second, c = 0.8, 0.6, np.array([1e-6, 3e-6])
    (m1, l1, i1), (m2, l2, i2) = (30.0, 0.35, 2.5), (18.0, 0.25, 0.9)
    elbow, between = np.array([first, 0, 0]), 0.7  # the angle of the second link to the first
    along = np.array([np.cos(between), np.sin(between), 0])
    links = [Rigid(m1, l1 * X, i1 * np.eye(3)), Rigid(m2, elbow + l2 * along, i2 * np.eye(3))]
    found = frequencies(Arm(np.array([0 * X, elbow, elbow + second * along]), [Z, Z], c, links), 2)
    m22 = i2 + m2 * l2**2
    m12 = m22 + m2 * first * l2 * np.cos(between)
    m11 = i1 + m1 * l1**2 + m2 * first**2 + 2 * m12 - m22
    # det(M - w^-2/c) = 0, a quadratic in w².
    a, b, d = m11 * m22 - m12**2, -(m11 / c[1] + m22 / c[0]), 1 / (c[0] * c[1])
    root = np.sqrt(b**2 - 4 * a * d)
    np.testing.assert_allclose(found, np.sqrt(np.array([-b - root, -b + root]) / (2 * a)) / (2 * np.pi), rtol=1e-12)


# Frames


def test_loads_at_the_tip_by_virtual_work():
    """What each place of the chain gives way by, under what the load at the tip does there, moves the tip as a lever."""
    arm = random_arm(1)
    expected = np.zeros((6, 6))
    for i, (link, axis) in enumerate(zip(arm.links, arm.axes, strict=True)):
        lever = shift(arm.tip - arm.points[i])[:, 3:] @ axis
        expected += arm.compliance[i] * np.outer(lever, lever)
        way = arm.points[i + 1] - arm.points[i]
        length = np.linalg.norm(way)
        if isinstance(link, Rigid) or length == 0:
            continue
        x, local = way / length, section_axes(way, link.side)
        moments = np.array([link.second_moment_y, link.second_moment_z])
        flexibility = 1 / np.array([link.shear * link.torsion, *(link.young * moments)])
        for place in 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3):  # two points of Gauss: the integrand is quadratic
            levers = shift(arm.tip - arm.points[i] - place * way)[:, 3:] @ local.T
            expected += length / 2 * (levers * flexibility) @ levers.T
        expected[:3, :3] += length / (link.young * link.area) * np.outer(x, x)
    for elements in (1, 10):
        found = tip_compliance(replace(arm, elements=elements))
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13 * abs(expected).max())


def test_soft_joint_feels_the_inertia_of_the_whole_arm():
    """On a joint so soft that nothing else gives way, the arm turns as one body: sums of rods, sections and bodies."""
    arm = random_arm(2)
    soft = replace(arm, compliance=np.append(1.0, np.zeros(5)))
    bodies = [one for one in arm.links if isinstance(one, Rigid)] + [body for _, body in arm.carried]
    about = 0.0
    for link, start, end in zip(arm.links, arm.points[:-1], arm.points[1:], strict=True):
        if not isinstance(link, Beam):
            continue
        inertia, length = np.zeros((3, 3)), np.linalg.norm(end - start)
        if length:
            x, local = (end - start) / length, section_axes(end - start, link.side)
            iy, iz = link.second_moment_y, link.second_moment_z
            section = link.mass / link.area * np.diag([iy + iz, iy, iz])
            inertia = link.mass * length**2 / 12 * (np.eye(3) - np.outer(x, x)) + local.T @ section @ local
        bodies.append(Rigid(link.mass, (start + end) / 2, inertia))
    for body in bodies:
        arm_of_it = np.cross(arm.axes[0], body.centre - arm.points[0])
        about += arm.axes[0] @ body.inertia @ arm.axes[0] + body.mass * arm_of_it @ arm_of_it
    # The arm is 1e6 times as stiff as the joint, which lowers the frequency by 5e-7.
    np.testing.assert_allclose(frequencies(soft, 1), np.sqrt(1 / about) / (2 * np.pi), rtol=1e-6)


def test_frequencies_are_the_same_whichever_way_the_arm_is_turned():
    arm, rotation = random_arm(3), Rotation.from_rotvec([0.7, -1.1, 2.0]).as_matrix()
    other = turned(arm, rotation)
    np.testing.assert_allclose(frequencies(other, 12), frequencies(arm, 12), rtol=1e-12)
    both = np.kron(np.eye(2), rotation)
    compliance = both @ tip_compliance(arm) @ both.T
    np.testing.assert_allclose(tip_compliance(other), compliance, atol=1e-13 * abs(compliance).max())


def test_elements_of_an_arm_converge():
    found = np.array([frequencies(random_arm(4, elements), 6) for elements in (2, 4, 8, 16)])
    assert (np.diff(found, axis=0) < 0).all()
    np.testing.assert_allclose(found[2], found[3], rtol=1e-4)


def test_modes_add_up_to_the_compliance():
    arm = random_arm(5, 2)
    stiffness, mass, _ = matrices(arm)
    for matrix in (stiffness, mass):
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-15 * abs(matrix).max())
    (found, shapes), compliance = modes(arm, len(mass)), tip_compliance(arm)
    np.testing.assert_allclose(
        (shapes / (2 * np.pi * found) ** 2) @ shapes.T, compliance, atol=1e-12 * abs(compliance).max()
    )


def test_coordinates_without_inertia():
    """A spring without anything on it: only as many frequencies as there are moving masses."""
    rest = Rigid(0.0, X)
    arm = Arm(np.array([0 * X, X, 2 * X]), [Z, Z], [1e-6, 1e-6], [rest, Rigid(10.0, 2 * X)])
    # The springs in series, as the mass feels them.
    np.testing.assert_allclose(frequencies(arm, 1), np.sqrt(1 / (10.0 * (4e-6 + 1e-6))) / (2 * np.pi), rtol=1e-12)
