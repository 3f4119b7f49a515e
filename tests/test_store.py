"""Results in files: everything comes back, bit for bit, and a file can neither run anything nor be taken for another."""

import dataclasses
import json
import sys

import equinox as eqx
import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import RPM, SLOT_FILE, slot

import millax as mx
from benchmarks import robot_slot
from benchmarks.kr270 import COMPLIANCE
from identification import LoadTest, NoiseModel, Parameter, Prior, Profile, Tie, Trace, TraceFit, Waterfall, fit, load_result
from identification._deflection import deflection
from identification._evaluate import evaluate
from identification._kinds import fits
from identification._outcome import Optimum, outcome
from identification._question import question
from identification._result import FitResult
from identification._store import load, save
from identification._uncertainty import none_known
from millax.robot import Loads

RIGID = mx.CaseFile.from_text(f'{SLOT_FILE}[simulation]\nduration = "0.03 s"\n').case
FORCES = ("Fx", "Fy")


def measured(case, seed=0):
    sim = mx.simulate(case)
    force = np.asarray(sim.force)[:, :2]
    force = force + np.random.default_rng(seed).normal(scale=2.0, size=force.shape)
    return Trace(np.asarray(sim.time), FORCES, force, {"Fx": 2.0}, {"Fx": "kN"}, "slot.csv")


@pytest.fixture(scope="module")
def rigid():
    return fit(RIGID, measured(RIGID), [Parameter("force.k0", "8 kN/mm^2"), "force.kr"])


def robot_asked(truly=True):
    """A load test alone, of the model or of nothing but noise."""
    joints, force = robot_slot.pulls()
    case = slot(structure=robot_slot.arm(joints[0], Loads(gravity=(0.0, 0.0, -9.81))), speed=8000 * RPM)
    test = LoadTest(joints, force, ("x", "y", "z"), np.ones((len(force), 3)), units={"x": "um"}, name="pulls")
    clean = np.asarray(eqx.filter_jit(deflection(test, case).predict)(case)).T if truly else 0.0
    values = clean + np.random.default_rng(1).normal(scale=1e-5, size=test.values.shape)
    test = dataclasses.replace(test, values=values)
    return case, test, [Parameter(f"robot.compliance.joint_{i + 1}", 1.5 * COMPLIANCE[i]) for i in range(6)]


def instrument_asked():
    """Two traces of a dynamometer, each with a clock of its own; a tie and a prior."""
    sensor = mx.Sensor(gain=(1.0, -1.0, 1.0), delay=3e-5, low_pass=mx.LowPass(3500.0, 2))
    case = dataclasses.replace(slot(structure=mx.Structure.rigid(), duration=0.05), sensor=sensor, clock=mx.Clock(0.0217))
    time, rng = 3.0 + np.arange(200) / 10e3, np.random.default_rng(2)
    traces = [Trace(time, FORCES, rng.normal(scale=100, size=(200, 2)), {"Fx": 2.0}) for _ in range(2)]
    asked = [
        Parameter("force.k0", 4e9, prior=Prior("5 kN/mm^2", factor=1.2)),
        Parameter("force.kr", 0.3, (0.1, 1.0)),
        Parameter("clock.start", each=True),
        Tie("sensor.gain.x", "force.kr", 3.0),
    ]
    return [case, case], traces, asked


@pytest.fixture(scope="module")
def robot():
    """A load test, a robot, and parts of a result that were not measured but made up."""
    case, test, parameters = robot_asked(truly=False)
    asked = question(case, test, parameters)
    result = made_up(asked, NoiseModel(), None)
    beside = TraceFit(
        test, np.asfortranarray(test.values + 1e-5), dict.fromkeys("xyz", 1e-5), None, {"x": 0, "y": 0, "z": 3}
    )
    return dataclasses.replace(result, traces=(beside,))


