"""Robots that give way in joints and links, at rest: what loads do, beside closed forms, the papers' iteration, differences
and finite elements; and what is refused."""

import dataclasses
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from arms import ARMS, LOADS, POSES, SECTION, any_arm, arm, standing, worst
from scipy.spatial.transform import Rotation

from benchmarks import frame, unreduced
from benchmarks.kr270 import COMPLIANCE
from benchmarks.kr270 import JOINTS as Q
from millax.robot import Beam, ElasticRobot, Loads, Payload, Placement, Robot, models

TURNING = ("revolute",) * 6
SLIDING = ("prismatic", "revolute", "revolute", "prismatic", "revolute", "revolute", "revolute")


# Loads


@eqx.filter_jit
def motions(robot: ElasticRobot, q, loads: Loads, derivative):
    """The motion of the tool by the wrench, from derivatives of the equilibrium itself."""

    def tool(wrench):
        pose = robot.chain.pose(robot.equilibrium(q, Loads(wrench[:3], wrench[3:], loads.gravity)))
        return jnp.concatenate([pose[:3, 3], pose[:3, :3].ravel()])

    at, change = tool(loads.wrench), derivative(tool)(loads.wrench)
    spin = jnp.einsum("ikw,jk->ijw", change[3:].reshape(3, 3, 6), at[3:].reshape(3, 3))  # dR R^T, the matrix of the turn x
    skew = (spin - spin.swapaxes(0, 1)) / 2
    return jnp.concatenate([change[:3], jnp.stack([skew[2, 1], skew[0, 2], skew[1, 0]])])


@pytest.mark.parametrize("beams", [ARMS["rigid links"], pytest.param(ARMS["beams"], marks=pytest.mark.long)], ids=ARMS)
def test_the_stiffness_under_loads_is_that_of_the_equilibrium(beams):
    for make, q in itertools.product((models.kuka_kr270, models.kuka_kr210_r2700_2), POSES.values()):
        robot = arm(make, beams)
        at = robot.at_tool(q, LOADS)
        stands, springs = standing(robot, at.coordinates), np.asarray(robot.springs)
        # Springs and loads in balance: rounding of x is 1e-16 of 2 rad, over deflections of 1e-4 rad.
        assert worst(springs @ (at.coordinates - robot.extended(q)), stands.load(LOADS)) < 1e-11
        # The Hessian written out, all its terms. What is measured is 5e-15; the condition number is 40.
        jacobian, slope = stands.jacobian(), stands.load_slope(LOADS)
        expected = jacobian @ np.linalg.solve(springs - slope, jacobian.T)
        assert worst(at.stiffness, np.linalg.inv(expected)) < 1e-12
        # The same without the Hessian is something else, and with it unsymmetric, by the moment.
        assert worst(np.linalg.inv(jacobian @ np.linalg.solve(springs, jacobian.T)), at.stiffness) > 1e-4
        assert worst(at.stiffness.T, at.stiffness) > 1e-6
        # What the tool does as the wrench changes, through the root finder.
        for derivative in (jax.jacfwd, jax.jacrev):
            assert worst(motions(robot, q, LOADS, derivative), expected) < 1e-12


@pytest.mark.parametrize("beams", [{}, {"joint_3": SECTION}], ids=ARMS)
def test_the_load_changes_with_the_coordinates_as_its_hessian_says(beams):
    """For sliding joints and any axes, too, and far from where springs hold it."""
    robot = any_arm(3, SLIDING, beams)
    x = np.random.default_rng(4).normal(size=robot.coordinates) * 0.3
    stands = standing(robot, x)
    load, slope = jax.jit(lambda x: (robot.load(x, LOADS), jax.jacfwd(robot.load)(x, LOADS)))(x)
    assert worst(load, stands.load(LOADS)) < 1e-13
    assert worst(slope, stands.load_slope(LOADS)) < 1e-13


def test_a_sum_of_compliances_under_loads_is_the_inverse_of_the_stiffness():
    robot = arm(models.kuka_kr270, {})
    assert worst(robot.tool_compliance(Q, LOADS) @ robot.stiffness(Q, LOADS), np.eye(6)) < 1e-10  # N/m beside N m/rad


