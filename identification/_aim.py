"""What a design makes small, and what will be known."""

from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from millax._units import express

from ._information import Knowledge
from ._parameters import FreeParameters
from ._uncertainty import UNKNOWN

CRITERIA = {
    "D": "geometric mean of the standard errors along the axes of the ellipsoid of confidence, relative",
    "A": "root mean square of the standard errors over the values",
}
"""What is made small, apart from the standard error of one parameter."""


@dataclass(frozen=True)
class Forecast:
    """What will be known after a cut; or today.

    - `cut`: the varied numbers of the cut and their units, empty for today.
    - `std`: standard error of each parameter, in the unit of the parameter; None where it is not known then.
    - `left`: how many combinations of the parameters are left open; for the criterion "A" parameters; for that of one
      parameter whether it is.
    - `uncertainty`: what the criterion makes small, of all that is not left open; infinite where that is nothing.
    """

    cut: Mapping[str, tuple[float, str]]
    std: Mapping[str, float | None]
    left: int
    uncertainty: float

    @property
    def words(self) -> str:
        """The cut, for a person: "cut.spindle_speed = 8000 rpm, cut.depth = 2 mm"."""
        return ", ".join(f"{name} = {value:.6g} {unit}".strip() for name, (value, unit) in self.cut.items())

    def known_since(self, earlier: "Forecast") -> list[str]:
        """The parameters that are known now and were not."""
        return [name for name, std in self.std.items() if std is not None and earlier.std[name] is None]

    def shrinks(self, earlier: "Forecast") -> float:
        """By which factor the uncertainty is smaller than it was; infinite where less is left open."""
        return earlier.uncertainty / self.uncertainty if earlier.left <= self.left else np.inf


class Aim:
    """What the criterion makes small: the parameters that all cuts share, at the coordinates `of`."""

    def __init__(self, numbers: FreeParameters, of: np.ndarray, criterion: str):
        if not len(of):
            raise ValueError(
                "every parameter has a value of its own in each trace (each = true): a new cut tells nothing of the others"
            )
        y = jnp.zeros(len(numbers))
        values, slopes = np.asarray(numbers.values(y))[of], np.asarray(numbers.slopes(y))[of]
        self.names = tuple(numbers.names[i] for i in of)
        self.units = tuple(numbers.units[i] for i in of)
        self.values = tuple(express(value, unit) for value, unit in zip(values, self.units, strict=True))
        self.shown = np.array([express(slope, unit) for slope, unit in zip(slopes, self.units, strict=True)])
        self.relative = np.where(values != 0, slopes / np.where(values != 0, np.abs(values), 1.0), 1.0)
        if criterion not in CRITERIA and criterion not in self.names:
            raise ValueError(
                f'criterion: "{criterion}" given; it must be D, A or the name of a parameter: {", ".join(self.names)}'
            )
        self.criterion = criterion

    def judged(self, known: Knowledge) -> tuple[np.ndarray, np.ndarray]:
        """What is left open, and what is made small."""
        if self.criterion == "D":
            return known.left, known.radius
        if self.criterion in self.names:
            std = known.std[..., self.names.index(self.criterion)]
            return np.isinf(std).astype(int), std * self.shown[self.names.index(self.criterion)]
        found = np.isfinite(known.std)
        squares = np.where(found, known.std * self.relative, 0.0) ** 2
        number = found.sum(axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = np.where(number > 0, np.sqrt(squares.sum(axis=-1) / number), np.inf)
        return (~found).sum(axis=-1), mean

    def order(self, known: Knowledge) -> np.ndarray:
        """Candidates, the best first; of equal ones the first."""
        left, uncertainty = self.judged(known)
        return np.lexsort((uncertainty, left))

    def forecast(self, known: Knowledge, cut: Mapping[str, tuple[float, str]]) -> Forecast:
        """In words and units; `known` is no batch."""
        left, uncertainty = self.judged(known)
        std = zip(self.names, known.std, self.shown, strict=True)
        return Forecast(
            cut=cut,
            std={name: float(s * scale) if s <= UNKNOWN else None for name, s, scale in std},
            left=int(left),
            uncertainty=float(uncertainty),
        )
