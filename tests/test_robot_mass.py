"""What robots weigh at the tool, and how they vibrate: masses beside closed forms, Pinocchio and finite elements;
frequencies, modes and modal damping; derivatives beside differences."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import (
    ARMS,
    LOADS,
    POSES,
    SECTION,
    any_arm,
    arm,
    joint_frequencies,
    standing,
    worst,
)

from benchmarks import frame, unreduced
from benchmarks.kr270 import COMPLIANCE
from benchmarks.kr270 import JOINTS as Q
from millax.robot import Beam, ElasticRobot, Loads, Payload, Placement, Robot, modal_damping, models, modes

TURNING = ("revolute",) * 6
SLIDING = ("prismatic", "revolute", "revolute", "prismatic", "revolute", "revolute", "revolute")


# Rigid links


def with_load(robot: Robot) -> Robot:
    load = Payload(40.0, (0.1, 0.05, 0.2), [[1.0, 0.1, 0.2], [0.1, 2.0, -0.3], [0.2, -0.3, 3.0]])
    return dataclasses.replace(robot, payload=load)


RIGID = {
    "kuka_kr270": models.kuka_kr270(),
    "kuka_kr210_r2700_2": models.kuka_kr210_r2700_2(),
    "abb_irb6660 of rods": models.abb_irb6660().with_rods(0.1, [400.0, 250.0, 200.0, 100.0, 60.0, 20.0]),
    "any": any_arm(1, SLIDING, {}).robot,
}
RIGID |= {f"{name}, loaded": with_load(robot) for name, robot in RIGID.items() if name != "abb_irb6660 of rods"}


@pytest.mark.parametrize("robot", RIGID.values(), ids=RIGID)
def test_the_mass_matrix_and_gravity_are_those_of_pinocchio(robot):
    field = np.array([0.4, -0.3, -9.81])
    pytest.importorskip("pinocchio")
    from benchmarks import pinocchio_models

    q = np.random.default_rng(2).uniform(-np.pi, np.pi, (20, robot.joints))
    mass, gravity = jax.jit(jax.vmap(lambda q: (robot.mass_matrix(q), robot.gravity(q, field))))(q)
    theirs = pinocchio_models.evaluated(pinocchio_models.built(robot), q, robot.zero, field)
    assert worst(mass, theirs.mass) < 1e-13
    assert worst(gravity, theirs.gravity) < 1e-12


def test_a_rod_weighs_as_the_textbook_says():
    robot = Robot(
        ("a", "b"),
        ("revolute",) * 2,
        [(0, 0, 0), (0.9, 0, 0)],
        np.zeros((2, 3)),
        [(0, 0, 1), (0, 0, 1)],
        np.zeros(2),
        flange=Placement((0.0, 0.6, 0.0)),
        mass=[1.0, 1.0],
    ).with_rods(0.05, [12.0, 6.0])
    np.testing.assert_allclose(robot.centre_of_mass, [(0.45, 0, 0), (0, 0.3, 0)], atol=1e-15)
    ball = 0.4 * 0.05**2
    np.testing.assert_allclose(robot.inertia[0], 12 * np.diag([ball, 0.9**2 / 12 + ball, 0.9**2 / 12 + ball]), atol=1e-15)
    np.testing.assert_allclose(robot.inertia[1], 6 * np.diag([0.6**2 / 12 + ball, ball, 0.6**2 / 12 + ball]), atol=1e-15)
    np.testing.assert_array_equal(robot.with_rods(0.05).inertia, robot.inertia)  # masses of its own
    with pytest.raises(ValueError, match=r"robot\.mass: this robot has none; give the mass of every link"):
        models.abb_irb6660().with_rods(0.1)


def test_what_a_robot_does_not_say_of_its_masses():
    robot = dataclasses.replace(models.kuka_kr270(), inertia=None)
    robot.gravity(Q)
    for of in (robot.mass_matrix, ElasticRobot(robot, COMPLIANCE).mass):
        with pytest.raises(ValueError, match="robot: this one has no inertia; give that of every link, or take rods"):
            of(Q)
    with pytest.raises(ValueError, match="robot: this one has no mass and no centre_of_mass; give them for every link"):
        ElasticRobot(models.abb_irb6660(), COMPLIANCE).mass(Q)


def planar(q2: float):
    """Two links in a plane, masses off their lines: robot, compliance, and M written out."""
    (m1, l1, i1), (m2, l2, i2), first = (30.0, 0.35, 2.5), (18.0, 0.25, 0.9), 0.8
    robot = Robot(
        ("a", "b"),
        ("revolute",) * 2,
        [(0, 0, 0), (first, 0, 0)],
        np.zeros((2, 3)),
        [(0, 0, 1), (0, 0, 1)],
        np.zeros(2),
        flange=Placement((0.6, 0.0, 0.0)),
        mass=[m1, m2],
        centre_of_mass=[(l1, 0, 0), (l2, 0, 0)],
        inertia=[i1 * np.eye(3), i2 * np.eye(3)],
    )
    m22 = i2 + m2 * l2**2
    m12 = m22 + m2 * first * l2 * np.cos(q2)
    return robot, np.array([1e-6, 3e-6]), i1 + m1 * l1**2 + m2 * first**2 + 2 * m12 - m22, m12, m22


def test_two_links_in_a_plane_swing_as_a_quadratic_says():
    robot, c, m11, m12, m22 = planar(0.7)
    mass = robot.mass_matrix([0.3, 0.7])
    np.testing.assert_allclose(mass, [[m11, m12], [m12, m22]], rtol=1e-14)
    a, b, d = m11 * m22 - m12**2, -(m11 / c[1] + m22 / c[0]), 1 / (c[0] * c[1])
    root = np.sqrt(b**2 - 4 * a * d)
    rate = np.sqrt(np.array([-b - root, -b + root]) / (2 * a))
    np.testing.assert_allclose(modes(mass, jnp.diag(1 / c)).frequency, rate / (2 * np.pi), rtol=1e-13)


@pytest.mark.parametrize("make", [models.kuka_kr270, models.kuka_kr210_r2700_2])
def test_the_tool_feels_the_frequencies_of_the_joints(make):
    robot = arm(make, {})
    for q in POSES.values():
        jacobian = standing(robot, q).jacobian()
        inverse, mass = np.linalg.inv(jacobian), np.asarray(robot.robot.mass_matrix(q))
        assert worst(robot.mass(q), inverse.T @ mass @ inverse) < 1e-12  # C 25, as it ought to be printed
        found = robot.modes(q)
        np.testing.assert_allclose(found.frequency, joint_frequencies(np.diag(1 / COMPLIANCE), mass), rtol=1e-12)
        np.testing.assert_allclose(found.frequency, frame.frequencies(unreduced.full(robot, q), 6), rtol=1e-12)


def test_under_loads_the_mass_is_that_of_where_the_robot_stands():
    robot = arm(models.kuka_kr270, {})
    soft = dataclasses.replace(robot, compliance=100 * COMPLIANCE)
    x = soft.at_tool(Q, LOADS).coordinates
    jacobian = standing(soft, x).jacobian()
    inverse = np.linalg.inv(jacobian)
    assert worst(soft.mass(Q, LOADS), inverse.T @ np.asarray(robot.robot.mass_matrix(x)) @ inverse) < 1e-12
    assert worst(soft.mass(Q), soft.mass(Q, LOADS)) > 1e-2


# Beams


def one_link(line, mass: float) -> Robot:
    """On a joint about z, from there to its flange, a uniform line."""
    return Robot(
        ("a",),
        ("revolute",),
        [(0, 0, 0)],
        [(0, 0, 0)],
        [(0, 0, 1)],
        [0.0],
        flange=Placement(line),
        mass=[mass],
        centre_of_mass=[np.asarray(line) / 2],
        inertia=np.zeros((1, 3, 3)),
    )


def test_the_reduced_mass_of_one_beam_in_closed_form():
    """Integrals of x/L, x²(3L - x)/(2L³) and 2x(L - x/2)/L², alone, in products, and with what the joint before does."""
    mass, length, rate = 60.0, 1.5, 2.0
    line = length * np.array([2.0, -1.0, 2.0]) / 3
    robot = one_link(line, mass)
    beam = dataclasses.replace(SECTION, side=(0.3, 1.0, -0.2))
    elastic = ElasticRobot(robot, [1e-6], {"a": beam})
    found = np.asarray(elastic.bodies(elastic.extended([0.0])).mass_matrix)
    turning = mass * np.array([2e-5 + 5e-5, 2e-5, 5e-5]) / 5e-3  # of the section, about x, y, z
    own = [mass / 3, 33 / 140 * mass, 33 / 140 * mass, turning[0] / 3, 8 / 15 * turning[1], 8 / 15 * turning[2]]
    np.testing.assert_allclose(found[1:, 1:], np.diag(own), atol=1e-13 * mass)
    # The joint turns all about z: velocity z x (s line), turn z.
    x = line / length
    z = np.cross(x, beam.side) / np.linalg.norm(np.cross(x, beam.side))
    axes = np.array([x, np.cross(z, x), z])
    swing = axes @ np.cross([0, 0, 1], line)
    shared = np.concatenate([mass * swing * [1 / 3, 11 / 40, 11 / 40], turning * axes[:, 2] * [1 / 2, 2 / 3, 2 / 3]])
    np.testing.assert_allclose(found[0, 1:], shared, atol=1e-13 * mass)
    np.testing.assert_allclose(found[0, 0], mass / 3 * swing @ swing + turning @ axes[:, 2] ** 2, rtol=1e-13)
    # Bent, twisted and turned, and with something at its end.
    held = dataclasses.replace(robot, payload=Payload(25.0, (0.1, 0.2, 0.3), np.diag([1.0, 2.0, 3.0])))
    elastic = ElasticRobot(held, [1e-6], {"a": beam})
    bent = np.array([rate, 0.02, -0.03, 0.05, 0.1, -0.2, 0.15])
    assert worst(elastic.bodies(bent).mass_matrix, standing(elastic, bent).mass_matrix()) < 1e-13


@pytest.mark.parametrize("beams", [ARMS["beams"], {f"joint_{i}": SECTION for i in range(1, 8)}], ids=["some", "all"])
def test_masses_of_beams_and_links_add_up(beams):
    robot = any_arm(3, SLIDING, beams)
    x = np.random.default_rng(4).normal(size=robot.coordinates) * 0.3
    mass, weight = jax.jit(lambda x: ((b := robot.bodies(x)).mass_matrix, b.weight(LOADS.gravity)))(x)
    stands = standing(robot, x)
    assert worst(mass, stands.mass_matrix()) < 1e-13
    assert worst(weight, stands.load(Loads(gravity=LOADS.gravity))) < 1e-13


def test_the_mass_at_the_tool_is_that_of_the_least_energy():
    """B leads to the displacement asked for, and of all deflections that do it takes the least of the springs' energy."""
    robot = arm(models.kuka_kr270, ARMS["beams"])
    at, stands = robot.at_tool(Q), standing(robot, robot.extended(Q))
    jacobian, springs = stands.jacobian(), np.asarray(robot.springs)
    follow = np.linalg.solve(springs, jacobian.T) @ np.linalg.inv(jacobian @ np.linalg.solve(springs, jacobian.T))
    assert worst(at.follow, follow) < 1e-11
    assert worst(robot.mass(Q), follow.T @ stands.mass_matrix() @ follow) < 1e-11


