"""`millax sweep`: the file, the picture, the words and the exit codes."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray
from cases import SLOT_FILE

import millax as mx
from identification import _sweep_command
from identification.cli import main
from millax.plots import plot_sweep

RIGID = f"""\
{SLOT_FILE}
[simulation]
duration = "0.012 s"
"""
SOFT = """\
[structure]
axes = ["x", "y"]
mass = "0.5 kg"
stiffness = "100 N/m"
damping_ratio = 0.05
"""
DEPTHS = ("--vary", "cut.depth=0.5:2:4 mm")


@pytest.fixture
def case_file(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(RIGID)
    return path


def sweep(case_file, *arguments, name="sweep.nc"):
    out = case_file.parent / name
    return main(["sweep", str(case_file), *arguments, "--out", str(out)]), out


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_the_files_of_a_sweep(case_file, capsys):
    code, out = sweep(case_file, *DEPTHS, "--vary", "force.kr=0.2,0.3", "--reduce", "mean_force, peak_force")
    assert code == 0
    assert files(case_file.parent) == {"case.toml", "sweep.nc", "sweep.png"}
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    case = mx.load_case(case_file)
    expected = mx.summarize(mx.simulate(case), case)["mean_force.y"]["value"]
    with xarray.open_dataset(out, engine="h5netcdf") as result:
        assert set(result.data_vars) == {"mean_force", "peak_force", "status", "residual", "simulated_time"}
        assert result["mean_force"].sizes == {"cut.depth": 4, "force.kr": 2, "axis": 3}
        at = result["mean_force"].sel({"cut.depth": 1.0, "force.kr": 0.3, "axis": "y"})
        assert float(at) == pytest.approx(expected, rel=1e-9)
    printed = capsys.readouterr().out
    assert "8 of 8 members, 0 failed" in printed
    assert "\x1b" not in printed


def test_the_same_command_again_reads_and_another_one_is_refused(case_file, capsys):
    assert sweep(case_file, *DEPTHS)[0] == 0
    assert sweep(case_file, *DEPTHS)[0] == 0
    case_file.write_text(RIGID.replace("5000 N/mm^2", "6000 N/mm^2"))
    capsys.readouterr()
    assert sweep(case_file, *DEPTHS)[0] == 2
    assert "force.k0: 5000000000.0 → 6000000000.0" in capsys.readouterr().err
    assert sweep(case_file, *DEPTHS, "--overwrite")[0] == 0


def test_a_feed_per_tooth_in_the_file_is_held_while_the_speed_varies(case_file, capsys):
    inside = 'feed_per_tooth = "0.1 mm"\nstart = ["20 mm", "0 mm"]'
    case_file.write_text(RIGID.replace('feed_rate = "4 m/min"', inside))
    code, out = sweep(case_file, "--vary", "cut.spindle_speed=8000,10000,12000 rpm", "--reduce", "mean_force")
    assert code == 0
    assert "feed per tooth held at 0.1 mm" in capsys.readouterr().out
    with xarray.open_dataset(out, engine="h5netcdf") as result:
        forces = result["mean_force"].sel(axis="y").to_numpy()
        assert float(result["cut.feed_per_tooth"]) == 0.1
    np.testing.assert_allclose(forces, forces[0], rtol=1e-9)  # of a rigid tool, in full material, under the same chips


def test_random_members(case_file):
    arguments = ("--vary", "force.k0=4000:6000 N/mm^2", "--vary", "force.kr=0.3 +- 0.02", "--samples", "20", "--seed", "5")
    code, out = sweep(case_file, *arguments, "--reduce", "mean_force")
    assert code == 0
    with xarray.open_dataset(out, engine="h5netcdf") as result:
        assert result["mean_force"].sizes == {"sample": 20, "axis": 3}
        np.testing.assert_array_equal(
            result["force.kr"],
            mx.sample({"force.k0": "4000:6000 N/mm^2", "force.kr": "0.3 +- 0.02"}, 20, seed=5)["force.kr"],
        )
    assert out.with_suffix(".png").exists()


def test_not_one_member_that_could_be_simulated_has_exit_code_1(case_file, capsys):
    case_file.write_text((RIGID + SOFT).replace("0.012 s", "0.06 s"))
    code, out = sweep(case_file, *DEPTHS)
    assert code == 1
    captured = capsys.readouterr()
    assert "4 of 4: the tool left its path by more than its radius" in captured.out
    assert "not one member could be simulated" in captured.err
    with xarray.open_dataset(out, engine="h5netcdf") as result:
        assert (result["status"] == 2).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--vary", "cut.depht=1:2:3 mm"], "did you mean cut.depth?"),
        (["--vary", "cut.depth"], 'it must be NAME=VALUES, such as "cut.spindle_speed=4000:16000:49 rpm"'),
        (["--vary", "cut.depth="], "it must be NAME=VALUES"),
        (["--vary", "cut.depth=1:2 mm"], "without how many"),
        ([*DEPTHS, *DEPTHS], "--vary cut.depth: given twice"),
        ([*DEPTHS, "--samples", "10"], '"4000:6000 N/mm^2" (uniform'),
        ([*DEPTHS, "--reduce", "mean"], "reduce: 'mean' given; it takes names out of mean_force"),
        ([*DEPTHS, "--cluster", "tcp://127.0.0.1:1"], "--cluster tcp://127.0.0.1:1: no scheduler answers there"),
    ],
)
def test_bad_input_has_exit_code_2_and_leaves_no_file(case_file, capsys, monkeypatch, arguments, words):
    monkeypatch.setattr(_sweep_command, "PATIENCE", "0.5s")
    assert sweep(case_file, *arguments)[0] == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ")
    assert words in message
    assert files(case_file.parent) == {"case.toml"}


def test_an_interrupt_says_how_to_go_on(case_file, capsys, monkeypatch):
    def interrupted(*arguments, **more):
        raise KeyboardInterrupt("4 of 24 members are done and kept in sweep.nc.parts; run the same again to go on")

    monkeypatch.setattr(_sweep_command, "sweep", interrupted)
    assert sweep(case_file, *DEPTHS)[0] == 130
    assert "error: interrupted: 4 of 24 members are done and kept" in capsys.readouterr().err


def test_a_full_disk_has_exit_code_2(case_file, capsys, monkeypatch):
    def full(*arguments, **more):
        raise OSError(28, "No space left on device. 4 of 24 members are done and kept", "sweep.nc")

    monkeypatch.setattr(_sweep_command, "sweep", full)
    assert sweep(case_file, *DEPTHS)[0] == 2
    assert "sweep.nc: No space left on device. 4 of 24" in capsys.readouterr().err


def test_the_command_uses_every_core(case_file):
    """In a process of its own: here JAX has its devices already."""
    code = (
        "import sys; from identification.cli import main; import os, jax; from millax._program import cores\n"
        f"assert main(['sweep', {str(case_file)!r}, '--vary', 'cut.depth=1,2 mm', '--out', sys.argv[1]]) == 0\n"
        "assert jax.device_count() == cores(), jax.device_count()\n"
    )
    run = [sys.executable, "-c", code, str(case_file.parent / "sweep.nc")]
    subprocess.run(run, check=True, cwd=Path(__file__).parents[1], capture_output=True)


def dataset(status, **sizes) -> xarray.Dataset:
    """What a sweep might return."""
    shape = tuple(sizes.values())
    force = np.arange(np.prod(shape) * 3, dtype=float).reshape(*shape, 3) + 1.0
    force[np.broadcast_to(np.asarray(status) != 0, shape)] = np.nan
    force[..., 2] = 0.0
    return xarray.Dataset(
        {
            "mean_force": ((*sizes, "axis"), force, {"units": "N"}),
            "status": (tuple(sizes), np.broadcast_to(status, shape)),
            "peak": (tuple(sizes), force[..., 0] * 1e-6, {"units": "m"}),
            "trace": ((*sizes, "trace_0"), np.zeros((*shape, 7))),
        },
        {name: (name, np.linspace(1, 2, n), {"units": "mm"}) for name, n in sizes.items() if name != "sample"}
        | {"axis": ["x", "y", "z"]},
    )


@pytest.mark.parametrize(
    ("sizes", "panels"),
    [({"cut.depth": 4}, 2), ({"cut.depth": 4, "b": 3}, 3), ({"sample": 4}, 2), ({"a": 4, "b": 3, "c": 5}, 3)],
)
def test_pictures_of_sweeps(sizes, panels):
    status = np.zeros(tuple(sizes.values()))
    status.flat[0] = 2
    figure = plot_sweep(dataset(status, **sizes), ["mean_force", "peak"])
    shown = [axes for axes in figure.axes if axes.axison and axes.get_label() != "<colorbar>"]
    assert len(shown) == panels
    words = " ".join(text.get_text() for axes in figure.axes for text in (axes.xaxis.label, axes.yaxis.label))
    assert "mean force" in words
    assert "peak [µm]" in words
    if "sample" not in sizes:
        assert f"{next(iter(sizes))} [mm]" in words
        marks = [line for axes in shown for line in axes.get_lines() if line.get_marker() == "x"]
        failed = 1 if len(sizes) < 3 else 0  # the middle of the third number has no failed member
        assert len(marks) == failed * len(shown)
    if len(sizes) == 3:
        assert figure.get_suptitle() == "at c = 1.5 mm"


def test_pictures_of_what_cannot_be_drawn():
    with pytest.raises(ValueError, match="trace: it cannot be drawn; choose from mean_force, peak"):
        plot_sweep(dataset(0, a=3), "trace")