def test_the_iteration_of_the_papers_finds_the_same_loads():
    """C 10: from where the tool is to the wrench that holds it there, and the deflections."""
    robot = arm(models.kuka_kr270, {})
    x = np.asarray(robot.equilibrium(Q, LOADS))
    tool = standing(robot, x)
    springs, theta = np.asarray(robot.springs), np.zeros(6)
    for _ in range(6):
        stands = standing(robot, Q + theta)
        j, weight = stands.jacobian(), stands.load(Loads(gravity=LOADS.gravity))
        away = Rotation.from_matrix(tool.rotation @ stands.rotation.T).as_rotvec()
        miss = np.concatenate([tool.tip - stands.tip, away])
        flexibility = j @ np.linalg.solve(springs, j.T)
        wrench = np.linalg.solve(flexibility, miss + j @ theta - j @ np.linalg.solve(springs, weight))
        theta = np.linalg.solve(springs, weight + j.T @ wrench)
    # Of deflections of 1e-4 rad rounding leaves 1e-12.
    assert worst(wrench, np.asarray(LOADS.wrench)) < 1e-9
    assert worst(theta, x - Q) < 1e-9


def test_a_robot_without_masses_holds_a_force():
    robot = ElasticRobot(models.abb_irb6660(), COMPLIANCE)
    force = Loads((300.0, -500.0, 800.0))
    x = robot.equilibrium(POSES["another"], force)
    np.testing.assert_allclose((x - POSES["another"]) / COMPLIANCE, standing(robot, x).load(force), rtol=1e-11)
    with pytest.raises(ValueError, match="this one has no mass and no centre_of_mass"):
        robot.equilibrium(POSES["another"], Loads(gravity=(0.0, 0.0, -9.81)))


def test_loads_that_the_springs_do_not_hold_are_an_error():
    robot = arm(models.kuka_kr270, {})
    with pytest.raises(ValueError, match="loads: no equilibrium found near q; they are beyond what the springs hold"):
        robot.stiffness(Q, Loads(np.full(3, 1e7)))


def test_loads_in_single_precision():
    robot = arm(models.kuka_kr270, {})
    expected = robot.at_tool(Q, LOADS)
    with jax.enable_x64(False):
        robot, loads = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), (robot, LOADS))
        found = robot.at_tool(Q, loads)
    assert found.stiffness.dtype == jnp.float32
    # Rounding of angles is 1e-7 of 3 rad; of the stiffness 1e-7 times its condition number, 40.
    np.testing.assert_allclose(found.coordinates - np.float32(Q), expected.coordinates - Q, atol=1e-6)
    assert worst(found.stiffness, np.asarray(expected.stiffness)) < 1e-5


# Beams


def test_the_end_of_a_beam_moves_as_the_textbook_says():
    length, beam = 1.7, SECTION
    e, iy, iz = 210e9, 2e-5, 5e-5
    expected = np.zeros((6, 6))
    expected[0, 0], expected[3, 3] = length / (e * 5e-3), length / (81e9 * 3e-5)
    for u, r, sign, moment in ((1, 5, 1, iz), (2, 4, -1, iy)):  # a push along z turns the end about -y
        expected[u, u], expected[r, r] = length**3 / (3 * e * moment), length / (e * moment)
        expected[u, r] = expected[r, u] = sign * length**2 / (2 * e * moment)
    np.testing.assert_allclose(beam.compliance(length), expected, rtol=1e-14)
    # On a joint about z, in its own axes: x along the link, y where its side is.
    robot = ElasticRobot(Robot(("a",), ("revolute",), [(0, 0, 0)], [(0, 0, 0)], [(0, 0, 1)], [0.0]), [1e-6])
    way = np.array([0.9, -0.8, 1.2])
    robot = eqx.tree_at(lambda r: r.robot.flange.xyz, robot, jnp.asarray(length * way / np.linalg.norm(way)))
    robot = ElasticRobot(robot.robot, [1e-6], {"a": beam})
    x = way / np.linalg.norm(way)
    z = np.cross(x, beam.side) / np.linalg.norm(np.cross(x, beam.side))
    axes = np.kron(np.eye(2), np.array([x, np.cross(z, x), z]).T)
    joint = np.concatenate([np.cross([0, 0, 1], length * x), [0, 0, 1]])
    expected = 1e-6 * np.outer(joint, joint) + axes @ expected @ axes.T
    assert worst(robot.tool_compliance([0.0]), expected) < 1e-14
    assert worst(robot.stiffness([0.0]), np.linalg.inv(expected)) < 1e-10


