"""The programs of `make validate` and `make bench`: their yardsticks compute the same cut, their tables can say no."""

import dataclasses
import importlib

import jax
import numpy as np
import pytest
from rich.console import Console

import millax as mx
from benchmarks import bench, compiled, kr270
from benchmarks.figures import Figure, below, near, report, show
from benchmarks.scan import step_by_step
from benchmarks.slot import light, six_coordinates, slot
from benchmarks.speed import batch, child, single
from benchmarks.speed.child import ask
from benchmarks.speed.picture import draw
from benchmarks.speed.run import Run
from benchmarks.timing import Times, exponent, interleaved
from benchmarks.validate import SUBJECTS
from benchmarks.validation import programs

needs_gcc = pytest.mark.skipif(not compiled.have_compiler(), reason="the C loops need gcc")


def error(values, reference):
    """Largest difference over the largest value."""
    return np.abs(np.asarray(values) - np.asarray(reference)).max() / np.abs(np.asarray(reference)).max()


def with_stock(stock):
    return dataclasses.replace(slot(duration=0.12), stock=stock)


def with_teeth(teeth):
    return dataclasses.replace(slot(duration=0.1), tool=mx.EndMill(0.02, teeth), settings=mx.Settings(60, 40, 3))


CUTS = {
    "slot": lambda: slot(duration=0.12),
    "no border": lambda: slot(duration=0.1, border=False),
    "hard gates": lambda: slot(duration=0.1, width=0.0),
    "one pass": lambda: slot(duration=0.1, passes=1),
    "blocks": lambda: slot(duration=0.1, blocks=4),
    "half immersion": lambda: with_stock(mx.Stock.box((0.0, None), (None, 0.0))),
    "walls, entry and exit": lambda: with_stock(mx.Stock.box((0.0, 0.004), (-0.003, 0.005))),
    "oblique borders": lambda: with_stock(mx.Stock(np.array([[-0.96, 0.28], [0.6, 0.8]]), np.array([0.002, 0.006]))),
    "one tooth": lambda: with_teeth(1),
    "five teeth": lambda: with_teeth(5),
    "light tool mode at its limit": lambda: light(duration=0.1),
    "six coordinates, full matrices": lambda: six_coordinates(duration=0.1),
}


@needs_gcc
@pytest.mark.parametrize("cut", CUTS)
def test_the_engine_agrees_with_the_c_loop(cut):
    # Nothing in common but the equations: C, one step after the other, converged in each. 1e-9 leaves room for rounding.
    case = CUTS[cut]()
    case = dataclasses.replace(case, settings=dataclasses.replace(case.settings, sweeps=30, tolerance=1e-14))
    sim, loop = mx.simulate(case), compiled.same_model(case, tolerance=1e-18)()
    assert error(sim.force[:, :2], loop.force) < 1e-9
    assert error(sim.displacement[:, :2], loop.displacement) < 1e-9
    assert error(sim.chip_thickness, loop.thickness) < 1e-9


@needs_gcc
def test_the_c_loop_is_as_good_as_the_engine_at_the_tolerance_at_which_it_is_timed():
    case = slot(duration=0.12)
    assert error(compiled.same_model(case)().force, compiled.same_model(case, tolerance=1e-18)().force) < 1e-6


@needs_gcc
def test_the_simplified_loop_computes_the_same_cut():
    # It samples the force of a step behind hard gates, which costs accuracy at the border: 3 % of the displacement.
    case = slot(duration=0.1)
    sim, loop = mx.simulate(case), compiled.sampled(case)()
    assert error(loop.displacement, sim.displacement) < 0.05
    assert np.abs(loop.force.mean(0) - sim.force.mean(0)[:2]).max() < 0.02 * np.abs(sim.force).max()


def test_the_scan_over_steps_agrees_with_the_engine():
    case = slot(duration=0.05, sweeps=12, tolerance=1e-14)
    sim, (force, displacement) = mx.simulate(case), step_by_step(case)()
    assert error(force, sim.force[:, :2]) < 1e-9
    assert error(displacement, sim.displacement) < 1e-9


def test_a_missed_target_is_reported():
    figures = [below("a", 1.0, 2.0), below("b", 3.0, 2.0), near("c", 1.0, 1.2, 0.1), Figure("d", "1", "", None)]
    assert [figure.met for figure in figures] == [True, False, False, None]
    console = Console(record=True, width=100)
    show(console, "subject", figures)
    assert console.export_text().count("MISSED") == 2


def test_not_a_number_is_a_miss():
    assert below("a", float("nan"), 2.0).met is False
    assert near("a", float("nan"), 2.0, 1.0).met is False


def test_the_trace_counter_counts():
    assert programs._traces().met


