"""A case: everything a simulation needs, as one pytree."""

import dataclasses

import equinox as eqx

from ._cut import Cut
from ._forces import ForceLaw
from ._settings import Settings
from ._stock import Stock
from ._structure import Structure
from ._tool import EndMill


class Case(eqx.Module):
    """Tool, force law, cut, stock, structure and settings.

    Every physical number is a leaf, under the name it has in a case file: `case.force.k0`, `case.cut.depth`,
    `case.structure.stiffness`. Change one with `equinox.tree_at`.
    """

    tool: EndMill
    force: ForceLaw
    cut: Cut
    stock: Stock
    structure: Structure
    settings: Settings

    def with_settings(self, **changes) -> "Case":
        """The same case with other settings, by their names."""
        return dataclasses.replace(self, settings=dataclasses.replace(self.settings, **changes))