def test_a_tube_is_a_beam_of_its_diameters():
    tube = Beam.tube(0.3, 0.2)
    np.testing.assert_allclose(tube.area, np.pi * (0.15**2 - 0.1**2), rtol=1e-14)
    np.testing.assert_allclose(tube.second_moment_y, np.pi / 4 * (0.15**4 - 0.1**4), rtol=1e-14)
    assert float(tube.second_moment_z) == float(tube.second_moment_y)
    np.testing.assert_allclose(tube.torsion, 2 * tube.second_moment_y, rtol=1e-14)
    # All that a round section must not depend on: which axes across it are y and z.
    flange = np.array([0.3, -0.8, 0.5])
    robot = Robot(("a",), ("revolute",), [(0, 0, 0)], [(0, 0, 0)], [(0, 0, 1)], [0.0], flange=Placement(flange))
    either = [
        ElasticRobot(robot, [1e-6], {"a": dataclasses.replace(tube, side=side)}).tool_compliance([0.4])
        for side in (None, jnp.array([1.0, 2.0, 3.0]))
    ]
    assert worst(*either) < 1e-13


@pytest.mark.parametrize(
    "beams",
    [
        {},
        {"joint_2": SECTION, "joint_4": Beam.tube(0.2, 0.17)},
        {f"joint_{i}": SECTION for i in range(1, 7)},
    ],
    ids=["rigid links", "some beams", "all beams"],
)
def test_what_a_wrench_does_to_an_arm_is_that_of_finite_elements(beams):
    robot = any_arm(5, TURNING, beams)
    for q in np.random.default_rng(6).uniform(-np.pi, np.pi, (3, 6)):
        expected = frame.tip_compliance(unreduced.full(robot, q))
        assert worst(robot.tool_compliance(q), expected) < 1e-13
        assert worst(robot.stiffness(q), np.linalg.inv(expected)) < 1e-10  # the condition number is 1e4


def test_a_built_in_arm_with_beams_beside_finite_elements():
    for make in (models.kuka_kr270, models.kuka_kr210_r2700_2):
        robot = arm(make, ARMS["beams"])
        for q in POSES.values():
            expected = frame.tip_compliance(unreduced.full(robot, q))
            assert worst(robot.tool_compliance(q), expected) < 1e-13
            assert worst(robot.stiffness(q), np.linalg.inv(expected)) < 1e-12


def test_what_a_tool_feels_at_a_singular_pose_has_a_compliance():
    """With the wrist stretched out, joints 4 and 6 are one: K_C has no value there, its inverse has."""
    robot, q = arm(models.kuka_kr270, {}), np.deg2rad([90.0, -50.0, 120.0, 180.0, 0.0, 180.0])
    jacobian = standing(robot, q).jacobian()
    assert np.linalg.matrix_rank(jacobian, tol=1e-9) == 5
    assert worst(robot.tool_compliance(q), jacobian * COMPLIANCE @ jacobian.T) < 1e-13


def test_seven_joints_share_what_the_tool_does():
    robot = any_arm(7, ("revolute",) * 7, {})
    q = np.linspace(-1, 1, 7)
    jacobian = standing(robot, q).jacobian()
    expected = np.linalg.inv(jacobian * robot.compliance @ jacobian.T)
    at = robot.at_tool(q)
    assert worst(at.stiffness, expected) < 1e-11
    # Of all deflections that lead there those of the least energy.
    assert worst(at.follow, np.asarray(robot.compliance)[:, None] * jacobian.T @ expected) < 1e-11


# One program


class Counted(ElasticRobot):
    """Counts how often its springs are traced."""

    @property
    def springs(self):
        TRACES.append(1)
        return super().springs


TRACES: list[int] = []


def test_other_numbers_are_no_reason_to_compile_again():
    def changed(robot, by):
        return jax.tree.map(lambda leaf: leaf * by, robot)

    robot = Counted(models.kuka_kr270(), COMPLIANCE, {"joint_2": SECTION})
    first = robot.stiffness(Q), robot.stiffness(Q, LOADS)
    traces = len(TRACES)
    assert traces > 0
    other = changed(robot, 1.01)
    again = other.stiffness(Q * 1.01), other.stiffness(Q * 1.01, changed(LOADS, 1.01))
    assert len(TRACES) == traces
    assert all(worst(*pair) > 1e-3 for pair in zip(first, again, strict=True))
    assert worst(robot.stiffness(Q.tolist()), first[0]) == 0  # a list is no other kind of number
    assert len(TRACES) == traces


