"""The robot: its mechanics beside Pinocchio, its springs beside closed forms, the papers' iteration and finite elements."""

import dataclasses
import importlib.util
from collections.abc import Iterator
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

import millax as mx
from millax.robot import Beam, ElasticRobot, Loads, Placement, Robot, Spindle, load_urdf, models

from .. import frame, kr270, legs, unreduced
from ..figures import Figure, below

POSES = 1000
FIELD = np.array([0.4, -0.3, -9.81])
"""g [m/s²] on a floor that is not level."""
SPINDLE = Spindle(
    (0.12, -0.05, 0.31),
    (0.3, -0.7, 1.9),
    mass=25.0,
    centre_of_mass=(0.02, -0.03, 0.15),
    inertia=[[0.5, 0.02, -0.03], [0.02, 0.6, 0.04], [-0.03, 0.04, 0.3]],
)
BUILT_IN = (models.kuka_kr270, models.kuka_kr210_r2700_2, models.abb_irb6660, models.abb_irb6660_ha)
URDF = Path(__file__).parents[1] / "fixed_links.urdf"

KR210_JOINTS = np.deg2rad([20.0, -80.0, 100.0, 30.0, 45.0, -20.0])
LOADS = Loads(force=(600.0, -640.0, 480.0), moment=(120.0, -80.0, 150.0), gravity=(0.0, 0.0, -9.81))
"""1 kN on the tool, and a moment."""
TUBES = {"joint_1": Beam.tube(0.50, 0.42), "joint_2": Beam.tube(0.30, 0.23), "joint_4": Beam.tube(0.20, 0.18)}
"""Of steel, and about as heavy as C's masses of these links."""


def figures():
    yield from _mechanics()
    yield from _under_loads()
    yield from _closed_forms()
    for row in kr270.rows():
        paper = f"; paper {row.paper}" if row.paper else ""
        why = f"; {row.why}" if row.why else ""
        yield Figure(f"KR270: {row.quantity}{paper}{why}", row.shown, row.target, row.met)
    yield from _reduction()
    yield from _derivatives()


def _largest(values, reference) -> float:
    return float(np.abs(np.asarray(values) - np.asarray(reference)).max() / np.abs(np.asarray(reference)).max())


def _scaled(matrix, reference) -> float:
    """Largest difference of two matrices at the tool, each entry beside the root of its two diagonal ones, as lengths and
    angles do not mix."""
    size = np.sqrt(np.diag(reference))
    return float(np.abs((np.asarray(matrix) - reference) / np.outer(size, size)).max())


# Pinocchio


def _mechanics() -> Iterator[Figure]:
    if importlib.util.find_spec("pinocchio") is None:
        yield Figure("pose, Jacobian, gravity and mass matrix beside Pinocchio", "left out: no pinocchio here", "", None)
        return
    from .. import pinocchio_models as pinocchio

    rng = np.random.default_rng(20130225)
    for make in BUILT_IN:
        robot = _with_masses(SPINDLE.on(make()))
        yield _beside(make.__name__, robot, pinocchio.built(robot), rng)
    yield _beside(
        "URDF with fixed links", load_urdf(URDF), pinocchio.from_urdf(URDF.read_text(encoding="utf-8"), "tool"), rng
    )


def _with_masses(robot: Robot) -> Robot:
    return robot if robot.mass is not None else robot.with_rods(0.1, mass=[300.0, 200.0, 120.0, 60.0, 30.0, 10.0])


@jax.jit
def _mechanics_of(robot: Robot, q):
    def one(q):
        return robot.pose(q), robot.jacobian(q), robot.gravity(q, FIELD), robot.mass_matrix(q)

    return jax.vmap(one)(q)


def _beside(name: str, robot: Robot, theirs, rng) -> Figure:
    from ..pinocchio_models import evaluated

    q = rng.uniform(-np.pi, np.pi, (POSES, robot.joints))
    error = max(map(_largest, _mechanics_of(robot, q), evaluated(theirs, q, robot.zero, FIELD)))
    what = f"{name}: pose, Jacobian, gravity, mass matrix beside Pinocchio in {POSES} poses, largest difference"
    return below(what, error, 1e-10, form=".1e")


# Loads


def _kr270(spindle: Spindle, beams: dict[str, Beam] | None = None) -> ElasticRobot:
    return ElasticRobot(spindle.on(models.kuka_kr270()), kr270.COMPLIANCE, beams or {})


def _kr210(spindle: Spindle) -> ElasticRobot:
    """On the joint springs of the other. Without its limits it differs in numbers only, and shares compiled programs."""
    robot = dataclasses.replace(models.kuka_kr210_r2700_2(), lower=None, upper=None)
    return ElasticRobot(spindle.on(robot), kr270.COMPLIANCE)