@pytest.fixture(scope="module")
def instrument():
    """Numbers of each trace, noise with outliers and a colour, a waterfall and a profile."""
    asked = question(*instrument_asked())
    names, ends = asked.numbers.names, np.random.default_rng(0).normal(size=(3, len(asked.numbers)))
    fall = Waterfall(names, asked.numbers.units, ends, ends + 1, np.array([0.0, 3.0, np.inf]), np.array([0, 1, -1]), 7)
    profile = Profile(names[0], "N/mm^2", np.arange(4.0), np.arange(4.0) - 2, (0.5, np.inf), None)
    return dataclasses.replace(made_up(asked, NoiseModel("student", 5.0, 2), fall), profiles=(profile,))


def made_up(asked, kind, fall):
    """What is said where nothing could be simulated: without a program to compile."""
    n = len(asked.numbers)
    optimum = Optimum(np.zeros(n), kind.of(np.arange(1.0, 1 + len(asked.samples))), None, none_known(("why",) * n), None)
    about = {
        "status": "cannot_start",
        "message": "no",
        "begun": False,
        "solver": "scipy_trf",
        "iterations": 1,
        "seconds": 0.1,
    }
    return outcome(asked, optimum, noise_model=kind, waterfall=fall, **about)


def same(one, other, place="result"):
    """Assert that two values are of the same types, structure and bits throughout."""
    assert type(one) is type(other), place
    if isinstance(one, np.ndarray | np.generic | jax.Array):
        a, b = np.asarray(one), np.asarray(other)
        assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes()), place
    elif dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            same(getattr(one, field.name), getattr(other, field.name), f"{place}.{field.name}")
    elif isinstance(one, dict):
        assert list(one) == list(other), place
        for key in one:
            same(one[key], other[key], f"{place}.{key}")
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), place
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            same(a, b, f"{place}.{i}")
    else:
        assert one == other or (one != one and other != other), place


@pytest.mark.parametrize("kind", ["rigid", "robot", "instrument"])
def test_everything_comes_back_bit_for_bit(kind, request, tmp_path):
    result = request.getfixturevalue(kind)
    result.save(tmp_path / "fit.h5")
    found = load_result(tmp_path / "fit.h5")
    same(found, result)
    assert jax.tree.structure((found.cases, found.asked.model)) == jax.tree.structure((result.cases, result.asked.model))
    assert found.to_json() == result.to_json()
    assert all(one.trace.values is asked.values for one, asked in zip(found.traces, found.asked.measured, strict=False))


def test_a_point_has_the_same_evaluation_bit_for_bit(rigid, tmp_path):
    evaluated_alike(rigid, tmp_path)


def evaluated_alike(result, tmp_path):
    result.save(tmp_path / "fit.h5")
    found = load_result(tmp_path / "fit.h5")
    same(found, result)
    same(*(evaluate(one.asked.model, one.noise, jnp.asarray(one.y)) for one in (found, result)))


@pytest.mark.long
@pytest.mark.parametrize(
    ("asked", "options"),
    [(robot_asked, {}), (instrument_asked, {"noise": NoiseModel("student", 5.0, 2), "max_iterations": 4})],
)
def test_fits_of_a_load_test_and_of_an_instrument(asked, options, tmp_path):
    evaluated_alike(fit(*asked(), **options), tmp_path)


def test_what_follows_a_fit_can_follow_a_file(rigid, tmp_path):
    rigid.save(tmp_path / "fit.h5")
    found = load_result(tmp_path / "fit.h5")
    again = fit(found.case, [one.trace for one in found.traces], found.asked.parameters)
    assert again["force.k0"].value == pytest.approx(rigid["force.k0"].value, abs=1e-2 * rigid["force.k0"].std)
    assert int(mx.simulate(found.case).status) == 0


def test_other_programs_find_the_arrays_by_their_place(rigid, tmp_path):
    rigid.save(tmp_path / "fit.h5")
    with h5py.File(tmp_path / "fit.h5") as file:
        np.testing.assert_array_equal(file["arrays"]["covariance"], rigid.covariance)
        np.testing.assert_array_equal(file["arrays"]["traces.0.trace.time"], rigid.traces[0].trace.time)
        assert file.attrs["millax"] == rigid.versions["millax"]