def test_many_poses_at_once():
    robot = arm(models.kuka_kr270, {})
    poses = Q + np.random.default_rng(8).normal(size=(5, 6)) * 0.3
    together = jax.jit(jax.vmap(lambda q: robot.at_tool(q, LOADS)))(poses)
    for i, q in enumerate(poses):
        one = robot.at_tool(q, LOADS)
        for ours, theirs in zip(jax.tree.leaves(together), jax.tree.leaves(one), strict=True):
            assert worst(ours[i], np.asarray(theirs)) < 1e-12


# What is refused


def test_poses_where_the_tool_cannot_move_in_one_direction():
    robot = ElasticRobot(models.kuka_kr270(), COMPLIANCE)
    robot.check(Q)
    elbow = np.rad2deg(np.arctan(41 / 1200))  # the wrist on a line with joints 2 and 3
    for degrees, which, out in (
        ((0, -90, 90, 10, 0, 20), r"joint_4 and joint_6", 5),
        ((10, -50, -elbow, 20, 40, 30), r"joint_2, joint_3, joint_4, joint_5 and joint_6", 3),
    ):
        with pytest.raises(ValueError, match=rf"robot\.joints: the pose \({degrees[0]}, .*\) deg is singular: {which} can "):
            robot.check(np.deg2rad(degrees), "robot.joints")
        with pytest.raises(ValueError, match=rf"\. Change joint_{out} by a degree"):
            robot.check(np.deg2rad(degrees))
        robot.check(np.deg2rad(degrees + np.eye(6)[out - 1]))
    # Elastic links give way there, too.
    ElasticRobot(robot.robot, COMPLIANCE, {"joint_2": SECTION}).check(np.deg2rad([0, -90, 90, 10, 0, 20]))


def test_a_pose_beyond_the_limits():
    robot = ElasticRobot(models.kuka_kr210_r2700_2(), COMPLIANCE)
    with pytest.raises(ValueError, match=r"robot\.joints: 0 rad \(0 deg\) given for joint_2; it must be from -2\.443 rad"):
        robot.check(np.zeros(6), "robot.joints")
    jax.jit(lambda q: robot.check(q))(np.zeros(6))  # traced: no value to look at


def test_fewer_springs_than_directions():
    two = Robot(("a", "b"), ("revolute",) * 2, np.ones((2, 3)), np.zeros((2, 3)), [(0, 0, 1), (0, 1, 0)], np.zeros(2))
    with pytest.raises(ValueError, match=r"q: with 2 springs the tool gives way in 2 of its six directions only; .*beams"):
        ElasticRobot(two, [1e-6, 1e-6]).check(np.zeros(2))


def test_a_mass_matrix_that_is_not_positive_definite():
    robot = models.kuka_kr270()
    for change in (
        {"mass": robot.mass.at[5].set(0.0), "inertia": robot.inertia.at[5].set(0.0)},
        {"inertia": robot.inertia.at[5].multiply(-1.0)},
    ):
        with pytest.raises(ValueError, match=r"mass matrix is not positive definite: what is moved by (.* )?joint_6 has no"):
            ElasticRobot(dataclasses.replace(robot, **change), COMPLIANCE).check(Q)
    # Where there is no inertia there is no mass matrix; springs need none.
    ElasticRobot(dataclasses.replace(robot, inertia=None), COMPLIANCE).check(Q)
    ElasticRobot(models.abb_irb6660(), COMPLIANCE).check(np.full(6, 0.5))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"area": 0.0}, r"beam\.area: 0 m² given; it must be greater than 0"),
        ({"torsion": -1e-5}, r"beam\.torsion: -1e-05 m⁴ given; it must be greater than 0"),
        ({"young": np.inf}, r"beam\.young: inf Pa given"),
        ({"shear": [8e10, 8e10]}, r"beam\.shear: shape \(2,\) given; it must be one number"),
        ({"side": (1.0, 0.0)}, r"beam\.side: shape \(2,\) given; it must be \(3,\)"),
        ({"side": (np.nan, 0.0, 1.0)}, r"beam\.side: nan given"),
        ({"side": None}, r"beam\.side: none given, with second moments of 2e-05 and 5e-05 m⁴; give the direction"),
    ],
)
def test_bad_beams_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(SECTION, **change)
    with pytest.raises(ValueError, match=r"beam\.area: -0\.0392699 m² given"):
        Beam.tube(0.2, 0.3)


