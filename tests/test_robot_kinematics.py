"""Poses, Jacobians and gravity of robots beside Pinocchio; derivatives beside differences; Denavit-Hartenberg tables."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import pinocchio_of

from millax.robot import Placement, Robot, models

BUILT_IN = {
    "kuka_kr270": models.kuka_kr270,
    "kuka_kr210_r2700_2": models.kuka_kr210_r2700_2,
    "abb_irb6660": models.abb_irb6660,
    "abb_irb6660_ha": models.abb_irb6660_ha,
}
FIELD = np.array([0.4, -0.3, -9.81])  # a floor that is not level


@jax.jit
def computed(robot, q):
    """Pose, Jacobian and gravity at many q. One program for all robots of as many joints of the same kinds."""
    gravity = jax.vmap(lambda q: robot.gravity(q, FIELD))(q)
    return jax.vmap(robot.pose)(q), jax.vmap(robot.jacobian)(q), gravity


def loaded(robot: Robot, seed: int) -> Robot:
    """The robot with a tool, and with masses and centres of mass where it has none."""
    rng = np.random.default_rng(seed)
    n = robot.joints
    return Robot(
        names=tuple(f"joint_{i}" for i in range(n)),
        kinds=robot.kinds,
        xyz=robot.xyz,
        rpy=robot.rpy,
        axis=robot.axis,
        zero=robot.zero,
        base=robot.base,
        flange=robot.flange,
        tool=Placement((0.12, -0.05, 0.31), (0.3, -0.7, 1.9)),
        mass=rng.uniform(10, 300, n) if robot.mass is None else robot.mass,
        centre_of_mass=rng.normal(0, 0.3, (n, 3)) if robot.centre_of_mass is None else robot.centre_of_mass,
    )


def any_robot(seed: int, joints: int = 5) -> Robot:
    """Any placements, any axes of any length, two sliding joints."""
    rng = np.random.default_rng(seed)
    return Robot(
        names=tuple(f"joint_{i}" for i in range(joints)),
        kinds=("revolute", "prismatic", "revolute", "revolute", "prismatic", *("revolute",) * (joints - 5)),
        xyz=rng.normal(size=(joints, 3)),
        rpy=rng.uniform(-np.pi, np.pi, (joints, 3)),
        axis=rng.normal(size=(joints, 3)),
        zero=rng.normal(size=joints),
        base=Placement(rng.normal(size=3), rng.uniform(-np.pi, np.pi, 3)),
        flange=Placement(rng.normal(size=3), rng.uniform(-np.pi, np.pi, 3)),
        tool=Placement(rng.normal(size=3), rng.uniform(-np.pi, np.pi, 3)),
        mass=rng.uniform(1, 10, joints),
        centre_of_mass=rng.normal(size=(joints, 3)),
    )


def reference(robot: Robot, q):
    """The same by Pinocchio."""
    pin = pytest.importorskip("pinocchio")
    model, frame = pinocchio_of(robot, FIELD)
    data, zero = model.createData(), np.asarray(robot.zero)
    found = []
    for one in np.asarray(q):
        pin.framesForwardKinematics(model, data, one + zero)
        jacobian = pin.computeFrameJacobian(model, data, one + zero, frame, pin.LOCAL_WORLD_ALIGNED)
        gravity = pin.computeGeneralizedGravity(model, data, one + zero)
        found.append((data.oMf[frame].homogeneous, jacobian.copy(), gravity.copy()))
    return [np.array(one) for one in zip(*found, strict=True)]


ROBOTS = {name: loaded(make(), seed) for seed, (name, make) in enumerate(BUILT_IN.items())}
ROBOTS["any"] = any_robot(11)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS.keys())
def test_pose_jacobian_and_gravity_are_those_of_pinocchio(robot):
    q = np.random.default_rng(2).uniform(-np.pi, np.pi, (1000, robot.joints))
    for ours, theirs in zip(computed(robot, q), reference(robot, q), strict=True):
        assert np.abs(np.asarray(ours) - theirs).max() < 1e-10 * np.abs(theirs).max()


@jax.jit
def differentiated(robot, q):
    def velocity(pose, rate):  # angular: R' R^T is the matrix of omega x
        spin = rate[:3, :3] @ pose[:3, :3].T
        return jnp.stack([*rate[:3, 3], spin[2, 1], spin[0, 2], spin[1, 0]])

    def columns(q):
        return jax.vmap(velocity, in_axes=(None, 2), out_axes=1)(robot.pose(q), jax.jacfwd(robot.pose)(q))

    return jax.vmap(columns)(q)


def test_the_jacobian_is_the_derivative_of_the_pose():
    robot = any_robot(5)
    q = np.random.default_rng(6).uniform(-np.pi, np.pi, (100, robot.joints))
    expected = differentiated(robot, q)
    np.testing.assert_allclose(jax.jit(jax.vmap(robot.jacobian))(q), expected, atol=1e-12 * np.abs(expected).max())


def test_gravity_is_the_derivative_of_the_potential():
    robot = any_robot(7)

    def potential(q):
        frames = robot.frames(q)
        centre = frames.position + jnp.einsum("nij,nj->ni", frames.rotation, robot.centre_of_mass)
        return 9.81 * robot.mass @ centre[:, 2]

    q = np.array([0.3, -0.4, 1.2, 2.0, 0.1])
    np.testing.assert_allclose(robot.gravity(q), jax.grad(potential)(q), rtol=1e-12)


def test_the_frames_end_in_the_pose():
    robot = any_robot(8)
    q = np.array([0.3, -0.4, 1.2, 2.0, 0.1])
    frames = robot.frames(q)
    assert frames.rotation.shape == (5, 3, 3)
    assert frames.position.shape == (5, 3)
    flange = eqx.tree_at(lambda r: (r.flange, r.tool), robot, (Placement(), Placement())).pose(q)
    np.testing.assert_array_equal(flange[:3, 3], frames.position[-1])
    np.testing.assert_allclose(frames.rotation @ frames.rotation.swapaxes(1, 2), np.tile(np.eye(3), (5, 1, 1)), atol=1e-14)


def row(a, alpha, d, angle):
    """Rz(angle) Tz(d) Tx(a) Rx(alpha), as textbooks print it."""
    (c, s), (ca, sa) = ((np.cos(x), np.sin(x)) for x in (angle, alpha))
    return np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])


TABLE = np.array(
    [
        [0.35, 1.15, -0.041, 0.02, 0.01, 0.03],
        [-1.5, 0.01, -1.6, 1.5, -1.4, 0.1],
        [0.675, 0.02, -0.01, 1.2, 0.015, 0.24],
        [0.1, -1.4, 0.2, -0.3, 0.5, 3.0],
    ]
)
"""a, alpha, d, theta: all of them different from 0."""
SOMEWHERE = np.array([0.4, -0.9, 1.3, 2.5, -0.7, 1.1])


def test_a_table_of_denavit_and_hartenberg_is_the_product_of_its_rows():
    robot = Robot.from_dh(*TABLE, base=Placement((0.1, 0.2, 0.3), (0.0, 0.0, 0.5)))
    expected = row(0.0, 0.0, 0.0, 0.5)
    expected[:3, 3] = 0.1, 0.2, 0.3
    for (a, alpha, d, theta), q in zip(TABLE.T, SOMEWHERE, strict=True):
        expected = expected @ row(a, alpha, d, theta + q)
    np.testing.assert_allclose(robot.pose(SOMEWHERE), expected, atol=1e-14)
    assert robot.names == tuple(f"joint_{i}" for i in range(1, 7))


def test_the_table_can_be_read_off_the_robot():
    robot = Robot.from_dh(*TABLE)
    xyz, rpy = (np.vstack([of[1:], last]) for of, last in ((robot.xyz, robot.flange.xyz), (robot.rpy, robot.flange.rpy)))
    np.testing.assert_array_equal([xyz[:, 0], rpy[:, 0], xyz[:, 2], robot.zero], TABLE)


def test_derivatives_by_the_table_beside_differences():
    pose = jax.jit(lambda table: Robot.from_dh(*table).pose(SOMEWHERE))
    forward, reverse = jax.jit(jax.jacfwd(pose))(TABLE), jax.jit(jax.jacrev(pose))(TABLE)
    step = 1e-5
    for index in np.ndindex(TABLE.shape):
        nudge = np.zeros_like(TABLE)
        nudge[index] = step
        difference = (pose(TABLE + nudge) - pose(TABLE - nudge)) / (2 * step)
        # Truncation: step²/6 of the third derivative, at most 3 m; rounding: 1e-16/step.
        np.testing.assert_allclose(forward[..., *index], difference, atol=2e-10)
    np.testing.assert_allclose(reverse, forward, atol=1e-13)


def test_every_number_of_a_robot_has_a_derivative():
    robot = any_robot(9)
    slopes = jax.jit(jax.grad(lambda r: jnp.sum(r.gravity(jnp.ones(5)) ** 2) + jnp.sum(r.jacobian(jnp.ones(5)) ** 2)))(robot)
    leaves = jax.tree.leaves(slopes)
    assert len(leaves) == len(jax.tree.leaves(robot)) == 12
    assert all(np.isfinite(leaf).all() for leaf in leaves)
    # Only the direction of an axis counts: its derivative has nothing along the axis.
    np.testing.assert_allclose(np.sum(slopes.axis * robot.axis, axis=1), 0.0, atol=1e-9)


def test_the_program_does_not_grow_with_the_joints():
    def operations(joints):
        robot = any_robot(10, joints)
        return [str(step.primitive) for step in jax.make_jaxpr(robot.jacobian)(jnp.zeros(joints)).eqns]

    assert operations(50) == operations(6)


def test_the_two_kuka_arms_count_their_angles_alike():
    # The KR210's lengths in a table like that of the KR270 are the KR210 of its description.
    ours = models.kuka_kr270()
    theirs = models.kuka_kr210_r2700_2()
    a, d = ours.xyz[:, 0], ours.xyz[:, 2]
    ours = eqx.tree_at(
        lambda r: (r.xyz, r.flange.xyz),
        ours,
        (
            ours.xyz.at[:, 0].set(a.at[1:4].set([0.33, 1.15, 0.115])).at[:, 2].set(d.at[1].set(-0.645).at[4].set(-1.22)),
            ours.flange.xyz.at[2].set(-0.215),
        ),
    )
    np.testing.assert_allclose(ours.pose(SOMEWHERE), theirs.pose(SOMEWHERE), atol=1e-14)


def test_poses_that_can_be_drawn():
    upright = np.deg2rad([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
    down = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]  # the flange's z along +x
    for robot, q, place in (
        (models.kuka_kr270(), upright, (0.350 + 1.200 + 0.240, 0, 0.675 + 1.150 - 0.041)),
        (models.kuka_kr210_r2700_2(), upright, (0.33 + 1.22 + 0.215, 0, 0.645 + 1.15 + 0.115)),
        (models.abb_irb6660(), np.zeros(6), (0.300 + 0.893 + 0.200, 0, 0.8145 + 0.700 + 0.280)),
    ):
        pose = robot.pose(q)
        np.testing.assert_allclose(pose[:3, 3], place, atol=1e-14)
        np.testing.assert_allclose(pose[:3, :3], down, atol=1e-14)
    # Of the IRB 6660 with the lengths of the paper the forearm and the wrist point up at zero.
    np.testing.assert_allclose(models.abb_irb6660_ha().pose(np.zeros(6))[:3, 3], [1.28, 0, 0.5145 + 1.06024 + 0.377])


def test_the_kr270_is_as_stiff_as_its_lengths_say():
    # Joint compliances and pose of C (Table 1). The stiffness across the arm with the other directions held is the figure of
    # an earlier, separate calculation; with a_3 = 0 it would be 2.54 MN/m.
    compliance = 1e-6 * np.array([0.26, 0.15, 0.26, 1.79, 1.52, 2.13])
    jacobian = models.kuka_kr270().jacobian(np.deg2rad([90.0, -50.0, 120.0, 180.0, 25.0, 180.0]))
    stiffness = np.linalg.inv(jacobian @ np.diag(compliance) @ jacobian.T)
    assert stiffness[0, 0] == pytest.approx(2.68e6, rel=2e-3)


@pytest.mark.parametrize("name", ["abb_irb6660", "abb_irb6660_ha"])
def test_gravity_without_masses(name):
    with pytest.raises(ValueError, match=r"robot: this one has no mass and no centre_of_mass; give them for every link"):
        BUILT_IN[name]().gravity(np.zeros(6))


def test_limits():
    robot = models.kuka_kr210_r2700_2()
    inside = np.deg2rad([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
    robot.check(inside)
    robot.check(np.tile(inside, (3, 1)))
    for limit in (robot.lower, robot.upper):
        robot.check(np.float32(limit))
    with pytest.raises(
        ValueError, match=r"q: 0 rad \(0 deg\) given for joint_2; .* from -2\.443 rad \(-140 deg\) to -0\.08727"
    ):
        robot.check(np.zeros(6))
    path = np.tile(inside, (3, 1))
    path[1, 4] = np.nan
    with pytest.raises(ValueError, match=r"q: nan rad given for joint_5 in set \(1,\); "):
        robot.check(path)
    with pytest.raises(ValueError, match=r"q: shape \(5,\) given; the last axis must be the 6 joints"):
        robot.check(np.zeros(5))
    models.kuka_kr270().check(np.full(6, 100.0))  # no limits are known
    jax.jit(lambda q: robot.check(q))(np.zeros(6))  # traced: no value to look at
    sliding = eqx.tree_at(lambda r: (r.lower, r.upper), any_robot(1), (-np.ones(5), np.ones(5)), is_leaf=lambda x: x is None)
    with pytest.raises(ValueError, match=r"q: 2 m given for joint_1; it must be from -1 m to 1 m"):
        sliding.check([0.0, 2.0, 0.0, 0.0, 0.0])


def test_coordinates_of_another_shape():
    with pytest.raises(ValueError, match=r"q: shape \(2, 6\) given; it must be \(6,\), .* use jax\.vmap"):
        models.kuka_kr270().pose(np.zeros((2, 6)))


GOOD = {
    "names": ("a", "b"),
    "kinds": ("revolute", "prismatic"),
    "xyz": np.ones((2, 3)),
    "rpy": np.zeros((2, 3)),
    "axis": [(0, 0, 1), (0, 1, 0)],
    "zero": np.zeros(2),
}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"names": ("a", "a")}, r"robot\.names: \['a', 'a'\] given; name each joint"),
        ({"names": ()}, r"robot\.names: \[\] given"),
        ({"kinds": ("revolute", "screw")}, r"robot\.kinds: .* one of \['revolute', 'prismatic'\]"),
        ({"xyz": np.ones((3, 3))}, r"robot\.xyz: shape \(3, 3\) given; with 2 joints it must be \(2, 3\)"),
        ({"rpy": np.full((2, 3), np.nan)}, r"robot\.rpy: nan rad given"),
        ({"axis": [(0, 0, 1), (0, 0, 0)]}, r"robot\.axis: that of b has no length"),
        ({"mass": [1.0, -2.0]}, r"robot\.mass: -2 kg given; it must be 0 or greater"),
        ({"inertia": np.triu(np.ones((2, 3, 3)))}, r"robot\.inertia: .* not symmetric"),
        ({"lower": [0.0, 0.0]}, "give lower and upper together"),
        ({"lower": [0.0, 1.0], "upper": [1.0, 0.5]}, r"robot\.lower: 1 given for b; .* less than its upper limit, 0\.5"),
        ({"tool": Placement(np.zeros((2, 3)))}, r"robot\.tool: shapes \(2, 3\) and \(3,\) given; both must be \(3,\)"),
        ({"base": Placement((np.inf, 0, 0))}, r"robot\.base\.xyz: inf m given"),
    ],
)
def test_bad_robots_are_named(arguments, message):
    Robot(**GOOD)
    with pytest.raises(ValueError, match=message):
        Robot(**(GOOD | arguments))


def test_tables_of_unequal_rows():
    with pytest.raises(ValueError, match=r"a, alpha, d, theta of shapes \[\(2,\), \(1,\), \(2,\), \(2,\)\]"):
        Robot.from_dh([1.0, 1.0], [0.0], [0.0, 0.0], [0.0, 0.0])
