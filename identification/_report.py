"""report.html: what a person reads about a fit. One file, which needs nothing else."""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from millax._names import value_of

from . import _curves as curves
from . import _figures as figures
from ._loadtest import LoadTest
from ._posterior_figure import posterior
from ._posterior_result import Posterior
from ._result import STATUS, FitResult, TraceFit
from ._words import interval, plain, unit_words, with_error


def write_report(path: Path, result: FitResult, *, title: str, truth: Mapping[str, float] | None = None) -> None:
    """Write the report of a fit.

    `title` names the question; `truth` holds the true SI values by parameter name, where they are known because the
    measurements are synthetic.
    """
    template = resources.files("identification").joinpath("report.html.jinja").read_text(encoding="utf-8")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    html = environment.from_string(template).render(_content(result, title, dict(truth or {})))
    path.write_text(html, encoding="utf-8")


def _content(result: FitResult, title: str, truth: dict[str, float]) -> dict[str, Any]:
    periods = [float(case.cut.tooth_period(case.tool)) for case in result.cases]
    rows = [_row(result, i, truth) for i in range(len(result.parameters))]
    return {
        "title": title,
        "result": result,
        "verdict": STATUS[result.status],
        "summary": _summary(result, rows),
        "rows": rows,
        "has_truth": any(row["truth"] is not None for row in rows),
        "traces": [
            {"name": fit.trace.name, "channels": _channels(fit)} | _pictures(fit, tooth_period)
            for fit, tooth_period in zip(result.traces, periods, strict=False)  # a fit that never ran has no traces
        ],
        "correlation": figures.correlation(result) if np.isfinite(result.correlation).sum() > 1 else None,
        "profiles": curves.profiles(result.profiles, result.parameters)
        if any(len(p.values) for p in result.profiles)
        else None,
        "open_profiles": [p.reason for p in result.profiles if p.reason],
        "waterfall": None if result.waterfall is None else curves.waterfall(result.waterfall),
        "posterior": None if result.posterior is None else posterior(result.posterior, result),
        "posterior_words": None if result.posterior is None else _posterior_words(result.posterior),
        "noise_words": _noise_words(result),
    }


def _pictures(fit: TraceFit, tooth_period: float) -> dict[str, str]:
    """The pictures of a trace or load test, and what is said below them."""
    if isinstance(fit.trace, LoadTest):
        return {
            "fitted": figures.measured_against_fitted(fit),
            "fitted_caption": "Each measurement above what the model with the estimates says, with ± 1 σ. Dashed: both are "
            f"equal. {fit.trace.samples} measurements.",
            "residuals": figures.residuals_by_number(fit),
            "residuals_caption": "Measured less fitted. A model that leaves only noise has points without order, 19 of "
            "20 of them between the dashed lines.",
        }
    return {
        "fitted": figures.measured_and_fitted(fit, tooth_period),
        "fitted_caption": "Grey: measured. Colour: the model with the estimates; at the right with the band in which the "
        f"model lies with 95 %, by what is not known of the parameters. {fit.trace.samples} samples.",
        "residuals": figures.residuals(fit, tooth_period),
        "residuals_caption": "Measured less fitted. A model that leaves only noise has a band of even width, a flat "
        "spectrum on the dashed line, and the normal distribution. Lines in the spectrum are what the model misses.",
    }


def _row(result: FitResult, i: int, truth: dict[str, float]) -> dict[str, Any]:
    """One parameter for the table. Deviations and the ends of the interval are in standard errors from the estimate."""
    e = result.parameters[i]
    true = None
    if e.name in truth and (si := value_of(result.case, e.name)) != 0:
        # In the estimate's unit; a unit has no offset, so a ratio is enough.
        true = truth[e.name] * (e.value / si)
    deviation = (e.value - true) / e.std if true is not None and e.std else None
    return {
        "name": e.name,
        "unit": unit_words(e.unit),
        "estimate": with_error(e.value, e.std),
        "relative": f"{100 * e.std / abs(e.value):.2g} %" if e.std and e.value else None,
        "ci95": interval(e.ci95) if e.ci95 else None,
        "profile": next((interval(p.ci95) for p in result.profiles if p.name == e.name and p.ci95), None),
        "ends": [(x - e.value) / e.std for x in e.ci95] if e.ci95 and e.std else None,
        "guess": plain(e.guess, 3),
        "truth": None if true is None else plain(true),
        "deviation": deviation,
        "error": None if not true else f"{100 * (e.value / true - 1):+.2f} %".replace("-", "−"),
        "reason": e.reason,
    }


def _posterior_words(found: Posterior) -> str:
    """What the draws say, and whether they can be trusted."""
    chains, draws, _ = found.draws.shape
    agrees = "They say the same as the estimates" if found.agrees else "They differ from estimates and standard errors"
    words = (
        f"{draws} draws in each of {chains} chains by the No-U-Turn sampler; largest R-hat {found.rhat.max():.3f}, fewest "
        f"effective draws {found.ess.min():.0f}. {agrees} (means within 0.2 standard errors, standard deviations within "
        "10 %, ends of the intervals within 0.3 standard errors)."
    )
    return f"{words} {found.reason}" if found.reason else words


def _noise_words(result: FitResult) -> str:
    """The kind of noise that the fit rests on."""
    kind = result.noise_model
    words = "normal" if kind.distribution == "normal" else f"Student's t with {kind.degrees:g} degrees of freedom"
    return words + (f", autoregressive of order {kind.order}" if kind.order else ", white")


def _summary(result: FitResult, rows: list[dict[str, Any]]) -> list[str]:
    """Sentences under the verdict: the message, how well things are known, and whether truth and estimate agree."""
    sentences = [result.message]
    relative = {e.name: e.std / abs(e.value) for e in result.parameters if e.std and e.value}
    if relative:
        best, worst = min(relative, key=relative.__getitem__), max(relative, key=relative.__getitem__)
        sentences.append(
            f"The best known is {best} with a standard error of {100 * relative[best]:.2g} %, the least known {worst} with "
            f"{100 * relative[worst]:.2g} %."
        )
    inside = [row["ends"][0] <= -row["deviation"] <= row["ends"][1] for row in rows if row["deviation"] is not None]
    if inside:
        sentences.append(f"The truth lies in {sum(inside)} of {len(inside)} 95 % intervals.")
    for fit in result.traces:
        r2 = [x for x in fit.r2.values() if x is not None]
        if r2:
            sentences.append(
                f"The model explains {100 * min(r2):.2f} % or more of the variance of each channel of {fit.trace.name}."
            )
    return sentences


def _channels(fit: TraceFit) -> list[dict[str, Any]]:
    """Goodness of fit per channel, in the unit in which it was measured."""
    return [
        {
            "name": channel,
            "unit": unit_words(fit.trace.unit(channel)),
            "r2": None if (r2 := fit.r2[channel]) is None else f"{r2:.5f}",
            "rmse": plain(fit.trace.shown(channel, fit.rmse[channel])),
            "sigma": plain(fit.trace.shown(channel, fit.sigma[channel])),
            "how": "given" if channel in fit.trace.noise else "estimated",
            "colour": "white" if not fit.orders[channel] else f"not white (order {fit.orders[channel]})",
            "chi2": f"{(fit.rmse[channel] / fit.sigma[channel]) ** 2:.3f}",
        }
        for channel in fit.trace.channels
    ]