@pytest.mark.parametrize(
    ("compliance", "beams", "message"),
    [
        (COMPLIANCE[:5], {}, r"compliance: shape \(5,\) given; it must be \(6,\), one per joint"),
        (COMPLIANCE * [1, 1, 0, 1, 1, 1], {}, r"compliance: 0 rad/\(N m\) given for joint_3; it must be greater than 0"),
        (COMPLIANCE * [1, 1, 1, 1, -1, 1], {}, r"compliance: -1\.52e-06 rad/\(N m\) given for joint_5"),
        (COMPLIANCE * np.nan, {}, r"compliance: nan rad/\(N m\) given for joint_1"),
        (COMPLIANCE, {"joint_7": SECTION}, r"beams: joint_7 is no joint of the robot; its joints are joint_1, joint_2"),
        (COMPLIANCE, {"joint_5": SECTION}, r"beams: the link of joint_5 has no length"),
        (
            COMPLIANCE,
            {"joint_2": dataclasses.replace(SECTION, side=(2.0, 0.0, 0.0))},
            r"beams: side \[2\. 0\. 0\.\] of the link of joint_2 runs along it; give a direction across it",
        ),
    ],
)
def test_bad_springs_are_named(compliance, beams, message):
    with pytest.raises(ValueError, match=message):
        ElasticRobot(models.kuka_kr270(), compliance, beams)


def test_the_compliance_of_a_sliding_joint_has_its_unit():
    rail = Robot(("a",), ("prismatic",), [(0, 0, 0)], [(0, 0, 0)], [(0, 0, 1)], [0.0])
    with pytest.raises(ValueError, match=r"compliance: -1 m/N given for a"):
        ElasticRobot(rail, [-1.0])


def test_passive_joints_hold_no_loads():
    robot = ElasticRobot(models.kuka_kr270(), np.where(np.arange(6) == 3, np.inf, COMPLIANCE))
    words = "compliance: joint_4 is passive, and no spring holds it: give it one, or"
    for of in (robot.equilibrium, robot.stiffness, robot.mass):
        with pytest.raises(ValueError, match=f"{words} leave the loads out"):
            of(Q, LOADS)
    with pytest.raises(ValueError, match=f"{words} take the stiffness"):
        robot.tool_compliance(Q)
    # What the tool feels then is a stiffness that one motion has no part in, that of joint 4 alone.
    alone = standing(robot, Q).jacobian()[:, 3]
    stiffness = np.asarray(robot.stiffness(Q))
    assert np.abs(stiffness @ alone).max() < 1e-12 * np.abs(stiffness).max()
    assert np.linalg.matrix_rank(stiffness, tol=1e-6 * np.abs(stiffness).max()) == 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"force": (1.0, 2.0)}, r"loads\.force: shape \(2,\) given; it must be \(3,\), along x, y and z"),
        ({"moment": 1.0}, r"loads\.moment: shape \(\) given"),
        ({"gravity": (0.0, 0.0, np.inf)}, r"loads\.gravity: inf m/s² given; it must be a finite number"),
    ],
)
def test_bad_loads_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        Loads(**arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mass": [1.0]}, r"payload\.mass: shape \(1,\) given; it must be \(\)"),
        ({"mass": -1.0}, r"payload\.mass: -1 kg given; it must be 0 or greater"),
        ({"mass": 1.0, "centre_of_mass": (0.0, np.nan, 0.0)}, r"payload\.centre_of_mass: nan m given"),
        ({"mass": 1.0, "inertia": (1.0, 1.0, 1.0)}, r"payload\.inertia: shape \(3,\) given; it must be \(3, 3\)"),
    ],
)
def test_bad_payloads_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        Payload(**arguments)


def test_the_equilibrium_is_that_of_optimistix():
    robot, q = models.kuka_kr270(), np.deg2rad([90.0, -50.0, 120.0, 180.0, 25.0, 180.0])
    elastic = ElasticRobot(robot, 1e-6 * np.array([0.26, 0.15, 0.26, 1.79, 1.52, 2.13]), {"joint_2": Beam.tube(0.3, 0.25)})
    loads = Loads(force=(600.0, -640.0, 480.0), moment=(120.0, -80.0, 150.0), gravity=(0.0, 0.0, -9.81))
    rest = elastic.extended(q)

    def left(theta, _):
        return theta - jnp.linalg.solve(elastic.springs, elastic.load(rest + theta, loads))

    found = optx.root_find(left, optx.Newton(rtol=1e-12, atol=1e-15), jnp.zeros_like(rest)).value
    np.testing.assert_allclose(elastic.equilibrium(q, loads) - rest, found, rtol=1e-9, atol=1e-14)
