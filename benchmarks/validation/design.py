"""What a design promises, kept by fits: their errors, beside those with another cut; and a pose that tells joints apart."""

from collections.abc import Iterator

import numpy as np

import identification as ident
import millax as mx
from millax._members import FEED_PER_TOOTH, member
from millax._names import read_value

from ..demo import NOISE
from ..figures import Figure, near
from ..kr270 import slot as kr270_slot
from ..robot_slot import POSES, TRUTH, arm, cases, traces
from ..slot import slot

LAW = ("force.k0", "force.hs", "force.r", "force.kr")
TIME = 0.02 + np.arange(800) / 10e3
SEEDS = 200
"""Their spread is good to 5 %."""

POSE_SEEDS = 12


def figures():
    yield from _feeds()
    yield from _poses()


def _feeds() -> Iterator[Figure]:
    """The force law is known from one feed, its bend at h_s and its end slope r badly; which feed is next?"""
    case = slot(duration=0.1, border=False)
    measured = ident.synthetic_trace(case, TIME, tuple(NOISE), NOISE, seed=0)
    found = ident.design(case, measured, LAW, {FEED_PER_TOOTH: "0.02:0.3:8 mm"})
    best, median = found.ranking[0], found.ranking[len(found.ranking) // 2]
    yield Figure("best feed of 8; the one in the middle of the ranking", f"{best.words}; {median.words}", "", None)
    yield Figure("standard errors shrink, on average: best", f"{best.shrinks(found.today):.3g} times", "", None)
    yield Figure("the same: the one in the middle", f"{median.shrinks(found.today):.3g} times", "", None)
    volumes = []
    for what, one in (("best", best), ("middle", median)):
        values = [read_value(case, name, value) for name, value in zip(found.parameters, found.values, strict=True)]
        errors = _errors([case, _fed(case, one.cut[FEED_PER_TOOTH][0] * 1e-3)], np.array(values))
        spread = errors.std(axis=0) / list(one.std.values())
        far = int(np.argmax(np.abs(spread - 1)))
        yield near(f"{SEEDS} fits with the {what} cut: errors over those predicted ({LAW[far]})", spread[far], 1.0, 0.15)
        volumes.append(np.linalg.det(np.cov((errors / values).T)) ** (1 / (2 * len(LAW))))
    gained, promised = volumes[1] / volumes[0], median.uncertainty / best.uncertainty
    yield near("errors with the middle cut over those with the best, on average", gained, promised, 0.15 * promised)


def _fed(case: mx.Case, feed_per_tooth: float) -> mx.Case:
    return member(case, (FEED_PER_TOOTH,), np.array([feed_per_tooth]))


def _errors(both: list[mx.Case], truth: np.ndarray) -> np.ndarray:
    """Of fits to what is recorded of both cuts, one row for each realisation of the noise."""
    clean = [ident.synthetic_trace(case, TIME, tuple(NOISE)).values for case in both]
    rows = []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        noisy = [values + rng.normal(size=values.shape) * list(NOISE.values()) for values in clean]
        recorded = [ident.Trace(TIME, tuple(NOISE), values, NOISE) for values in noisy]
        result = ident.fit(both, recorded, LAW, check=False)
        rows.append([e.value for e in result.parameters] - truth)
    return np.array(rows)


def _poses() -> Iterator[Figure]:
    """One pose leaves joints 4 and 6 hardly told apart; which joint angles of the wrist are next?"""
    (case,), (measured,) = cases(1), traces(0, 1)
    grid = {"robot.joints.joint_4": "90:180:3 deg", "robot.joints.joint_6": "90:180:3 deg"}
    found = ident.design(case, measured, [ident.Parameter(name) for name in TRUTH], grid)
    joint, best, worst = "robot.compliance.joint_4", found.ranking[0], found.ranking[-1]
    yield Figure("today, one pose: joint 4", _known(found.today, joint), "not known", found.today.std[joint] is None)
    yield Figure(f"after the best of 9 poses ({best.words})", _known(best, joint), "known", best.std[joint] is not None)
    yield Figure(f"after the worst ({worst.words})", _known(worst, joint), "", None)
    pose = np.array(POSES[0], float)
    pose[[3, 5]] = [value for value, _ in best.cut.values()]
    other, errors = kr270_slot(0.3, arm(np.deg2rad(pose))), []
    for seed in range(POSE_SEEDS):
        second = ident.synthetic_trace(other, measured.time, measured.channels, measured.noise, 100 + seed)
        result = ident.fit([case, other], [traces(seed, 1)[0], second], list(TRUTH), check=False)
        errors.append([(e.value - TRUTH[e.name]) / best.std[e.name] for e in result.parameters])
    yield near(f"{POSE_SEEDS} fits with the best pose: errors of nine numbers over those predicted", _rms(errors), 1.0, 0.25)


def _known(forecast: ident.Forecast, name: str) -> str:
    std = forecast.std[name]
    return "not known" if std is None else f"± {100 * std / TRUTH[name]:.2g} %"


def _rms(errors: list[list[float]]) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))
