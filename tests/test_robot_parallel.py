"""Robots of several legs: a Gough-Stewart platform and a planar robot beside sums over their legs written out."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import ARMS, arm, cross, joint_frequencies, rotation, worst
from scipy.spatial.transform import Rotation

from benchmarks.kr270 import JOINTS as Q
from millax.robot import Beam, ElasticRobot, ParallelRobot, Payload, Placement, Robot, models

FREE = np.inf
X, Y, Z = np.eye(3)
TIP = np.array([0.10, -0.05, 0.90])
TILT = rotation([0.10, -0.15, 0.30])
STRUTS = 1 / np.array([2e7, 3e7, 2.5e7, 2e7, 4e7, 3e7])
"""Compliance of each strut [m/N]."""


def pairs(radius: float, apart: float, height: float) -> np.ndarray:
    """Six points on a circle, in three pairs."""
    angles = np.add.outer(2 * np.pi / 3 * np.arange(3), [-apart, apart]).ravel()
    return np.array([(radius * np.cos(a), radius * np.sin(a), height) for a in angles])


FEET, HELD = pairs(0.8, 0.2, 0.0), pairs(0.4, 0.85, -0.3)
"""Where struts are hinged to the platform, in the tool frame."""
LOWER, UPPER = (12.0, 0.25), (7.0, 0.35)
"""Of each strut the mass [kg] of its two halves, and how far from the hinge of its own it sits [m]."""
PLATFORM = Payload(50.0, (0.02, 0.03, -0.2), [[1.0, 0.1, 0.2], [0.1, 2.0, -0.3], [0.2, -0.3, 3.0]])
"""In the tool frame, which is that of the flange of the first leg."""


def strut(i: int, compliance, beam: Beam | None = None) -> tuple[ElasticRobot, np.ndarray]:
    """A leg of two passive joints in its foot, an elastic slide and three passive joints where it holds the platform; and
    its coordinates. With a beam, the last half of it."""
    way = TIP + TILT @ HELD[i] - FEET[i]
    length, rest = np.linalg.norm(way), 0.0 if beam is None else 0.4
    x, y, z = way / length
    foot = np.array([np.arctan2(-y, z), np.arcsin(x)])  # Rx(a) Ry(b) z = (sin b, -sin a cos b, cos a cos b)
    leg = rotation([foot[0], 0, 0]) @ rotation([0, foot[1], 0])
    ball = Rotation.from_matrix(leg.T @ TILT).as_euler("XYZ")
    robot = Robot(
        names=("foot_x", "foot_y", "slide", "ball_x", "ball_y", "ball_z"),
        kinds=("revolute", "revolute", "prismatic", "revolute", "revolute", "revolute"),
        xyz=[FEET[i], 0 * Z, 0 * Z, rest * Z, 0 * Z, 0 * Z],
        rpy=np.zeros((6, 3)),
        axis=[X, Y, Z, X, Y, Z],
        zero=np.zeros(6),
        flange=Placement(-HELD[i]),
        mass=[0.0, LOWER[0], UPPER[0], 0.0, 0.0, 0.0],
        centre_of_mass=[0 * Z, LOWER[1] * Z, (rest - UPPER[1]) * Z, 0 * Z, 0 * Z, 0 * Z],
        inertia=np.zeros((6, 3, 3)),
        payload=PLATFORM if i == 0 else Payload(0.0),
    )
    springs = [FREE, FREE, compliance, FREE, FREE, FREE]
    elastic = ElasticRobot(robot, springs, {} if beam is None else {"slide": beam})
    return elastic, np.concatenate([foot, [length - rest], ball])


def platform(compliance=STRUTS, beam=None) -> tuple[ParallelRobot, tuple]:
    legs, q = zip(*(strut(i, c, beam) for i, c in enumerate(compliance)), strict=True)
    return ParallelRobot(legs), q


def lines() -> np.ndarray:
    """Of every strut the wrench that one newton in it puts on the tool, shape (6, 6): (u, (b - tip) x u)."""
    held = HELD @ TILT.T
    way = TIP + held - FEET
    u = way / np.linalg.norm(way, axis=1, keepdims=True)
    return np.concatenate([u, np.cross(held, u)], axis=1)


@pytest.fixture(scope="module")
def hexapod():
    return platform()


def test_the_struts_of_a_platform_add_up(hexapod):
    robot, q = hexapod
    robot.check(q)
    for leg, own in zip(robot.legs, q, strict=True):
        np.testing.assert_allclose(leg.robot.pose(own)[:3], np.column_stack([TILT, TIP]), atol=1e-14)
    w = lines()
    assert worst(robot.stiffness(q), (w.T / STRUTS) @ w) < 1e-12


def test_the_masses_of_a_platform_add_up(hexapod):
    robot, q = hexapod
    centre = TILT @ PLATFORM.centre_of_mass
    lever = np.hstack([np.eye(3), -cross(centre)])  # velocity of the centre of mass: v - c x w
    expected = float(PLATFORM.mass) * lever.T @ lever
    expected[3:, 3:] += TILT @ np.asarray(PLATFORM.inertia) @ TILT.T
    for i in range(6):
        held = TILT @ HELD[i]
        way = TIP + held - FEET[i]
        length = np.linalg.norm(way)
        along = np.outer(way, way) / length**2
        across, hinge = np.eye(3) - along, np.hstack([np.eye(3), -cross(held)])
        lower, upper = across * LOWER[1] / length @ hinge, (across * (1 - UPPER[1] / length) + along) @ hinge
        expected += LOWER[0] * lower.T @ lower + UPPER[0] * upper.T @ upper
    assert worst(robot.mass(q), expected) < 1e-12
    w = lines()
    np.testing.assert_allclose(robot.modes(q).frequency, joint_frequencies((w.T / STRUTS) @ w, expected), rtol=1e-10)


def test_a_strut_that_is_half_a_beam_gives_way_in_series():
    tube = Beam.tube(0.08, 0.06)
    robot, q = platform(beam=tube)
    robot.check(q)
    w = lines()
    # Hinged at both ends it is bent by nothing.
    expected = (w.T / (STRUTS + 0.4 / (float(tube.young) * float(tube.area)))) @ w
    assert worst(robot.stiffness(q), expected) < 1e-11


def planar(beside=(1e-7, 2e-6, 3e-6)) -> tuple[ParallelRobot, tuple]:
    """Three legs in the plane z = 0, each hinged, sliding and hinged, and where it holds the platform three springs beside
    the plane: along z, about x and y."""
    legs, coordinates = [], []
    for i, (foot, held) in enumerate(zip(FLAT_FEET, FLAT_HELD, strict=True)):
        way = FLAT_TIP + FLAT_TURN @ held - foot
        toward = np.arctan2(way[1], way[0])
        robot = Robot(
            names=("foot", "slide", "hand", "lift", "roll", "pitch"),
            kinds=("revolute", "prismatic", "revolute", "prismatic", "revolute", "revolute"),
            xyz=[foot, *[0 * Z] * 5],
            rpy=np.zeros((6, 3)),
            axis=[Z, X, Z, Z, X, Y],
            zero=np.zeros(6),
            flange=Placement(-held),
        )
        legs.append(ElasticRobot(robot, [FREE, SLIDES[i], FREE, *beside]))
        coordinates.append(np.array([toward, np.linalg.norm(way), 0.35 - toward, 0.0, 0.0, 0.0]))
    return ParallelRobot(legs), tuple(coordinates)


FLAT_FEET = np.array([(0.0, 0.0, 0.0), (1.2, 0.1, 0.0), (0.5, 1.0, 0.0)])
FLAT_HELD = np.array([(-0.2, -0.1, 0.0), (0.2, -0.12, 0.0), (0.02, 0.25, 0.0)])
FLAT_TIP = np.array([0.55, 0.35, 0.0])
FLAT_TURN = rotation([0, 0, 0.35])
SLIDES = np.array([1e-7, 2e-7, 1.5e-7])


def test_a_robot_in_a_plane_and_what_holds_it_beside_the_plane():
    robot, q = planar()
    robot.check(q)
    stiffness = np.asarray(robot.stiffness(q))
    held = FLAT_HELD @ FLAT_TURN.T
    way = FLAT_TIP + held - FLAT_FEET
    u = way / np.linalg.norm(way, axis=1, keepdims=True)
    w = np.column_stack([u[:, :2], np.cross(held, u)[:, 2]])
    inside, outside = np.ix_([0, 1, 5], [0, 1, 5]), np.ix_([2, 3, 4], [2, 3, 4])
    assert worst(stiffness[inside], (w.T / SLIDES) @ w) < 1e-12
    beside = np.zeros((3, 3))
    turn = FLAT_TURN[:2, :2]
    for b in held:  # springs in the axes of the platform at the hinge; a turn lifts the hinge by (w x b)_z
        lever = np.array([1.0, b[1], -b[0]])
        beside += 1e7 * np.outer(lever, lever)
        beside[1:, 1:] += turn @ np.diag([1 / 2e-6, 1 / 3e-6]) @ turn.T
    assert worst(stiffness[outside], beside) < 1e-12
    assert np.abs(stiffness[np.ix_([0, 1, 5], [2, 3, 4])]).max() < 1e-12 * np.abs(stiffness).max()


def test_one_leg_without_passive_joints_is_that_robot():
    for beams in ARMS.values():
        leg = arm(models.kuka_kr270, beams)
        robot = ParallelRobot([leg])
        robot.check([Q])
        for ours, theirs in zip(
            (robot.stiffness([Q]), robot.mass([Q]), *robot.modes([Q])),
            (leg.stiffness(Q), leg.mass(Q), *leg.modes(Q)),
            strict=True,
        ):
            np.testing.assert_array_equal(ours, theirs)


def test_two_of_the_same_robot_are_twice_as_stiff_and_as_heavy():
    leg = arm(models.kuka_kr270, {})
    robot = ParallelRobot([leg, leg])
    assert worst(robot.stiffness([Q, Q]), 2 * leg.stiffness(Q)) < 1e-15
    assert worst(robot.mass([Q, Q]), 2 * leg.mass(Q)) < 1e-15
    np.testing.assert_allclose(robot.modes([Q, Q]).frequency, leg.modes(Q).frequency, rtol=1e-13)


@pytest.mark.long
def test_derivatives_beside_differences():
    """By springs, the diameter of a beam, places, masses, and how the legs stand."""
    robot, q = platform(beam=Beam.tube(0.08, 0.06))
    legs, q = robot.legs[:2], q[:2]  # all do the same
    rng = np.random.default_rng(0)
    weights = rng.normal(size=(2, 6, 6)) / np.array([1e8, 1e2])[:, None, None]

    def felt(change):
        def leg(leg, springs, place, mass, tube):
            where = lambda leg: (leg.compliance, leg.robot.flange.xyz, leg.robot.mass, leg.beams["slide"])  # noqa: E731
            slide = leg.compliance[2] * (1 + springs)
            changed = (leg.compliance.at[2].set(slide), leg.robot.flange.xyz + place, leg.robot.mass * (1 + mass))
            return eqx.tree_at(where, leg, (*changed, Beam.tube(0.08 + tube, 0.06)))

        springs, places, masses, tube, joints = jnp.split(change, [2, 5, 6, 7])
        other = ParallelRobot([leg(one, c, places, masses[0], tube[0]) for one, c in zip(legs, springs, strict=True)])
        at = [own + joints for own in q]
        return jnp.sum(weights[0] * other.stiffness(at)) + jnp.sum(weights[1] * other.mass(at))

    one, gradient = jnp.zeros(13), jax.jit(jax.grad(felt))
    backward, value = gradient(one), jax.jit(felt)
    for i in range(13):
        step = np.zeros(13)
        step[i] = 1e-6
        difference = (value(step) - value(-step)) / 2e-6
        assert abs(difference) > 1e-4
        np.testing.assert_allclose(backward[i], difference, rtol=1e-6, atol=1e-8)
    direction = jnp.asarray(rng.normal(size=13))
    np.testing.assert_allclose(
        jax.jit(lambda d: jax.jvp(felt, (one,), (d,))[1])(direction), backward @ direction, rtol=1e-10
    )


# What is refused


def test_legs_that_do_not_meet(hexapod):
    robot, q = hexapod
    away = (*q[:3], q[3] + 1e-3 * np.eye(6)[2], *q[4:])
    with pytest.raises(ValueError, match=r"q: leg 4 ends 0\.00\d+ \(m, or parts of 1 .* from where leg 1 does"):
        robot.check(away)


def test_another_number_of_legs(hexapod):
    robot, q = hexapod
    for of in (robot.check, robot.stiffness, robot.mass, robot.modes):
        with pytest.raises(ValueError, match="q: given for 5 legs; the robot has 6"):
            of(q[:5])
    with pytest.raises(ValueError, match="legs: none given"):
        ParallelRobot([])


def test_a_leg_that_cannot_follow():
    robot, q = planar()
    stiff = Robot(
        ("foot", "slide", "hand"),
        *(getattr(robot.legs[1].robot, name)[:3] for name in ("kinds", "xyz", "rpy", "axis", "zero")),
        flange=robot.legs[1].robot.flange,
    )
    legs = (robot.legs[0], ElasticRobot(stiff, [FREE, 1e-7, FREE]), robot.legs[2])
    with pytest.raises(ValueError, match="q: leg 2 cannot follow the tool in all six directions; free it there"):
        ParallelRobot(legs).check((q[0], q[1][:3], q[2]))


def test_a_platform_that_moves_by_itself(hexapod):
    robot, q = hexapod
    words = "q: the platform can move without any spring giving way: too few springs"
    loose = dataclasses.replace(robot.legs[2], compliance=np.full(6, FREE))
    np.testing.assert_array_equal(loose.stiffness(q[2]), 0)  # a leg of hinges only carries what it weighs
    np.testing.assert_allclose(loose.mass(q[2]), robot.legs[2].mass(q[2]), rtol=1e-10)
    with pytest.raises(ValueError, match=words):
        ParallelRobot((*robot.legs[:2], loose, *robot.legs[3:])).check(q)
    flat, q = planar(beside=(FREE, FREE, FREE))
    with pytest.raises(ValueError, match=words):
        flat.check(q)


def test_a_leg_that_moves_by_itself():
    """A hinge more, beside one about the same axis."""
    robot, q = planar()
    legs = [leg.robot for leg in robot.legs]
    of = legs[1]
    double = Robot(
        names=("foot", "slide", "hand", "finger", "lift", "roll", "pitch"),
        kinds=(*of.kinds[:3], "revolute", *of.kinds[3:]),
        **{
            name: np.insert(getattr(of, name), 3, getattr(of, name)[2] * (name == "axis"), axis=0)
            for name in ("xyz", "rpy", "axis", "zero")
        },
        flange=of.flange,
    )
    two = ElasticRobot(double, np.insert(robot.legs[1].compliance, 3, FREE))
    with pytest.raises(ValueError, match="q: the passive joints of leg 2 can move while the tool rests"):
        ParallelRobot((robot.legs[0], two, robot.legs[2])).check((q[0], np.insert(q[1], 3, 0.0), q[2]))


def test_a_leg_beyond_its_limits(hexapod):
    robot, q = hexapod
    short = eqx.tree_at(
        lambda leg: (leg.robot.lower, leg.robot.upper),
        robot.legs[4],
        (jnp.full(6, -3.0), jnp.full(6, 0.5)),
        is_leaf=lambda x: x is None,
    )
    with pytest.raises(ValueError, match=r"q of leg 5: .* m given for slide; it must be from -3 m to 0\.5 m"):
        ParallelRobot((*robot.legs[:4], short, robot.legs[5])).check(q)


def test_traced_coordinates_have_nothing_to_look_at(hexapod):
    robot, q = hexapod
    jax.jit(lambda q: robot.check(q))(tuple(jnp.asarray(own) + 1 for own in q))
