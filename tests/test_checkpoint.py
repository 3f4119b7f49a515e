"""Checkpoints: a fit that was killed, stopped or given up goes on where it was, and no other fit takes its file."""

import dataclasses
import os
import shutil
import signal
import subprocess
import sys

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from cases import SLOT_FILE

import millax as mx
from identification import NoiseModel, Parameter, Prior, Tie, Trace, _command, fit, load_result
from identification._checkpoint import CONTENT, Checkpoint, CheckpointError, End, State, _Kept
from identification._question import question
from identification._store import load
from identification.cli import main

FILE = f'{SLOT_FILE}[simulation]\nduration = "0.03 s"\n'
CASE = mx.CaseFile.from_text(FILE).case
FORCES = ("Fx", "Fy")
ASKED = [Parameter("force.k0", 1e10), Parameter("force.kr", 0.6)]


def measured(seed=0, **changes):
    sim = mx.simulate(CASE)
    force = np.asarray(sim.force)[:, :2]
    force = force + np.random.default_rng(seed).normal(scale=2.0, size=force.shape)
    return Trace(np.asarray(sim.time), FORCES, force, **{"noise": {"Fx": 2.0}} | changes)


@pytest.fixture(scope="module")
def whole():
    return fit(CASE, measured(), ASKED)


def stop_at(iteration):
    def stop(progress):
        if progress.iteration >= iteration:
            raise KeyboardInterrupt

    return stop


def agree(result, whole):
    assert result.success, result.message
    for one, other in zip(result.parameters, whole.parameters, strict=True):
        assert abs(one.value - other.value) < 1e-3 * other.std
        assert one.std == pytest.approx(other.std, rel=1e-3)
    for channel in FORCES:
        assert result.traces[0].sigma[channel] == pytest.approx(whole.traces[0].sigma[channel], rel=1e-3)


@pytest.mark.parametrize("iteration", [2, 4, 6])
def test_a_stopped_fit_goes_on_where_it_was(whole, tmp_path, iteration):
    """In the first stage, and in those that estimate the noise."""
    path = tmp_path / "one.h5"
    first = fit(CASE, measured(), ASKED, progress=stop_at(iteration), checkpoint=path)
    assert first.status == "interrupted"
    assert first.message.endswith(f"The same fit goes on from {path}.")
    state = load(path, CONTENT, _Kept).state
    assert (state.iterations, state.round > 0) == (first.iterations, iteration == 6)
    np.testing.assert_array_equal(state.y, first.y)
    seen = []
    result = fit(CASE, measured(), ASKED, progress=seen.append, checkpoint=path)
    agree(result, whole)
    assert seen[0].stage == f"resuming after {iteration} iterations"
    assert seen[0].seconds > state.seconds
    assert result.message.endswith(f" Resumed after {iteration} iterations.")
    assert iteration < result.iterations < whole.iterations + 6
    assert not path.exists()


def test_a_fit_that_was_given_too_few_iterations_goes_on_with_as_many_again(whole, tmp_path):
    asked = {"checkpoint": tmp_path / "one.h5", "max_iterations": 3}
    first = fit(CASE, measured(), ASKED, **asked)
    assert (first.status, first.iterations) == ("not_converged", 3)
    second = fit(CASE, measured(), ASKED, **asked)
    assert (second.status, second.iterations) == ("not_converged", 6)
    assert "Resumed after 3 iterations. The same fit goes on from" in second.message
    # Another solver is no other question.
    agree(fit(CASE, measured(), ASKED, checkpoint=tmp_path / "one.h5", solver="scipy_trf"), whole)
    assert not list(tmp_path.iterdir())


@pytest.mark.long
def test_starts_that_are_done_are_not_done_again(tmp_path):
    asked = {"starts": 9, "seed": 1}
    whole = fit(CASE, measured(), ASKED, **asked)
    path, stages = tmp_path / "one.h5", []

    def stop(progress):
        if progress.stage == "from all starts: 8 of 9":
            raise KeyboardInterrupt

    first = fit(CASE, measured(), ASKED, progress=stop, checkpoint=path, **asked)
    assert len(load(path, CONTENT, _Kept).state.ends) == 8
    result = fit(CASE, measured(), ASKED, progress=lambda p: stages.append(p.stage), checkpoint=path, **asked)
    agree(result, whole)
    assert "from all starts: 1 of 1" in stages
    assert first.iterations < result.iterations < whole.iterations + 6
    np.testing.assert_array_equal(result.waterfall.starts, whole.waterfall.starts)
    np.testing.assert_array_equal(result.waterfall.optimum, whole.waterfall.optimum)
    assert not path.exists()


