"""A measured figure beside its target, and the tables of them."""

import argparse
import platform
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
from rich.console import Console
from rich.markup import escape
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
        table.add_row(escape(figure.what), figure.measured, figure.target, figure.verdict, style=style)
    console.print(table)
    console.print()
    return figures


def markdown(subject: str, figures: Iterable[Figure]) -> str:
    """The same table for a document."""
    rows = [f"| {f.what} | {f.measured} | {f.target} | {f.verdict} |" for f in figures]
    return "\n".join([f"## {subject}", "", "| figure | measured | target | |", "|---|--:|--:|---|", *rows, ""])


def command_line(description: str | None, subjects: Mapping[str, str], written: str) -> argparse.ArgumentParser:
    """Takes subjects and a file to write to; `written` says what else is written."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("subjects", nargs="*", metavar="SUBJECT", help=f"one of {', '.join(subjects)} (default: all)")
    parser.add_argument("--write", type=Path, metavar="FILE", help=written)
    return parser


def chosen(parser: argparse.ArgumentParser, options: argparse.Namespace, subjects: Mapping[str, str]) -> dict[str, str]:
    """The subjects asked for, with their titles; ends the program where one is unknown."""
    unknown = set(options.subjects) - set(subjects)
    if unknown:
        parser.error(f"unknown subject {', '.join(sorted(unknown))}; choose from {', '.join(subjects)}")
    return {subject: subjects[subject] for subject in options.subjects or subjects}


def report(subjects: Mapping[str, str], figures_of: Callable[[str], Iterable[Figure]], machine: str) -> tuple[bool, str]:
    """Measure subjects, print their tables and what was missed; whether all targets are met, and the same as Markdown.

    Ctrl-C ends it with the subjects that are done; not all targets are met then.
    """
    console, begin = Console(width=130), time.perf_counter()
    pages, missed, count, stopped = [], [], 0, ""
    for subject, title in subjects.items():
        try:
            with console.status(title):
                figures = show(console, title, figures_of(subject))
        except KeyboardInterrupt:
            stopped = f'Stopped in "{title}". '
            break
        pages.append(markdown(title, figures))
        missed += [figure for figure in figures if figure.met is False]
        count += sum(figure.met is not None for figure in figures)
    made = stopped + (
        f"{count - len(missed)} of {count} targets met in {time.perf_counter() - begin:.0f} s; {machine}, "
        f"Python {platform.python_version()}, JAX {jax.__version__}, NumPy {np.__version__}."
    )
    console.print(made)
    for figure in missed:
        console.print(f"missed: {figure.what}: {figure.measured}, target {figure.target}", style="bold red")
    return not missed and not stopped, "\n".join([made, "", *pages]).rstrip() + "\n"