def test_beams_vibrate_nearly_as_finite_elements():
    """A beam alone: sqrt(140/33 * 3) = 3.57 in place of 3.516, 1.5 % too much. In an arm whose links bend less than its
    joints turn its lowest frequencies are as good; condensed to six motions, the fourth and later are not."""
    beam = dataclasses.replace(SECTION, side=(0.0, 1.0, 0.0))
    elastic = ElasticRobot(one_link((1.5, 0.0, 0.0), 60.0), [1e-15], {"a": beam})
    alone = elastic.modes([0.0]).frequency[:2]
    moments = np.array([2e-5, 5e-5])
    turning = 8 / 15 * moments / 5e-3 * (3 / (2 * 1.5)) ** 2  # of the sections: a force at the end turns it by 3/(2L)
    expected = np.sqrt(3 * 210e9 * moments / 1.5**3 / (60.0 * (33 / 140 + turning))) / (2 * np.pi)
    np.testing.assert_allclose(alone, expected, rtol=1e-4)
    finite = frame.frequencies(unreduced.full(elastic, [0.0]), 2)
    np.testing.assert_allclose(alone / finite - 1, 0.015, atol=0.005)
    arm_of_it = arm(models.kuka_kr270, ARMS["beams"])
    exact = frame.frequencies(unreduced.full(arm_of_it, Q), 3)
    np.testing.assert_allclose(arm_of_it.modes(Q).frequency[:3], exact, rtol=0.025)