def test_a_fit_that_cannot_start_leaves_nothing(tmp_path):
    away = eqx.tree_at(lambda c: c.cut.start, CASE, jnp.array([-0.02, 0.0]))
    assert fit(away, measured(), ASKED, checkpoint=tmp_path / "one.h5").status == "cannot_start"
    assert not list(tmp_path.iterdir())


# ---- whose checkpoint it is


def keeper(path, case=CASE, traces=None, asked=tuple(ASKED), noise=None, starts=None):
    given = question(case, traces or [measured()], asked)
    return Checkpoint(path, given, noise or NoiseModel(), starts), given


def state(given):
    n = len(given.numbers)
    noise = NoiseModel("student", 4.0, 1).of(np.ones(2))
    return State(np.arange(float(n)), noise, 3, (End(np.ones(n), np.inf), End(np.zeros(n), 1.5)), 12, 3.25)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"traces": [measured(1)]}, "other measurements"),
        ({"traces": [measured(noise={"Fx": 3.0})]}, "other measurements"),
        ({"case": eqx.tree_at(lambda c: c.cut.depth, CASE, jnp.asarray(1.1e-3))}, "other cases"),
        ({"case": CASE.with_settings(passes=4)}, "other cases"),
        ({"asked": (Parameter("force.k0", 9e9), ASKED[1])}, "other free parameters, guesses, bounds, priors or ties"),
        ({"asked": (*ASKED, Tie("force.hs", "force.k0", 1e-15))}, "other free parameters"),
        ({"asked": (ASKED[0], dataclasses.replace(ASKED[1], prior=Prior(0.3, 0.1)))}, "other free parameters"),
        ({"noise": NoiseModel("student")}, "other kind of noise"),
        ({"starts": np.zeros((3, 2))}, "other starts"),
        ({"traces": [measured(1)], "noise": NoiseModel(order=1)}, "other measurements, other kind of noise"),
    ],
)
def test_the_checkpoint_of_another_question_is_refused(tmp_path, change, words):
    first, given = keeper(tmp_path / "one.h5")
    first.keep(state(given), now=True)
    with pytest.raises(CheckpointError, match=r"one\.h5: the checkpoint belongs to another question: ") as error:
        keeper(tmp_path / "one.h5", **change)[0].found()
    assert f"question: {words}" in str(error.value)
    assert "Delete the file to begin anew (millax fit --restart does), or give another path" in str(error.value)


def test_a_state_comes_back_also_for_the_same_numbers_from_another_file(tmp_path):
    first, given = keeper(tmp_path / "one.h5")
    assert first.found() is None
    first.keep(state(given), now=True)
    other = keeper(tmp_path / "one.h5", traces=[measured(name="copy.csv", units={"Fx": "kN"})])[0]
    found, kept = other.found(), state(given)
    assert (found.round, found.iterations, found.seconds) == (3, 12, 3.25)
    assert [one.cost for one in found.ends] == [np.inf, 1.5]
    np.testing.assert_array_equal(found.y, kept.y)
    np.testing.assert_array_equal(found.noise.reflection, kept.noise.reflection)
    assert found.noise.degrees == 4.0


def test_files_that_are_no_checkpoint_and_places_for_none(tmp_path, whole):
    path = tmp_path / "one.h5"
    path.write_text("text")
    with pytest.raises(CheckpointError, match=r"one\.h5: this is no HDF5 file.*Delete the file to begin anew"):
        keeper(path)[0].found()
    whole.save(path)
    with pytest.raises(CheckpointError, match="does not hold a checkpoint of a fit, but result of a fit"):
        fit(CASE, measured(), ASKED, checkpoint=path)
    with pytest.raises(CheckpointError, match="the directory of the checkpoint does not exist"):
        fit(CASE, measured(), ASKED, checkpoint=tmp_path / "none" / "one.h5")


def test_states_are_kept_about_once_a_second(tmp_path):
    kept, given = keeper(tmp_path / "one.h5")
    for i in range(3):
        kept.keep(dataclasses.replace(state(given), iterations=i))
    assert kept.found().iterations == 0
    kept.keep(state(given), now=True)
    assert kept.found().iterations == 12


