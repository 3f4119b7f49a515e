"""An elastic robot in one pose as a finite-element arm of `frame`: reduced nowhere, or to the tool by its shapes at rest."""

import numpy as np
from scipy.linalg import eigh, solve

from millax.robot import ElasticRobot

from . import frame


def full(elastic: ElasticRobot, q, elements: int = 8) -> frame.Arm:
    """The same links, springs and load, each beam of `elements`. Its tool centre point is that of the robot."""
    robot = elastic.robot
    rotation, origin = map(np.asarray, robot.frames(q))
    pose = np.asarray(robot.pose(q))
    flange = rotation[-1] @ np.asarray(robot.flange.rotation)
    points = np.vstack([origin, origin[-1] + rotation[-1] @ np.asarray(robot.flange.xyz)])
    direction = np.asarray(robot.axis) / np.linalg.norm(robot.axis, axis=1, keepdims=True)
    carried = []
    if (load := robot.payload) is not None:
        carried.append((robot.joints, _body(load.mass, load.centre_of_mass, load.inertia, points[-1], flange)))
    return frame.Arm(
        points=points,
        axes=np.einsum("nij,nj->ni", rotation, direction),
        compliance=np.asarray(elastic.compliance),
        links=[_link(elastic, i, origin[i], rotation[i]) for i in range(robot.joints)],
        carried=carried,
        tip=pose[:3, 3],
        elements=elements,
    )


def _link(elastic: ElasticRobot, i: int, origin, rotation) -> frame.Beam | frame.Rigid:
    robot = elastic.robot
    beam = elastic.beams.get(robot.names[i])
    if beam is None:
        return _body(robot.mass[i], robot.centre_of_mass[i], robot.inertia[i], origin, rotation)
    return frame.Beam(
        young=float(beam.young),
        shear=float(beam.shear),
        area=float(beam.area),
        second_moment_y=float(beam.second_moment_y),
        second_moment_z=float(beam.second_moment_z),
        torsion=float(beam.torsion),
        side=rotation @ np.asarray(beam.axes(robot.ends[i]))[:, 1],
        mass=float(robot.mass[i]),
    )


def _body(mass, centre, inertia, origin, rotation) -> frame.Rigid:
    return frame.Rigid(float(mass), origin + rotation @ np.asarray(centre), rotation @ np.asarray(inertia) @ rotation.T)


def at_rest(arm: frame.Arm) -> tuple[np.ndarray, np.ndarray]:
    """K and M, (6, 6), of the arm that takes, for each displacement of the tool, the shape that it has at rest under loads
    on the tool alone: Rayleigh and Ritz's approximation with exact shapes."""
    stiffness, mass, tip = frame.matrices(arm)
    shapes = solve(stiffness, tip.T, assume_a="pos")
    held = np.linalg.inv(tip @ shapes)
    shapes = shapes @ held
    return held, shapes.T @ mass @ shapes


def frequencies(stiffness, mass) -> np.ndarray:
    """Of K and M, ascending [Hz]. Coordinates without inertia have none: infinity."""
    # M v = K v/w², not K v = w² M v, for their sake.
    inverse = eigh((mass + mass.T) / 2, (stiffness + stiffness.T) / 2, eigvals_only=True)[::-1]
    with np.errstate(divide="ignore"):
        return 1 / (2 * np.pi * np.sqrt(np.maximum(inverse, 0)))
