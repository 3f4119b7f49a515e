"""From the tables of a case file to the robot that holds the tool."""

from pathlib import Path
from typing import Any

from ._casekeys import MODELS
from ._units import in_mm, show
from .robot import Arm, Beam, Loads, Robot, Spindle, load_urdf


def arm_of(folder: Path, given: dict[str, Any], tool: dict[str, Any], links: dict[str, Any], loads: dict[str, Any]) -> Arm:
    """The robot of the tables [robot], [robot.tool], [robot.links] and [robot.loads], in SI; files count from `folder`.

    Raises `ValueError` for what does not go together, and a pose that the robot cannot take.
    """
    given = dict(given)
    model, urdf, dh = (given.pop(key, None) for key in ("model", "urdf", "dh"))
    mass, thickness = (given.pop(key, None) for key in ("link_mass", "link_thickness"))
    if model is not None:
        robot = MODELS[model]()
    elif urdf is not None:
        try:
            robot = load_urdf(folder / urdf)
        except OSError as error:
            raise ValueError(f"robot.urdf: {show(urdf)} cannot be read: {error.strerror}") from None
    else:
        robot = Robot.from_dh(**dh)
    for key in ("joints", "compliance"):
        if len(given[key]) != robot.joints:
            raise ValueError(f"robot.{key}: {len(given[key])} numbers given; the robot has {robot.joints} joints")
    if (mass is None) != (thickness is None):
        raise ValueError("robot: give link_mass and link_thickness together, for links as rods, or neither")
    if mass is not None:
        if len(mass) != robot.joints:
            raise ValueError(f"robot.link_mass: {len(mass)} numbers given; the robot has {robot.joints} links")
        robot = robot.with_rods(thickness, mass)
    unknown = {"mass": "masses", "centre_of_mass": "centres of mass", "inertia": "inertia"}
    if missing := [words for name, words in unknown.items() if getattr(robot, name) is None]:
        source = "a table of lengths and angles" if dh is not None else show(model if urdf is None else urdf)
        raise ValueError(
            f"robot: {source} gives no {', no '.join(missing)} of links; give robot.link_mass and robot.link_thickness for "
            "links as rods"
        )
    arm = Arm(
        robot,
        **given,
        tool=Spindle(**tool) if tool else None,
        loads=Loads(**loads) if loads else None,
        beams=_tubes(robot, **links) if links else {},
    )
    arm.check()
    return arm


def _tubes(robot: Robot, joints, outer, inner=None, **material) -> dict[str, Beam]:
    """Links as tubes, by the names of the joints that move them; `joints` counts from 1."""
    inner = [0.0] * len(joints) if inner is None else inner
    for key, column in (("outer", outer), ("inner", inner)):
        if len(column) != len(joints):
            raise ValueError(f"robot.links.{key}: {len(column)} numbers given; robot.links.joints names {len(joints)} links")
    for number, wide, hollow in zip(joints, outer, inner, strict=True):
        if number not in range(1, robot.joints + 1) or joints.count(number) > 1:
            raise ValueError(
                f"robot.links.joints: {number:g} given; name each link once, by the number of its joint, 1 to {robot.joints}"
            )
        if not hollow < wide:
            raise ValueError(
                f"robot.links.inner: {in_mm(hollow)} given; it must be less than the outer diameter, {in_mm(wide)}"
            )
    return {
        robot.names[int(number) - 1]: Beam.tube(wide, hollow, **material)
        for number, wide, hollow in zip(joints, outer, inner, strict=True)
    }