def test_values_of_every_kind(tmp_path):
    rows, columns = np.random.default_rng(0).normal(size=(2, 40, 50))
    value = {
        "words": ["ä", "", None, True, 3, 10**30, -0.0, 0.1, np.inf, -np.inf, np.nan, (), [], {}],
        "numbers": (np.float64(0.1), np.bool_(True), np.int8(-3), np.array(2 + 1j), jnp.array([True, False])),
        "shapes": (np.zeros((0, 3)), rows, np.asfortranarray(columns), rows[::2, ::3], jnp.zeros((2, 0)), np.float32([0.1])),
        "a key/with.anything": rows,
        "a key": {"with.anything": np.arange(3)},
    }
    save(tmp_path / "all.h5", "test", value)
    found = load(tmp_path / "all.h5", "test", dict)
    same(found, value)
    assert found["a key/with.anything"] is found["shapes"][1]
    # The order in memory decides how sums are rounded.
    assert found["shapes"][2].flags.f_contiguous
    assert found["shapes"][1].flags.c_contiguous


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({"a": {"b": {1, 2}}}, "nothing was written: a.b is builtins.set; only data and dataclasses can be kept"),
        ([len], "0 is builtins.builtin_function_or_method"),
        ({"a": np.array(["text"])}, "a is an array of <U4; only arrays of numbers"),
        ({1: 2}, "is builtins.dict"),
    ],
)
def test_what_is_no_data_is_not_written(tmp_path, value, words):
    with pytest.raises(ValueError, match=r"one\.h5: ") as error:
        save(tmp_path / "one.h5", "test", value)
    assert words in str(error.value)
    assert not list(tmp_path.iterdir())


def test_a_case_with_a_law_of_ones_own_is_not_written_and_what_was_there_stays(rigid, tmp_path):
    class Own(mx.FractionalLaw):
        pass

    own = dataclasses.replace(rigid, cases=(eqx.tree_at(lambda c: c.force, RIGID, Own(5e9, 18e-6, 0.1, 0.3)),))
    rigid.save(tmp_path / "fit.h5")
    with pytest.raises(ValueError, match=r"Own is no class of millax; objects of other packages are not kept"):
        own.save(tmp_path / "fit.h5")
    same(load_result(tmp_path / "fit.h5"), rigid)


# ---- files that are none


@pytest.fixture
def crafted(rigid, tmp_path):
    """Write a result whose structure is changed by a function, or whose file is."""

    def crafted(structure=None, file=None):
        path = tmp_path / "fit.h5"
        rigid.save(path)
        with h5py.File(path, "r+") as h5:
            if structure:
                found = json.loads(h5["structure"].asstr()[()])
                structure(found["fields"])
                del h5["structure"]
                h5["structure"] = json.dumps(found)
            if file:
                file(h5)
        return path

    return crafted


def refused(path, *words):
    with pytest.raises(ValueError, match=r"fit\.h5: ") as error:
        load_result(path)
    for one in words:
        assert one in str(error.value)


