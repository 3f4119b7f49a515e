"""Robots with springs in plain NumPy and in Pinocchio: what tests hold the models of `millax.robot` against."""

import dataclasses
from dataclasses import dataclass

import jax
import numpy as np
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from benchmarks.kr270 import COMPLIANCE, JOINTS
from millax.robot import Beam, ElasticRobot, Loads, Payload, Placement, Robot

POSES = {"of the papers": JOINTS, "another": np.deg2rad([20, -80, 100, 40, -60, 30])}
SECTION = Beam(5e-3, 2e-5, 5e-5, 3e-5, young=210e9, shear=81e9, side=(0.2, 1.0, 0.3))
"""A box of unequal second moments, across no axis of any link."""
ARMS = {"rigid links": {}, "beams": {"joint_2": SECTION, "joint_4": Beam.tube(0.2, 0.17)}}
LOADS = Loads(force=(300.0, -500.0, 800.0), moment=(100.0, -50.0, 60.0), gravity=(0.4, -0.3, -9.81))
"""A wrench of 1 kN, and a floor that is not level."""


def arm(make, beams) -> ElasticRobot:
    """A built-in robot with a payload and a tool. All have limits, so that they share programs."""
    robot = make()
    return ElasticRobot(
        dataclasses.replace(
            robot,
            tool=Placement((0.10, 0.05, 0.30), (0.2, 0.4, 0.1)),
            payload=Payload(40.0, (0.1, 0.05, 0.2), np.diag([1.0, 2.0, 3.0])),
            lower=np.full(6, -10.0),
            upper=np.full(6, 10.0),
        ),
        COMPLIANCE,
        beams,
    )


def any_arm(seed: int, kinds, beams) -> ElasticRobot:
    """Any placements, axes and masses."""
    rng, n = np.random.default_rng(seed), len(kinds)
    root = rng.normal(size=(n, 3, 3))
    mass, centre_of_mass = rng.uniform(10, 100, n), rng.normal(size=(n, 3)) * 0.3
    robot = Robot(
        names=tuple(f"joint_{i + 1}" for i in range(n)),
        kinds=kinds,
        xyz=rng.normal(size=(n, 3)) * 0.5,
        rpy=rng.uniform(-np.pi, np.pi, (n, 3)),
        axis=rng.normal(size=(n, 3)),
        zero=rng.normal(size=n),
        base=Placement(rng.normal(size=3), rng.uniform(-np.pi, np.pi, 3)),
        flange=Placement(rng.normal(size=3) * 0.5, rng.uniform(-np.pi, np.pi, 3)),
        tool=Placement(rng.normal(size=3) * 0.3, rng.uniform(-np.pi, np.pi, 3)),
        mass=mass,
        centre_of_mass=centre_of_mass,
        inertia=root @ root.swapaxes(1, 2),
    )
    return ElasticRobot(robot, rng.uniform(0.1, 2.0, n) * 1e-6, beams)


def worst(found, expected) -> float:
    """The largest difference, over the largest number."""
    return float(np.abs(np.asarray(found) - expected).max() / np.abs(expected).max())


def joint_frequencies(springs, mass) -> np.ndarray:
    """Of the robot's own coordinates [Hz]."""
    return np.sqrt(eigh(springs, mass, eigvals_only=True)) / (2 * np.pi)


SECTIONS, PARTS = (np.polynomial.legendre.leggauss(7)[0] + 1) / 2, np.polynomial.legendre.leggauss(7)[1] / 2
"""Sections of a beam and parts of its mass, by a finer rule than that of the engine."""


@dataclass
class Body:
    """Mass [kg] at a point [m], with inertia about it [kg m²]. It moves with the first `link` coordinates, as a rigid body,
    and by the columns of `own` [-], and of `own_turn`, with some more."""

    mass: float
    point: np.ndarray
    inertia: np.ndarray
    link: int
    own: dict[int, np.ndarray]
    own_turn: dict[int, np.ndarray]