# Modes


def random_pair(seed: int, n: int = 6):
    """M and K, symmetric and positive definite."""
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(2, n, n))
    mass, stiffness = roots @ roots.swapaxes(1, 2) + np.eye(n)
    return 100 * mass, 1e6 * stiffness


def test_modes_are_normalised_to_the_mass_and_ascend():
    mass, stiffness = random_pair(0)
    frequency, shapes = modes(mass, stiffness)
    np.testing.assert_allclose(shapes.T @ mass @ shapes, np.eye(6), atol=1e-13)
    rate = 2 * np.pi * frequency
    assert worst(shapes.T @ stiffness @ shapes, np.diag(rate**2)) < 1e-13
    np.testing.assert_allclose(frequency, joint_frequencies(stiffness, mass), rtol=1e-13)
    assert (np.diff(frequency) > 0).all()
    # What is skew in the stiffness, of a moment, has no part in them.
    skew = 1e4 * (np.triu(np.ones((6, 6)), 1) - np.tril(np.ones((6, 6)), -1))
    np.testing.assert_allclose(modes(mass, stiffness + skew).frequency, frequency, rtol=1e-13)
    assert np.isnan(modes(mass, stiffness - 1e7 * np.eye(6)).frequency[0])


@pytest.mark.parametrize("ratio", [0.05, [0.01, 0.02, 0.05, 0.1, 0.3, 0.0]], ids=["one ratio", "one per mode"])
def test_every_mode_has_the_damping_ratio_it_is_given(ratio):
    mass, stiffness = random_pair(1)
    damping = modal_damping(mass, stiffness, ratio)
    frequency, shapes = modes(mass, stiffness)
    expected = np.diag(2 * np.broadcast_to(ratio, 6) * 2 * np.pi * frequency)
    assert worst(shapes.T @ damping @ shapes, expected) < 1e-13
    assert worst(damping.T, damping) < 1e-14


