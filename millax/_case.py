"""A case: everything a simulation needs, as one pytree."""

import dataclasses

import equinox as eqx

from ._clock import Clock
from ._cut import Cut
from ._forces import ForceLaw
from ._sensor import Sensor
from ._settings import Settings
from ._stock import Stock
from ._structure import Structure
from ._tool import EndMill
from .robot import Arm, at_tool


class Case(eqx.Module):
    """Tool, force law, cut, stock, structure and settings; and where a trace of the cut is to be compared with a
    simulation, what measured it: the sensor of its forces and its clock, None where they are those of the simulation.

    Every physical number is a leaf, under the name it has in a case file: `case.force.k0`, `case.cut.depth`,
    `case.structure.stiffness`, and where a robot holds the tool `case.robot.compliance`. Change one with
    `equinox.tree_at`.
    """

    tool: EndMill
    force: ForceLaw
    cut: Cut
    stock: Stock
    structure: Structure | Arm
    settings: Settings
    sensor: Sensor | None = None
    clock: Clock | None = None

    @property
    def robot(self) -> Arm | None:
        """The robot that holds the tool, if one does."""
        return self.structure if isinstance(self.structure, Arm) else None

    @property
    def equal_teeth(self) -> bool:
        """Whether all teeth are alike, so that every tooth period is like the one before."""
        return self.tool.equal_teeth and self.force.equal_teeth

    @property
    def at_tool(self) -> Structure:
        """The mass-spring-damper that the tool feels: the structure, or what follows from the robot."""
        return at_tool(self.structure)

    def with_settings(self, **changes) -> "Case":
        """The same case with other settings, by their names."""
        return dataclasses.replace(self, settings=dataclasses.replace(self.settings, **changes))