def test_a_fit_goes_on_where_its_checkpoint_cannot_be_written(whole, tmp_path):
    folder = tmp_path / "gone"
    folder.mkdir()

    def gone(progress):
        shutil.rmtree(folder, ignore_errors=True)

    with pytest.warns(UserWarning, match=r"one\.h5: the checkpoint cannot be written: No such file.*; the fit goes on"):
        agree(fit(CASE, measured(), ASKED, progress=gone, checkpoint=folder / "one.h5"), whole)


# ---- the command


def here():
    folder = os.path.dirname(__file__)
    path = os.pathsep.join([folder, os.path.dirname(folder)])
    return {"cwd": folder, "env": os.environ | {"PYTHONPATH": path, "PYTHONUNBUFFERED": "1"}}


SLOW = """\
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a process started in the background ignores it
import jax
jax.numpy.zeros(1).block_until_ready()  # the programs are those of the tests, compiled already
from identification import _command, cli
stage, line = sys.argv[1], _command._line
def slowly(progress):
    said = line(progress)
    if said.startswith(stage):
        print(said, flush=True)
        time.sleep(30)  # until it is ended
    return said
_command._line = slowly
sys.exit(cli.main(sys.argv[2:]))
"""


def ended_in(stage, by, arguments):
    """Run a command until it says that it is in a stage, then end it by a signal; its exit code and what it said."""
    run = subprocess.Popen([sys.executable, "-c", SLOW, stage, *arguments], **here(), stdout=subprocess.PIPE, text=True)
    said = []
    for line in run.stdout:
        said.append(line)
        if line.startswith(stage):
            run.send_signal(by)
            break
    said.append(run.stdout.read())
    return run.wait(timeout=60), "".join(said)


def test_a_killed_command_goes_on_and_ctrl_c_keeps_everything(whole, tmp_path, monkeypatch, capsys):
    trace = measured()
    rows = [f"{t:.9g},{x:.9g},{y:.9g}" for t, (x, y) in zip(trace.time, trace.values, strict=True)]
    (tmp_path / "trace.csv").write_text("\n".join(["time [s],Fx [N],Fy [N]", *rows]), encoding="utf-8")
    free = "[fit.free]\nforce.k0 = 1e10\nforce.kr = 0.6\n"
    case = tmp_path / "case.toml"
    case.write_text(f'{FILE}{free}[[trace]]\nfile = "trace.csv"\nnoise = {{ Fx = "2 N" }}\n', encoding="utf-8")
    out = tmp_path / "out"
    command = ["fit", str(case), "--out", str(out)]
    code, _ = ended_in("fit: ", signal.SIGKILL, command)
    assert code == -signal.SIGKILL
    assert [file.name for file in out.iterdir()] == ["checkpoint.h5"]

    code, said = ended_in("noise 1: ", signal.SIGINT, command)
    assert code == 130
    assert "going on from" in said
    assert "resuming after 2 iterations" in said
    assert {file.name for file in out.iterdir()} == {
        "checkpoint.h5",
        "result.h5",
        "result.json",
        "report.html",
        "fitted.toml",
    }
    stopped = load_result(out / "result.h5")
    assert stopped.status == "interrupted"

    case.write_text(case.read_text(encoding="utf-8").replace("0.6", "0.7"), encoding="utf-8")
    capsys.readouterr()
    assert main(command) == 2
    assert "belongs to another question: other free parameters" in " ".join(capsys.readouterr().err.split())
    case.write_text(case.read_text(encoding="utf-8").replace("0.7", "0.6"), encoding="utf-8")

    assert main(command) == 0
    result = load_result(out / "result.h5")
    agree(result, whole)
    assert f"Resumed after {stopped.iterations} iterations." in result.message
    assert not (out / "checkpoint.h5").exists()

    Checkpoint(out / "checkpoint.h5", result.asked, NoiseModel(), None).keep(state(result.asked), now=True)
    monkeypatch.setattr(_command, "fit", lambda *_, checkpoint, **__: pytest.exit(f"{checkpoint.exists()}"))
    for more, there in ([], True), (["--restart"], False):
        with pytest.raises(pytest.exit.Exception, match=str(there)):
            main([*command, *more])