def twins(seed: int):
    """M and K of which two modes have one frequency, and a third one nearly so."""
    mass, _ = random_pair(seed)
    shapes = np.linalg.inv(np.linalg.cholesky(mass)).T
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(6, 6)))[0]
    root = np.linalg.inv(shapes @ turn)
    return mass, root.T @ np.diag(np.array([1.0, 4.0, 4.0, 4.0000001, 9.0, 30.0]) * 1e4) @ root


@pytest.mark.parametrize(
    ("pair", "ratio"),
    [(random_pair, 0.05), (random_pair, [0.01, 0.02, 0.05, 0.1, 0.3, 0.2]), (twins, 0.05)],
    ids=["apart", "one ratio per mode", "two of one frequency"],
)
def test_modal_damping_has_derivatives(pair, ratio):
    ratio = np.asarray(ratio)
    mass, stiffness = pair(2)
    rng = np.random.default_rng(3)
    ways = rng.normal(size=(2, 6, 6))
    ways = (ways + ways.swapaxes(1, 2)) * np.array([1.0, 1e4])[:, None, None]
    way = np.asarray(rng.normal(size=np.shape(ratio)) * 0.01)
    weights = rng.normal(size=(6, 6))

    def damping(step):
        return modal_damping(mass + step * ways[0], stiffness + step * ways[1], ratio + step * way)

    forward = jax.jit(jax.jacfwd(damping))(0.0)
    backward = jax.jit(jax.grad(lambda step: jnp.sum(weights * damping(step))))(0.0)
    step = 1e-4
    difference = (damping(step) - damping(-step)) / (2 * step)
    # By the rounding of eigenvectors, of 1e-16 over the step; truncation is 1e-8 of what changes by a part of 0.1.
    assert worst(forward, difference) < 1e-7
    assert float(backward) == pytest.approx(float(jnp.sum(weights * forward)), rel=1e-10)


