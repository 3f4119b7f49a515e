"""The case file with what a fit found in it, ready to simulate and to be fitted again."""

from typing import Any

import tomlkit

from millax import Case
from millax._names import value_of

from ._fitfile import FitProblem, measured_in
from ._parameters import Parameter, Tie
from ._result import FitResult


def fitted_text(problem: FitProblem, result: FitResult) -> str:
    """The text of the case file with the estimates: shared ones in the tables of the case, those of single traces in the
    `case` of their [[trace]]; and with the blocks and sweeps that the fit needed."""
    own = _own(problem)
    shared = [p.name for p in problem.parameters if p.name not in own]
    document = tomlkit.parse(problem.file.with_values({name: value_of(result.case, name) for name in shared}))
    settings = result.case.settings
    if settings.sweeps != problem.cases[0].settings.sweeps:
        document["simulation"].update({"blocks": settings.blocks, "sweeps": settings.sweeps})
    for (_, table), case in zip(measured_in(document), result.cases, strict=True):
        change = table["case"].unwrap() if "case" in table else {}
        if own:
            _put_own(problem, change, case, own)
        if table.pop("align", False) and case.clock is not None:
            # The clock that was found, fitted afterwards or not.
            clock = {"start": f"{float(case.clock.start):.12g} s", "speed_error": float(case.clock.speed_error)}
            change["clock"] = change.get("clock", {}) | clock
        if change:
            table["case"] = tomlkit.item(change, _parent=tomlkit.inline_table())
    return tomlkit.dumps(document)


def _own(problem: FitProblem) -> list[str]:
    """Names of the numbers that single traces have of their own, and of what is tied to them."""
    each = {p.name for p in problem.parameters if isinstance(p, Parameter) and p.each}
    return [p.name for p in problem.parameters if p.name in each or (isinstance(p, Tie) and p.to in each)]


def _put_own(problem: FitProblem, change: dict[str, Any], case: Case, own: list[str]) -> None:
    """Write the numbers of a trace's own into what its case changes, lists as a whole, in the units of the file."""
    file = problem.file.changed(change, problem.file.source)
    text = file.with_values({name: value_of(case, name) for name in own})
    written = tomlkit.parse(text).unwrap()
    for name in own:
        section, key = file.leaf(name).field
        place, found = change, written
        for step in section.split("."):
            place, found = place.setdefault(step, {}), found[step]
        place[key] = found[key]