@pytest.mark.parametrize(
    "name",
    [
        "planted.Thing",
        "os.system",
        "builtins.dict",
        "pathlib.Path",
        "subprocess.Popen",
        "millaxplanted.Thing",
        "identification.planted.Thing",
        "identification._store.h5py",
        "identification._store.dataclasses.Field",
        "identification._store.save",
        "identification._result.Question",
        "identification._store.Path",
        "identification..Thing",
        "millax._sweepfile.SweepFile",
        "millax._casefile.CaseError",
    ],
)
def test_a_file_makes_no_object_and_imports_no_module_of_its_choice(crafted, tmp_path, monkeypatch, name):
    """The last but four is a class of ours, but not of that module; the last are no dataclasses."""
    for module in ("planted", "millaxplanted"):
        (tmp_path / f"{module}.py").write_text("import dataclasses\n@dataclasses.dataclass\nclass Thing: pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    refused(crafted(lambda fields: fields.update(seed={"class": name, "fields": {}})), f"{name} is no class of this version")
    assert not {"planted", "millaxplanted"} & set(sys.modules)


def test_nothing_is_called_when_an_object_is_made(crafted, monkeypatch):
    called = []
    for cls in (Trace, mx.Cut, NoiseModel):
        monkeypatch.setattr(cls, "__init__", lambda *_, **__: called.append(1))
    for cls in (Trace, NoiseModel):
        monkeypatch.setattr(cls, "__post_init__", lambda *_: called.append(1))
    assert isinstance(load_result(crafted()), FitResult)
    assert not called


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.pop("covariance"), "a FitResult without covariance found"),
        (lambda f: f.update(flux=None), "a FitResult with the unknown flux found"),
        (lambda f: f.update(asked=f["noise"]), "FitResult.asked must not be Noise"),
        (lambda f: f.update(message=3), "FitResult.message must not be int"),
        (lambda f: f.update(cases={"tuple": ["case"]}), "FitResult.cases must not be tuple"),
        (lambda f: f.update(versions={"dict": {"millax": 1}}), "FitResult.versions must not be dict"),
        (lambda f: f.update(seed={"set": [1]}), 'its structure holds {"set": [1]}, which stands for nothing'),
        (lambda f: f.update(seed={"float": "three"}), "could not convert"),
        (lambda f: f.update(y={"array": "y!", "kind": "numpy", "columns": False}), "it has no dataset y! of its own"),
        (lambda f: f.update(y={"array": "/structure", "kind": "numpy", "columns": False}), "it has no dataset /structure"),
    ],
)
def test_a_file_with_other_fields_is_of_another_version(crafted, change, words):
    refused(crafted(change), words, "The file was written by millax 0", "read it with the one that wrote it")


def elsewhere(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["y"] = [1.0, 2.0]
    return tmp_path / "other.h5"


def replaced(file, link):
    del file["arrays"]["y"]
    file["arrays"]["y"] = link


def virtual(file, source):
    del file["arrays"]["y"]
    layout = h5py.VirtualLayout(shape=(2,), dtype=float)
    layout[:] = h5py.VirtualSource(str(source), "y", shape=(2,))
    file["arrays"].create_virtual_dataset("y", layout)


def raw(file, source):
    del file["arrays"]["y"]
    file["arrays"].create_dataset("y", (2,), float, external=[(str(source), 0, 16)])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda file, other: replaced(file, h5py.ExternalLink(str(other), "y")), "no dataset y of its own"),
        (lambda file, _: replaced(file, h5py.SoftLink("/arrays/covariance")), "no dataset y of its own"),
        (virtual, "the dataset y lies in another file"),
        (raw, "the dataset y lies in another file"),
        (lambda file, _: replaced(file, "text"), "the dataset y is of"),
        (lambda file, _: file.attrs.update(format=99), "format 99 found; this version reads format 1"),
        (lambda file, _: file.attrs.update(content="test"), "the file does not hold a result of a fit, but test"),
        (lambda file, _: file.attrs.pop("content"), "does not hold a result of a fit, but something else"),
        (lambda file, _: file.pop("structure"), "it has no dataset structure"),
        (lambda file, _: file.pop("arrays"), "it has no group arrays"),
    ],
)
def test_files_that_hold_something_else(crafted, tmp_path, change, words):
    other = elsewhere(tmp_path)
    refused(crafted(file=lambda file: change(file, other)), words)


def test_files_that_are_damaged_or_foreign(crafted, tmp_path):
    path = crafted()
    whole = path.read_bytes()
    for data in (b"", b"text", whole[:100], whole[: len(whole) // 2], whole[:-1]):
        path.write_bytes(data)
        refused(path, "this is no HDF5 file, or it is damaged; a result of a fit was expected")
    with pytest.raises(FileNotFoundError):
        load_result(tmp_path / "none.h5")


def test_numbers_in_double_precision_are_not_cut(crafted):
    path = crafted()
    with jax.enable_x64(False):
        refused(path, "its numbers are float64: call millax.set_up()")


def test_kinds_of_fields():
    assert fits(jnp.zeros(2), jax.Array)
    assert fits(3, float | None)
    assert fits([1.0, None], tuple[float | None, float | None])
    assert not fits((1.0,), tuple[float, float])
    assert not fits("3", float)
    assert not fits({"a": "b"}, dict[str, float])
