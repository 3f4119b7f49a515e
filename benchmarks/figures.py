"""A measured figure beside its target, and the tables of them."""

from collections.abc import Iterable
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class Figure:
    """One line of a validation table. `met` is None where there is no target: the figure is there to be read."""

    what: str
    measured: str
    target: str
    met: bool | None

    @property
    def verdict(self) -> str:
        return {True: "ok", False: "MISSED", None: ""}[self.met]


def below(what: str, value: float, limit: float, *, form: str = ".2g", unit: str = "") -> Figure:
    """A figure that must not exceed its limit."""
    return Figure(what, f"{value:{form}}{unit}", f"≤ {limit:{form}}{unit}", bool(value <= limit))


def near(what: str, value: float, target: float, within: float, *, form: str = ".4g", unit: str = "") -> Figure:
    """A figure that must lie within a distance of its target."""
    return Figure(
        what, f"{value:{form}}{unit}", f"{target:{form}} ± {within:.2g}{unit}", bool(abs(value - target) <= within)
    )


def show(console: Console, subject: str, figures: Iterable[Figure]) -> list[Figure]:
    """Print the figures of one subject; returns them."""
    table = Table(title=subject, title_justify="left", title_style="bold", show_edge=False, pad_edge=False)
    for column, justify in (("figure", "left"), ("measured", "right"), ("target", "right"), ("", "left")):
        table.add_column(column, justify=justify)
    figures = list(figures)
    for figure in figures:
        style = "bold red" if figure.met is False else None
        table.add_row(figure.what, figure.measured, figure.target, figure.verdict, style=style)
    console.print(table)
    console.print()
    return figures


def markdown(subject: str, figures: Iterable[Figure]) -> str:
    """The same table for a document."""
    rows = [f"| {f.what} | {f.measured} | {f.target} | {f.verdict} |" for f in figures]
    return "\n".join([f"## {subject}", "", "| figure | measured | target | |", "|---|--:|--:|---|", *rows, ""])