def _under_loads() -> Iterator[Figure]:
    for name, elastic, q in (
        ("KR270", _kr270(SPINDLE), kr270.JOINTS),
        ("KR210", _kr210(SPINDLE), KR210_JOINTS),
        ("KR270 of tubes", _kr270(SPINDLE, TUBES), kr270.JOINTS),
    ):
        what = f"{name} under 1 kN, a moment and gravity"
        stiffness, pose = np.asarray(elastic.stiffness(q, LOADS)), np.asarray(_held(elastic, q, LOADS.wrench))
        ways = {"differences": _differences}
        if not elastic.beams:  # with them, 24 coordinates take their time to compile
            ways |= {"forward mode": _forward, "reverse mode": _reverse}
        for by, rate in ways.items():
            derivative = _motion(pose, np.asarray(rate(elastic, q, LOADS.wrench)))
            error = _scaled(stiffness, np.linalg.inv(derivative))
            yield below(f"{what}: K_C beside the derivative of the equilibrium, {by}", error, 1e-8, form=".1e")
        error = _apart(_wrench_at(elastic, q, pose), LOADS)
        yield below(f"{what}: the wrench that C 10 finds at the loaded pose", error, 1e-8, form=".1e")


@eqx.filter_jit
def _held(elastic: ElasticRobot, q, wrench):
    """The pose at which the springs hold this wrench and gravity."""
    return elastic.chain.pose(elastic.equilibrium(q, Loads(wrench[:3], wrench[3:], LOADS.gravity)))


@eqx.filter_jit
def _forward(elastic, q, wrench):
    return jax.jacfwd(_held, argnums=2)(elastic, q, wrench)


@eqx.filter_jit
def _reverse(elastic, q, wrench):
    return jax.jacrev(_held, argnums=2)(elastic, q, wrench)


def _differences(elastic, q, wrench):
    steps = np.diag(np.repeat([100.0, 50.0], 3))  # [N], [N m]
    columns = [_richardson(lambda by, d=d: np.asarray(_held(elastic, q, wrench + by * d)), 1.0) / d.max() for d in steps]
    return np.stack(columns, axis=-1)