# Derivatives


NUMBERS = {"compliance": 6, "joints": 6, "lengths": 4, "side": 2, "beam": 6, "masses": 7}


def from_numbers(change) -> tuple[ElasticRobot, jax.Array]:
    """A KR270 with one beam, numbers changed by parts of them, or by so many rad and m; and a pose of it."""
    change = dict(zip(NUMBERS, jnp.split(change, np.cumsum(list(NUMBERS.values()))[:-1]), strict=True))
    robot = arm(models.kuka_kr270, {}).robot
    first, upper, fore, wrist = change["lengths"]
    robot = eqx.tree_at(
        lambda r: (r.xyz, r.flange.xyz, r.mass, r.payload.mass),
        robot,
        (
            robot.xyz.at[1, 0].add(first).at[2, 0].add(upper).at[4, 2].add(fore),
            robot.flange.xyz.at[2].add(wrist),
            robot.mass * (1 + change["masses"][:6]),
            robot.payload.mass * (1 + change["masses"][6]),
        ),
    )
    given = (SECTION.area, SECTION.second_moment_y, SECTION.second_moment_z, SECTION.torsion, SECTION.young, SECTION.shear)
    numbers = [number * (1 + part) for number, part in zip(given, change["beam"], strict=True)]
    beam = Beam(*numbers, side=SECTION.side.at[1:].add(change["side"]))  # along the link it counts for nothing
    return ElasticRobot(robot, COMPLIANCE * (1 + change["compliance"]), {"joint_2": beam}), Q + change["joints"]


def felt(change):
    """Stiffness, mass and frequencies under loads, each over its largest number."""
    robot, q = from_numbers(change)
    at = robot.at_tool(q, LOADS)
    mass = at.mass(robot)
    frequency = modes(mass, at.stiffness).frequency
    return jnp.concatenate([at.stiffness.ravel() / 1e7, mass.ravel() / 1e3, frequency / 100])


@pytest.mark.long
def test_derivatives_both_ways_and_beside_differences():
    one, weights = jnp.zeros(sum(NUMBERS.values())), jax.random.normal(jax.random.key(0), (78,))
    value, forward = jax.jit(felt), jax.jit(jax.jacfwd(felt))(one)
    backward = jax.jit(jax.grad(lambda change: felt(change) @ weights))(one)
    assert worst(backward, weights @ forward) < 1e-11
    for index, column in enumerate(forward.T):
        step = np.zeros(len(forward.T))
        step[index] = 1e-5
        difference = (value(step) - value(-step)) / 2e-5
        assert np.abs(difference).max() > 1e-3
        # Truncation, of a part of 1e-10, and rounding, of 1e-15 over the step: together 3e-10 of at most 1.
        np.testing.assert_allclose(column, difference, atol=1e-9)
