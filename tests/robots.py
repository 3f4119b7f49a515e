"""URDF files that tests load, and what they are written with."""

from pathlib import Path

import numpy as np

from millax.robot import Robot, models

LIMIT = '<limit lower="-2" upper="1.5" effort="1" velocity="1"/>'


def link(name, mass=None, xyz="0.02 -0.01 0.05", rpy="0.2 -0.3 0.4", moments=(0.2, 0.3, 0.4)):
    if mass is None:
        return f'<link name="{name}"/>'
    inertia = "".join(f' {key}="{value}"' for key, value in zip(("ixx", "iyy", "izz"), moments, strict=True))
    return (
        f'<link name="{name}"><inertial><origin xyz="{xyz}" rpy="{rpy}"/><mass value="{mass}"/>'
        f'<inertia{inertia} ixy="0.01" ixz="-0.02" iyz="0.015"/></inertial></link>'
    )


def joint(name, kind, parent, child, xyz="0.3 -0.1 0.4", rpy="0 0 0", axis="0 0 1", more=LIMIT):
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{axis}"/>{more}</joint>'
    )


def robot(*parts):
    return f'<?xml version="1.0"?>\n<robot name="made-up">{"".join(parts)}</robot>'


FIXED = {"axis": "0 0 0", "more": ""}
FIXED_LINKS = Path(__file__).parents[1] / "benchmarks" / "fixed_links.urdf"
CHAIN = FIXED_LINKS.read_text(encoding="utf-8")
"""Links fixed at the foot, between joints and at the end; a right angle of pitch; a continuous and a sliding joint."""


SLIDING = robot(
    link("floor"),
    joint("rail", "prismatic", "floor", "carriage", "0.2 -1.5 0.6", "0.4 -0.2 1.1", axis="2 0 -1"),
    link("carriage"),
    joint("swing", "revolute", "carriage", "arm", "0.1 0.3 0.5", "-1.2 0.5 0.3", axis="0.2 1 0.1"),
    link("arm"),
    joint("ram", "prismatic", "arm", "quill", "0.4 0.1 -0.2", "0.7 1.3 -2.4"),
    link("quill"),
    joint("tip", "fixed", "quill", "tool", "0.05 -0.1 0.2", "2 -0.4 0.9", **FIXED),
    link("tool"),
)
"""A rail and a ram that slide, a swing between them that turns."""


def urdf(made: Robot) -> str:
    """The same robot as a URDF file, to the last digit, from the link "base" to the link "tool".

    URDF has no zeros of joints. Each joint has a seat of its own, on which it stands turned by its zero: about z, the axis
    of all joints that have one.
    """

    def at(xyz, rpy) -> dict[str, str]:
        return {"xyz": words(xyz), "rpy": words(rpy)}

    def words(numbers) -> str:
        return " ".join(repr(float(number)) for number in np.asarray(numbers))

    def fixed(parent, child, xyz, rpy) -> list[str]:
        return [link(child), joint(child, "fixed", parent, child, **at(xyz, rpy), **FIXED)]

    parts, before = [link("base"), *fixed("base", "foot", made.base.xyz, made.base.rpy)], "foot"
    for i, (name, kind) in enumerate(zip(made.names, made.kinds, strict=True)):
        seat, after, zero = f"seat_{i}", f"link_{i}", float(made.zero[i])
        assert zero == 0 or np.array_equal(made.axis[i], (0, 0, 1))
        parts += fixed(before, seat, made.xyz[i], made.rpy[i])
        parts += [link(after), joint(name, kind, seat, after, **at((0, 0, 0), (0, 0, zero)), axis=words(made.axis[i]))]
        before = after
    return robot(*parts, *fixed(before, "tool", made.flange.xyz, made.flange.rpy))


BUILT_IN = {
    "kuka_kr210_r2700_2": models.kuka_kr210_r2700_2,
    "abb_irb6660": models.abb_irb6660,
    "kuka_kr270": models.kuka_kr270,
}


def files() -> dict[str, str]:
    """The URDF files of the table of pytorch-kinematics, all of them from their first link to the link "tool"."""
    return {name: urdf(make()) for name, make in BUILT_IN.items()} | {"fixed_links": CHAIN, "sliding": SLIDING}
