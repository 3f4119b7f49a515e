"""Robots as Pinocchio sees them: built joint by joint from ours, or read from a URDF file by its own reader."""

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from millax.robot import Robot


class Model(NamedTuple):
    """A model of Pinocchio, and which of its frames is that of the tool."""

    model: Any
    tool: int


class Found(NamedTuple):
    """At many q: the pose of the tool, (p, 4, 4), its Jacobian, (p, 6, n), G, (p, n), and M, (p, n, n)."""

    pose: np.ndarray
    jacobian: np.ndarray
    gravity: np.ndarray
    mass: np.ndarray


def built(robot: Robot) -> Model:
    """The same chain with the same bodies. Where the inertia of links is not known there is none."""

    def place(xyz, rpy):
        return pin.SE3(pin.rpy.rpyToMatrix(np.array(rpy)), np.array(xyz))

    inertia = np.zeros((robot.joints, 3, 3)) if robot.inertia is None else np.asarray(robot.inertia)
    model, joint = pin.Model(), 0
    before, here = place(robot.base.xyz, robot.base.rpy), pin.SE3.Identity()
    for i, kind in enumerate(robot.kinds):
        axis = np.asarray(robot.axis[i]) / np.linalg.norm(robot.axis[i])
        motion = {"revolute": pin.JointModelRevoluteUnaligned, "prismatic": pin.JointModelPrismaticUnaligned}[kind](axis)
        joint = model.addJoint(joint, motion, before * place(robot.xyz[i], robot.rpy[i]), robot.names[i])
        model.appendBodyToJoint(
            joint, pin.Inertia(float(robot.mass[i]), np.array(robot.centre_of_mass[i]), inertia[i]), here
        )
        before = here
    flange = place(robot.flange.xyz, robot.flange.rpy)
    if (load := robot.payload) is not None:
        body = pin.Inertia(float(load.mass), np.array(load.centre_of_mass), np.array(load.inertia))
        model.appendBodyToJoint(joint, body, flange)
    tool = flange * place(robot.tool.xyz, robot.tool.rpy)
    return Model(model, model.addFrame(pin.Frame("tool", joint, 0, tool, pin.FrameType.OP_FRAME)))


def from_urdf(text: str, tip: str) -> Model:
    """What its own reader makes of a URDF file; the tool stands at the link `tip`."""
    model = pin.buildModelFromXML(text)
    return Model(model, model.getFrameId(tip))


def evaluated(of: Model, q, zero, gravity) -> Found:
    """At q, shape (p, n), counted from the angles `zero`, with g = `gravity` [m/s²]."""
    model, tool = of
    model.gravity.linear = np.asarray(gravity)
    data, rest, found = model.createData(), pin.neutral(model), []
    for one in np.asarray(q) + np.asarray(zero):
        there = pin.integrate(model, rest, one)  # of a joint without limits it keeps cosine and sine
        pin.framesForwardKinematics(model, data, there)
        jacobian = pin.computeFrameJacobian(model, data, there, tool, pin.LOCAL_WORLD_ALIGNED)
        upper = np.triu(pin.crba(model, data, there))  # the rest of it is not always filled in
        found.append(
            Found(
                data.oMf[tool].homogeneous,
                jacobian.copy(),
                pin.computeGeneralizedGravity(model, data, there).copy(),
                upper + np.triu(upper, 1).T,
            )
        )
    return Found(*map(np.array, zip(*found, strict=True)))