@dataclass
class Standing:
    """A robot with springs as it stands: of its N coordinates whether they turn, axes (N, 3) and origins [m] (N, 3); the
    tool's axes and point; and what weighs."""

    turns: list[bool]
    axes: np.ndarray
    origins: np.ndarray
    rotation: np.ndarray
    tip: np.ndarray
    bodies: list[Body]

    def column(self, i: int, point) -> np.ndarray:
        """Velocity and angular velocity at a point that coordinate i carries."""
        z = self.axes[i]
        return np.concatenate([np.cross(z, point - self.origins[i]), z] if self.turns[i] else [z, 0 * z])

    def jacobian(self) -> np.ndarray:
        return np.array([self.column(i, self.tip) for i in range(len(self.axes))]).T

    def _change(self, i: int, j: int, point) -> np.ndarray:
        """d column(i, point)/dq_j, the point carried by both."""
        z = self.axes[i]
        if j <= i:  # coordinate j carries axis, origin and point
            return np.kron(np.eye(2), cross(self.axes[j])) @ self.column(i, point) if self.turns[j] else np.zeros(6)
        return np.concatenate([np.cross(z, self.column(j, point)[:3]), 0 * z]) if self.turns[i] else np.zeros(6)

    def load(self, loads: Loads) -> np.ndarray:
        """J_G^T G + J_F^T F."""
        force = self.jacobian().T @ np.asarray(loads.wrench)
        for body in self.bodies:
            weight = body.mass * gravity_of(loads)
            for i in range(body.link):
                force[i] += self.column(i, body.point)[:3] @ weight
            for i, way in body.own.items():
                force[i] += way @ weight
        return force

    def load_slope(self, loads: Loads) -> np.ndarray:
        """H: what `load` changes by with the coordinates (C 11-15), term by term."""
        n, wrench = len(self.axes), np.asarray(loads.wrench)
        slope = np.array([[self._change(i, j, self.tip) @ wrench for j in range(n)] for i in range(n)])
        for body in self.bodies:
            weight = body.mass * gravity_of(loads)
            for i in range(body.link):
                for j in range(body.link):
                    slope[i, j] += self._change(i, j, body.point)[:3] @ weight
                for k, way in body.own.items():  # both ways round: second derivatives of one potential
                    both = np.cross(self.axes[i], way) @ weight if self.turns[i] else 0.0
                    slope[i, k] += both
                    slope[k, i] += both
        return slope

    def mass_matrix(self) -> np.ndarray:
        """Of the kinetic energy of all bodies, one by one."""
        mass = np.zeros((len(self.axes),) * 2)
        for body in self.bodies:
            moves = np.zeros((6, len(self.axes)))
            for i in range(body.link):
                moves[:, i] = self.column(i, body.point)
            for i, way in body.own.items():
                moves[:3, i] = way
            for i, way in body.own_turn.items():
                moves[3:, i] = way
            mass += body.mass * moves[:3].T @ moves[:3] + moves[3:].T @ body.inertia @ moves[3:]
        return mass


def gravity_of(loads: Loads) -> np.ndarray:
    return np.zeros(3) if loads.gravity is None else np.asarray(loads.gravity)


def cross(v) -> np.ndarray:
    """[v x]."""
    return np.cross(v, np.eye(3)).T


def rotation(rpy) -> np.ndarray:
    return Rotation.from_euler("xyz", np.asarray(rpy)).as_matrix()


def standing(robot: ElasticRobot, x) -> Standing:
    """The robot at its N coordinates, part by part. Of what it does not give of masses nothing weighs."""
    chain = jax.tree.map(np.asarray, robot.robot)
    coordinates = iter(np.asarray(x))
    r, p = rotation(chain.base.rpy), np.array(chain.base.xyz)
    turns, axes, origins, bodies = [], [], [], []

    def move(turning, direction, by):
        nonlocal r, p
        turns.append(turning)
        axes.append(r @ direction)
        origins.append(p)
        if turning:
            r = r @ Rotation.from_rotvec(direction * by).as_matrix()
        else:
            p = p + r @ direction * by

    def link(i, line):
        if chain.mass is None:
            return
        mass = float(chain.mass[i])
        if (beam := robot.beams.get(chain.names[i])) is None:
            inertia = np.zeros((3, 3)) if chain.inertia is None else np.asarray(chain.inertia[i])
            bodies.append(Body(mass, p + r @ chain.centre_of_mass[i], r @ inertia @ r.T, len(axes), {}, {}))
            return
        local, first = r @ sides(beam, line), len(axes)
        iy, iz = float(beam.second_moment_y), float(beam.second_moment_z)
        section = local @ np.diag([iy + iz, iy, iz]) @ local.T / float(beam.area)
        bend = np.asarray(x)[first : first + 3]
        for s, part in zip(SECTIONS, PARTS, strict=True):
            f, g, h = s, s**2 * (3 - s) / 2, 2 * s * (1 - s / 2)  # C 21
            own = {first + k: local[:, k] * share for k, share in enumerate((f, g, g))}
            own_turn = {first + 3 + k: local[:, k] * share for k, share in enumerate((f, h, h))}
            point = p + s * r @ line + local @ (bend * [f, g, g])
            bodies.append(Body(mass * part, point, mass * part * section, first, own, own_turn))

    begun = False
    for i, name in enumerate(chain.names):
        if not begun:  # else the beam before has led there
            p = p + r @ chain.xyz[i]
        r = r @ rotation(chain.rpy[i])
        direction = np.asarray(chain.axis[i]) / np.linalg.norm(chain.axis[i])
        move(chain.kinds[i] == "revolute", direction, next(coordinates) + float(chain.zero[i]))
        line = np.asarray(chain.xyz[i + 1] if i + 1 < chain.joints else chain.flange.xyz)
        link(i, line)
        if begun := name in robot.beams:
            p = p + r @ line
            local = sides(robot.beams[name], line)
            for k in range(6):
                move(k >= 3, local[:, k % 3], next(coordinates))
    if not begun:
        p = p + r @ chain.flange.xyz
    r = r @ rotation(chain.flange.rpy)
    if (load := chain.payload) is not None:
        inertia = r @ load.inertia @ r.T
        bodies.append(Body(float(load.mass), p + r @ load.centre_of_mass, inertia, len(axes), {}, {}))
    p = p + r @ chain.tool.xyz
    return Standing(turns, np.array(axes), np.array(origins), r @ rotation(chain.tool.rpy), p, bodies)


def sides(beam, line) -> np.ndarray:
    """Axes of a beam as columns. Of equal second moments and without a side, any across it: here that of the engine."""
    x = line / np.linalg.norm(line)
    side = np.eye(3)[np.argmin(abs(x))] if beam.side is None else np.asarray(beam.side)
    z = np.cross(x, side) / np.linalg.norm(np.cross(x, side))
    return np.array([x, np.cross(z, x), z]).T