@pytest.mark.parametrize("subject", SUBJECTS)
def test_every_subject_can_be_loaded(subject):
    assert callable(importlib.import_module(f"benchmarks.validation.{subject}").figures)


def test_the_table_of_the_kr270_is_one_command(capsys):
    rows = kr270.rows()
    assert {row.met for row in rows} == {True, None}
    values = {row.quantity: row.computed for row in rows}
    assert values["F_y/K_yy"] < 0.6 * values["mean displacement along y, simulated"]  # held, and free to turn
    kr270.main()
    printed = capsys.readouterr().out
    assert all(row.shown in printed for row in rows)


@pytest.mark.parametrize("subject", bench.SUBJECTS)
def test_every_subject_of_the_bench_can_be_loaded(subject):
    assert callable(importlib.import_module(f"benchmarks.speed.{subject}").figures)


def test_ratios_are_taken_round_by_round():
    # The machine is ten times as slow in the second round: both are, and their ratio stays.
    times = Times({"a": np.array([2.0, 20.0, 2.0]), "b": np.array([1.0, 10.0, 1.0])})
    assert times.ratio("a", "b") == 2.0
    assert times.seconds("a") == 2.0


def test_functions_take_turns():
    order = []
    times = interleaved({name: lambda name=name: order.append(name) for name in "ab"}, rounds=3)
    assert "".join(order) == "abababab"  # once before, to compile
    assert times.rounds["a"].shape == (3,)


def test_the_exponent_of_a_power():
    sizes = np.array([1.0, 10.0, 100.0])
    assert exponent(sizes, 3e-3 * sizes**0.75) == pytest.approx(0.75)


def test_one_simulation_is_measured_beside_everything_else():
    run = Run(duration=0.02, rounds=2)
    figures = {figure.what: figure for figure in single.figures(run)}
    assert {single.ENGINE, single.SIX, single.SCAN, "papers' grid in NumPy"} <= set(run.bars)
    assert all(value > 0 for value in run.bars.values())
    assert figures[f"{single.SCAN} beside {single.ENGINE}"].met is None
    if compiled.have_compiler():
        assert set(run.lines) == {single.SAME, single.SAMPLED}
        assert figures[f"{single.ENGINE} beside {single.SAME}"].met in (True, False)
        assert figures[f"{single.ENGINE} and {single.SAME}, both converged: largest difference of force"].met


def test_batches_are_measured_per_core():
    result = batch.measure(4, 0.01, 1)
    assert result["cores"] == jax.local_device_count()
    assert result["wall"] > 0
    assert ("ratio" in result) == compiled.have_compiler()


def test_what_belongs_to_a_process_is_measured_in_one_of_its_own():
    assert set(ask("start")) == {"import", "case", "first", "second"}


def test_peak_memory_is_that_of_this_process():
    before = child._peak()
    np.ones(30_000_000)  # 240 MB
    assert 50e6 < before < child._peak() < 50e9


def test_a_measurement_that_fails_says_why():
    with pytest.raises(RuntimeError, match="no_such_subject"):
        ask("no_such_subject")


def test_the_bench_writes_its_tables_and_its_picture(tmp_path, monkeypatch, capsys):
    def figures(run):
        run.bars |= {"millax": 200.0, "lax.scan over steps": 2000.0}
        run.lines |= {"C, same model": 80.0}
        run.growth["teeth"] = ((1, 2, 4), (0.1, 0.2, 0.4))
        yield below("millax beside C", 2.5, 3.0)
        yield below("gradient", 5.0, 4.0)

    monkeypatch.setattr("benchmarks.speed.startup.figures", figures)
    monkeypatch.setattr("sys.argv", ["bench", "startup", "--write", str(tmp_path / "speed.md")])
    assert bench.main() == 1
    assert "1 of 2 targets met" in capsys.readouterr().out
    text = (tmp_path / "speed.md").read_text(encoding="utf-8")
    assert "| gradient | 5 | ≤ 4 | MISSED |" in text
    assert "(speed.png)" in text
    assert (tmp_path / "speed.png").stat().st_size > 10_000


def test_ctrl_c_leaves_the_subjects_that_are_done(capsys):
    def figures_of(subject):
        if subject == "second":
            raise KeyboardInterrupt
        yield below("gradient", 3.0, 4.0)

    met, text = report({"first": "Derivatives", "second": "Batches"}, figures_of, "x86_64")
    assert not met
    assert 'Stopped in "Batches". 1 of 1 targets met' in capsys.readouterr().out
    assert "| gradient | 3 | ≤ 4 | ok |" in text


def test_a_picture_of_nothing_can_be_drawn():
    draw(Run())  # a bench of a single subject may have nothing to show