def _motion(pose: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Velocities and angular velocities, (6, n), from a pose and its rates, (4, 4, n)."""
    spin = np.einsum("ijw,kj->ikw", rate[:3, :3], pose[:3, :3])  # R' R^T is the matrix of omega x
    return np.concatenate([rate[:3, 3], np.stack([spin[2, 1], spin[0, 2], spin[1, 0]])])


@eqx.filter_jit
def _loaded_by_weight(elastic: ElasticRobot, x):
    """Pose, Jacobian and J_G^T G at the coordinates x."""
    return elastic.chain.pose(x), elastic.chain.jacobian(x), elastic.bodies(x).weight(LOADS.gravity)


def _wrench_at(elastic: ElasticRobot, q, goal: np.ndarray, iterations: int = 40) -> np.ndarray:
    """The iteration of C 10, which goes from a pose to the wrench that holds the tool there."""
    rest, give = np.asarray(elastic.extended(q)), np.linalg.inv(np.asarray(elastic.springs))
    theta, wrench = np.zeros_like(rest), np.zeros(6)
    for _ in range(iterations):
        pose, jacobian, weight = map(np.asarray, _loaded_by_weight(elastic, rest + theta))
        turn = Rotation.from_matrix(goal[:3, :3] @ pose[:3, :3].T).as_rotvec()
        way = np.concatenate([goal[:3, 3] - pose[:3, 3], turn])
        wrench = np.linalg.solve(jacobian @ give @ jacobian.T, way + jacobian @ (theta - give @ weight))
        theta = give @ (weight + jacobian.T @ wrench)
    return wrench


def _apart(wrench: np.ndarray, loads: Loads) -> float:
    """Relative error of force and of moment, the larger one."""
    pairs = (wrench[:3], np.asarray(loads.force)), (wrench[3:], np.asarray(loads.moment))
    return float(max(np.linalg.norm(found - given) / np.linalg.norm(given) for found, given in pairs))


# Several legs


def _closed_forms() -> Iterator[Figure]:
    for name, known in (("Gough-Stewart platform", legs.gough_stewart()), ("planar 3-RPR", legs.planar())):
        error = _scaled(known.robot.stiffness(known.q), known.stiffness)
        yield below(f"{name}: stiffness beside the sum of k w w^T", error, 1e-10, form=".1e")
        if known.mass is not None:
            error = _largest(known.robot.modes(known.q).frequency, unreduced.frequencies(known.stiffness, known.mass))
            yield below(f"{name}: natural frequencies beside those of its platform", error, 1e-10, form=".1e")


# From all beams to the tool


def _reduction() -> Iterator[Figure]:
    """Frequencies of M_C and K_C, six numbers, beside those of all joints and beams."""
    for name, elastic, q in (("KR270", _kr270(SPINDLE), kr270.JOINTS), ("KR210", _kr210(SPINDLE), KR210_JOINTS)):
        error = _largest(elastic.modes(q).frequency, frame.frequencies(unreduced.full(elastic, q), 6))
        yield below(f"{name}, rigid links: six frequencies beside finite elements", error, 1e-8, form=".1e")
    heavy = Spindle((0.0, 0.0, 0.3), mass=100.0, centre_of_mass=(0.0, 0.0, 0.1), inertia=np.diag([2.0, 2.0, 0.5]))
    yield from _modes("KR270 of tubes, no spindle", _kr270(Spindle(), TUBES), kr270.JOINTS, 5.0, 0.5)
    yield from _modes("KR270 of tubes, spindle of 100 kg", _kr270(heavy, TUBES), kr270.JOINTS, 1.5, 0.5)
    yield from _modes("slender arm, tool of 5 kg", _slender(), np.deg2rad([10.0, 20.0, -50.0, 30.0, 40.0, 20.0]), 2.0, 2.0)


def _slender() -> ElasticRobot:
    """Thin steel tubes of 0.8 to 0.9 m on stiff joints: links that give way more than joints do."""
    beams = {"a": Beam.tube(0.08, 0.07), "b": Beam.tube(0.06, 0.052), "c": Beam.tube(0.048, 0.042)}
    robot = Robot(
        names=tuple("abcdef"),
        kinds=("revolute",) * 6,
        xyz=[(0, 0, 0), (0, 0, 0.8), (0.9, 0, 0), (0.8, 0, 0), (0, 0, 0), (0.1, 0, 0)],
        rpy=np.zeros((6, 3)),
        axis=[(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0)],
        zero=np.zeros(6),
        flange=Placement((0.1, 0.0, 0.0), (0.0, np.pi / 2, 0.0)),
    ).with_rods(0.04, mass=[7.4, 5.0, 2.7, 2.0, 2.0, 2.0])
    tool = Spindle((0.0, 0.0, 0.1), mass=5.0, centre_of_mass=(0.0, 0.0, 0.05), inertia=0.05 * np.eye(3))
    return ElasticRobot(tool.on(robot), np.full(6, 1e-7), beams)


def _modes(name: str, elastic: ElasticRobot, q, limit: float, limit_at_rest: float) -> Iterator[Figure]:
    arm = unreduced.full(elastic, q)
    error = _scaled(elastic.tool_compliance(q), frame.tip_compliance(arm))
    yield below(f"{name}: compliance at the tool beside finite elements", error, 1e-10, form=".1e")
    ours, theirs = np.asarray(elastic.modes(q).frequency), frame.frequencies(arm, 6)
    percent = 100 * (ours / theirs - 1)
    for i in range(3):
        what = f"{name}: frequency {i + 1}, {ours[i]:.2f} Hz, beside {theirs[i]:.2f} Hz of finite elements"
        yield Figure(what, f"{percent[i]:+.2f} %", f"± {limit:.2g} %", bool(abs(percent[i]) <= limit))
    higher = ", ".join(f"{one:+.0f}" for one in percent[3:])
    yield Figure(f"{name}: frequencies 4 to 6 beside finite elements", f"{higher} %", "", None)
    shapes = 100 * np.abs(ours / unreduced.frequencies(*unreduced.at_rest(arm)) - 1)[:3].max()
    what = f"{name}: frequencies 1 to 3 beside those of finite elements in shapes at rest, largest difference"
    yield below(what, shapes, limit_at_rest, unit=" %")


# Derivatives


def _derivatives() -> Iterator[Figure]:
    """By each joint compliance: through mass, modal damping and stiffness at the tool to the trace."""
    case = kr270.slot(0.05, sweeps=8, tolerance=1e-13)
    compliance = jnp.asarray(case.structure.compliance)

    @jax.jit
    def trace(factors):
        one = eqx.tree_at(lambda c: c.structure.compliance, case, compliance * factors)
        return mx.simulate(one, throw=False).displacement.ravel()

    ones = jnp.ones(len(compliance))
    forward = np.asarray(jax.jit(jax.jacfwd(trace))(ones))
    for i, name in enumerate(case.structure.robot.names):
        difference = _richardson(lambda by, i=i: np.asarray(trace(ones.at[i].add(by))), 3e-3)
        error = _largest(forward[:, i], difference)
        yield below(f"KR270, compliance of {name}: displacement trace, forward mode beside differences", error, 1e-6)
    weights = np.random.default_rng(0).normal(size=len(forward))
    backward = np.asarray(jax.jit(jax.grad(lambda factors: trace(factors) @ weights))(ones))
    error = float((np.abs(backward - weights @ forward) / (np.abs(weights) @ np.abs(forward))).max())
    yield below("KR270, compliances: reverse mode beside forward mode", error, 1e-9)


def _richardson(function, step: float) -> np.ndarray:
    """Richardson: central differences at a step and at half of it leave an error of its fourth power."""
    wide, narrow = ((function(h) - function(-h)) / (2 * h) for h in (step, step / 2))
    return (4 * narrow - wide) / 3
