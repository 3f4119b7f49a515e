"""Files of traces: every format gives the same numbers, and no broken file gives wrong ones or another error than ours."""

import csv
import io
import re
import tomllib
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, RootObject, TdmsWriter
from scipy.io import savemat

from identification import Trace, TraceError, load_fit, read_load_test, read_trace

N = 40
TIME = 2.0 + np.arange(N) * 1e-4
FX = np.round(100 * np.sin(np.arange(N)) + 20, 3)
FZ = np.round(30 * np.cos(np.arange(N)) - 7, 3)
LASER = np.round(5 + np.arange(N) ** 1.5, 3)
"""What is in every file: times [s], forces [N] and a displacement [um]."""

COLUMNS = {"time": "Time [s]", "Fx": "-Fz [N]", "x": "laser [um]"}
EXPECTED = np.column_stack([-FZ, LASER * 1e-6])


def rows(*columns, delimiter=",", comma=False):
    lines = [delimiter.join(f"{x:.7g}" for x in row) for row in zip(*columns, strict=True)]
    return "\n".join(line.replace(".", ",") if comma else line for line in lines) + "\n"


def write_csv(path, header="Time [s],Fx [N],Fz [N],laser [um]"):
    path.write_text(f"{header}\n{rows(TIME, FX, FZ, LASER)}", encoding="utf-8")


def dynoware(delimiter=",", comma=False, names="Time,Fx,Fz,laser", units="s,N,N,µm"):
    """The layout of DynoWare's exports."""
    about = [
        ("DynoWare", "Version 2.5.1.2"),
        ("Path:", "C:\\Users\\Jörg\\Desktop\\"),
        ("Filename:", "slot.dwd"),
        ("Manipulated:", "0"),
        ("Date:", " "),
        ("Time:", " "),
        ("Sampling rate [Hz]:", "10000"),
        ("Samples per channel:", "500001"),
    ]
    head = [delimiter.join(row) for row in about] + [names.replace(",", delimiter), units.replace(",", delimiter)]
    return "\n".join(head) + "\n" + rows(TIME, FX, FZ, LASER, delimiter=delimiter, comma=comma)


def write_dynoware(path):
    path.write_bytes(dynoware().replace("\n", "\r\n").encode("cp1252"))


def write_mat(path):
    forces = {"Fx": FX, "Fz": FZ[:, None]}
    savemat(path, {"cut1": {"Time": TIME, "forces": forces, "laser": LASER, "note": "dry"}, "speed": 6000.0})


def write_hdf5(path, **more):
    with h5py.File(path, "w", **more) as file:
        for name, values, unit in (
            ("Time", TIME, "s"),
            ("forces/Fx", FX, "N"),
            ("forces/Fz", FZ, b"N"),
            ("laser", LASER, "um"),
        ):
            file[f"cut1/{name}"] = values
            file[f"cut1/{name}"].attrs["units"] = unit
        file["cut1/note"] = "dry"
        file["cut1/speed"] = 6000.0


def write_mat73(path):
    """HDF5 behind MATLAB's header of 512 bytes, arrays transposed, texts as integers."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("Time", TIME), ("forces/Fx", FX), ("forces/Fz", FZ), ("laser", LASER)):
            file[f"cut1/{name}"] = values[None, :]
            file[f"cut1/{name}"].attrs["MATLAB_class"] = np.bytes_("double")
        file["cut1/note"] = np.frombuffer("dry cut".encode("utf-16-le"), np.uint16)[:, None]
        file["cut1/note"].attrs["MATLAB_class"] = np.bytes_("char")
        file["cut1/none"] = np.array([0, 3], np.uint64)
        file["cut1/none"].attrs["MATLAB_empty"] = 1
        file["#refs#/a"] = FX
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b" " * 8 + b"\x00\x02IM")


def write_tdms(path):
    columns = (("Time", TIME, "s"), ("Fx", FX, "N"), ("Fz", FZ, "N"), ("laser", LASER, "um"))
    channels = [ChannelObject("cut1", name, values, {"unit_string": unit}) for name, values, unit in columns]
    with TdmsWriter(str(path)) as file:
        file.write_segment([RootObject({"operator": "me"}), *channels])


WRITERS = {
    "trace.csv": write_csv,
    "dynoware.csv": write_dynoware,
    "v5.mat": write_mat,
    "v73.mat": write_mat73,
    "trace.h5": write_hdf5,
    "trace.tdms": write_tdms,
}


@pytest.fixture(params=WRITERS)
def file(request, tmp_path):
    path = tmp_path / request.param
    WRITERS[request.param](path)
    return path


# ---- round trips


def test_every_format_gives_the_same_numbers_with_sign_and_unit(file):
    trace = read_trace(file, columns=COLUMNS)
    np.testing.assert_allclose(trace.time, TIME, rtol=1e-12)
    assert trace.channels == ("Fx", "x")
    np.testing.assert_allclose(trace.values, EXPECTED, rtol=1e-12)
    assert (trace.name, trace.units["Fx"]) == (file.name, "N")
    np.testing.assert_allclose(trace.shown("x", trace.values[:, 1]), LASER)


def test_columns_may_leave_time_and_what_the_file_says_out(file):
    told = (
        {"Fx": "Fx", "x": "-laser"}
        if "mat" not in file.name
        else {"time": "cut1/Time [s]", "Fx": "Fx [N]", "x": "-laser[um]"}
    )
    trace = read_trace(file, columns=told, channels=["x"])
    assert trace.channels == ("x",)
    np.testing.assert_allclose(trace.values[:, 0], -LASER * 1e-6)
    np.testing.assert_allclose(trace.time, TIME)


def test_the_extension_does_not_matter_where_the_content_is_clear(file, tmp_path):
    other = tmp_path / "trace.dat"
    other.write_bytes(file.read_bytes())
    np.testing.assert_allclose(read_trace(other, columns=COLUMNS).values, EXPECTED)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"Fx": "Fq [N]", "time": "Time [s]"}, ['no column "Fq" for Fx', "The columns are", "Fz"]),
        ({"Fx": "Fz [kN]", "time": "Time [s]"}, ["Fx is in kN, the file N"]),
        ({"Fx": "Fz [mm]", "time": "Time [s]"}, ["mm is not one of Fx; use [N]"]),
        ({"Fq": "Fz [N]", "time": "Time [s]"}, ["columns: 'Fq' is unknown. Known are time, Fx"]),
        ({"Fx": "-", "time": "Time [s]"}, ["it must be the name of a column"]),
        ({"time": "Time [s]"}, ["there is no channel beside time"]),
    ],
)
def test_columns_that_do_not_fit_are_refused(file, columns, words):
    if "mat" in file.name and "kN" in words[0]:
        columns, words = (
            columns | {"Fx": "Fz"},
            ['has no unit; write Fx [N], or say it: columns = { Fx = "cut1/forces/Fz [N]" }'],
        )
    with pytest.raises(TraceError, match=re.escape(str(file))) as error:
        read_trace(file, columns=columns)
    for word in words:
        assert word in str(error.value)


def test_what_is_asked_for_must_be_told(file):
    with pytest.raises(TraceError, match=r"no column Fy; columns = ... names time, Fx, x"):
        read_trace(file, columns=COLUMNS, channels=["Fx", "Fy"])


# ---- text


@pytest.fixture
def read(tmp_path):
    def read(content, name="trace.csv", **keywords):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
        return read_trace(path, **keywords)

    return read


@pytest.mark.parametrize(
    "header",
    [
        "time [s],Fx [N],Fz [N],x [um]",
        "time (s),Fx (N),Fz (N),x (µm)",
        "Time,Fx,Fz,x\ns,N,N,um",
        "Time,Fx [N],Fz,x\n[s],,(N),[μm]",
        '"time [s]","Fx [N]","Fz [N]","x [um]"',
        '"time\n[s]","Fx\n[N]","Fz [N]","x [um]"',
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_units_stand_in_the_names_or_below_them(read, header, encoding):
    trace = read(f"{header}\n{rows(TIME, FX, FZ, LASER)}".encode(encoding))
    assert trace.channels == ("Fx", "Fz", "x")
    np.testing.assert_allclose(trace.values, np.column_stack([FX, FZ, LASER * 1e-6]), rtol=1e-12)


@pytest.mark.parametrize("delimiter", [";", "\t"])
@pytest.mark.parametrize("comma", [False, True])
@pytest.mark.parametrize("text", [False, True])
def test_semicolons_and_tabs_go_with_points_or_commas(read, delimiter, comma, text):
    header = delimiter.join(["time [s]", "Fx [N]", "x [um]", *(["note"] if text else [])])
    content = rows(TIME, FX, LASER, delimiter=delimiter, comma=comma)
    content = content.replace("\n", f'{delimiter}"o.k."\n') if text else content
    trace = read(f"{header}\n{content}", channels=["Fx", "x"])
    np.testing.assert_allclose(trace.values, np.column_stack([FX, LASER * 1e-6]), rtol=1e-12)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("time [s];Fx [N]\n0,1;1,5\n0,2;1.5\n", ['row 3 has "1.5", row 2 "0,1": points and commas']),
        ("time [s];Fx [N]\n0.1;1.5\n0.2;1.234,5\n", ['row 3 has "1.234,5", row 2 "0.1"']),
        (
            "time [s]\tFx [N]\n1,000\t1,500\n2,000\t1\n",
            ['row 2 has "1,000"', "may be decimal marks or stand between thousands"],
        ),
        ('time [s],Fx [N]\n"0,1","1,5"\n"0,2","2,5"\n', ["row 2, column time: not a finite number"]),
        ("time [s],Fx [N]\n0,1,1,5\n", ["row 2 has 4 cells, the header has 2"]),
        ("time [s];Fx [N]\n0.1,1.5\n", ["row 2 has 1 cells, the header has 2"]),
        ("time [s],Fx [N]\n0.1,1_000\n0.2,2\n", ["row 2, column Fx: not a finite number"]),
        ("time [s],Fx [N]\ns,kN\n0.1,2\n", ['column 2 "Fx [N]": the row of units says kN']),
        ("time,Fx\ns,blob\n0.1,2\n", ['column 2 "Fx": the unit blob is not one of Fx']),
        ("time,Fx\ns,-\n0.1,2\n", ['column 2 "Fx" has no unit; write Fx [N]']),
        ('time [s],Fx [N]\n0.1,"2\n', ["not a CSV file", "unexpected end"]),
        ("time [s],Fx [N]," + "x" * 200_000 + "\n0.1,2,3\n", ["not a CSV file", "field larger than field limit"]),
        ("time [s],Fx [N],x [µm]\n0,1,2\n".encode("latin-1"), ["not a text file in UTF-8"]),
        (b"time [s],Fx [N]\n\0\0,1\n", ["not a text file in UTF-8: it has zero bytes"]),
    ],
)
def test_text_in_doubt_is_refused(read, content, words):
    with pytest.raises(TraceError, match=r"trace\.csv: ") as error:
        read(content)
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize(("delimiter", "comma"), [(",", False), (";", True), ("\t", True), ("\t", False)])
@pytest.mark.parametrize("encoding", ["utf-8", "cp1252", "utf-16"])
def test_dynoware_in_any_locale(read, delimiter, comma, encoding):
    trace = read(dynoware(delimiter, comma, "Time,Fx,Fz,x").encode(encoding))
    assert trace.units == {"Fx": "N", "Fz": "N", "x": "µm"}
    np.testing.assert_allclose(trace.values, np.column_stack([FX, FZ, LASER * 1e-6]), rtol=1e-12)


def test_dynoware_rows_are_counted_as_in_the_file(read):
    lines = dynoware(names="Time,Fx,Fz,x").split("\n")
    lines[14] = lines[14].replace(lines[14].split(",")[1], "OVERLOAD")
    with pytest.raises(TraceError, match="row 15, column Fx: not a finite number"):
        read("\n".join(lines))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("Time,", "t,", "no row of names, which begins with Time"),
        ("DynoWare,Version", "DynoWare Version", "not a DynoWare export"),
        ("s,N,N", "s,mV,N", "the unit mV is not one of Fx"),
        ("\n", "", "no row of names"),
    ],
)
def test_what_only_looks_like_dynoware_is_refused(read, old, new, words):
    with pytest.raises(TraceError, match=words):
        read(dynoware().replace(old, new) + "\n")


# ---- arrays


@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize("name", ["a.mat", "a.h5"])
def test_a_channel_of_an_array(tmp_path, name, transposed):
    forces = np.column_stack([FX, FZ])
    forces = forces.T if transposed else forces
    if name == "a.mat":
        savemat(tmp_path / name, {"forces": forces, "K": np.eye(3)})
    else:
        with h5py.File(tmp_path / name, "w") as file:
            file["forces"], file["K"] = forces, np.eye(3)
    trace = read_trace(tmp_path / name, columns={"Fx": "forces[0] [kN]", "Fy": "-forces[1] [N]"}, rate="10 kHz")
    np.testing.assert_allclose(trace.values, np.column_stack([1e3 * FX, -FZ]))
    np.testing.assert_allclose(trace.time, np.arange(N) * 1e-4, atol=1e-15)
    with pytest.raises(TraceError, match=r"The columns are forces\[0\], forces\[1\]$"):
        read_trace(tmp_path / name, columns={"Fx": "forces [N]"})


def waveform(path, name="Fx", start=0.5, step=1e-4, values=FX, mode="w", **more):
    properties = {"wf_increment": step, "wf_start_offset": start, "unit_string": "N"} | more
    with TdmsWriter(str(path), mode=mode) as file:
        file.write_segment([ChannelObject("force", name, values, properties)])


def test_a_waveform_states_its_times(tmp_path):
    waveform(tmp_path / "a.tdms")
    trace = read_trace(tmp_path / "a.tdms")
    np.testing.assert_allclose(trace.time, 0.5 + np.arange(N) * 1e-4)
    np.testing.assert_allclose(trace.values[:, 0], FX)


@pytest.mark.parametrize(
    ("other", "keywords", "words"),
    [
        ({"step": 2e-4}, {}, "the times of column Fy are not those of Fx"),
        ({"wf_start_time": np.datetime64("2026-01-01T00:00:00")}, {}, "the times of column Fy are not those of Fx"),
        ({"values": FX[:30]}, {}, 'column "force/Fy" has 30 samples, column "force/Fx" 40'),
        ({}, {"rate": "10 kHz"}, "the file states a step of 0.0001 s; leave rate out"),
    ],
)
def test_waveforms_that_do_not_belong_together_are_refused(tmp_path, other, keywords, words):
    waveform(tmp_path / "a.tdms")
    waveform(tmp_path / "a.tdms", **{"name": "Fy"} | other, mode="a")
    with pytest.raises(TraceError, match=words):
        read_trace(tmp_path / "a.tdms", **keywords)


def test_a_step_that_is_none_is_refused(tmp_path):
    waveform(tmp_path / "a.tdms", step=0.0)
    with pytest.raises(TraceError, match="a step of 0 s"):
        read_trace(tmp_path / "a.tdms")


def test_levels_tell_columns_of_one_name_apart(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for cut, scale in (("cut1", 1), ("cut2", 2)):
            file[f"{cut}/Fx"] = scale * FX
            file[f"{cut}/Fx"].attrs["unit"] = "N"
    assert read_trace(tmp_path / "a.h5", columns={"Fx": "cut2/Fx"}, rate=1e4).values[1, 0] == 2 * FX[1]
    with pytest.raises(TraceError, match=r'column "cut2/Fx" is there twice, first as column "cut1/Fx"; keep one, or say it'):
        read_trace(tmp_path / "a.h5", rate=1e4)
    with pytest.raises(TraceError, match=r'"Fx" is there more than once, as column "cut1/Fx", column "cut2/Fx"; say which'):
        read_trace(tmp_path / "a.h5", columns={"Fx": "Fx"}, rate=1e4)


def test_packed_numbers_are_not_taken_as_they_are(tmp_path):
    write_hdf5(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file["cut1/forces/Fz"].attrs["scale_factor"] = 0.1
    with pytest.raises(TraceError, match='"/cut1/forces/Fz" is packed: it has the attribute scale_factor'):
        read_trace(tmp_path / "a.h5", columns=COLUMNS)
    assert read_trace(tmp_path / "a.h5", columns={"Fx": "Fx"}).channels == ("Fx",)


def test_a_name_that_is_not_in_utf8_does_no_harm(tmp_path):
    write_hdf5(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file["größe".encode("latin-1")] = FX
    assert read_trace(tmp_path / "a.h5", columns=COLUMNS).samples == N
    with pytest.raises(TraceError, match=r"The columns are .*gr\ufffd"):
        read_trace(tmp_path / "a.h5", columns={"Fx": "Fq"})


def test_of_two_variables_of_one_name_neither_is_taken(tmp_path):
    savemat(tmp_path / "a.mat", {"Fx": FX})
    twice = (tmp_path / "a.mat").read_bytes()
    savemat(tmp_path / "b.mat", {"Fx": 2 * FX})
    (tmp_path / "a.mat").write_bytes(twice + (tmp_path / "b.mat").read_bytes()[128:])
    with pytest.raises(TraceError, match=r'a\.mat: not a MAT file that can be read \(Duplicate variable name "Fx"'):
        read_trace(tmp_path / "a.mat", columns={"Fx": "Fx [N]"}, rate=1e4)


# ---- format, rate, resample


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"format": "dinoware"}, "format 'dinoware' is unknown. Did you mean dynoware? Known are csv, dynoware, mat"),
        ({"format": "mat"}, "not a MAT file that can be read"),
        ({"format": "hdf5"}, "not an HDF5 file that can be read"),
        ({"format": "tdms"}, "not a TDMS file that can be read"),
        ({"format": "dynoware"}, "not a DynoWare export"),
        ({"rate": "10 kHz"}, "the file has a column of times; leave rate out"),
    ],
)
def test_a_file_that_is_not_what_is_said_is_refused(tmp_path, keywords, words):
    write_csv(tmp_path / "trace.csv")
    with pytest.raises(TraceError, match=re.escape(f"{tmp_path / 'trace.csv'}: ")) as error:
        read_trace(tmp_path / "trace.csv", columns=COLUMNS, **keywords)
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("rate", "words"),
    [
        (None, "no column time; add it"),
        ("0 Hz", "must be greater than 0"),
        ("600 rpm", "cannot be converted to Hz"),
        (-5, "greater"),
    ],
)
def test_a_file_without_times_needs_a_rate(read, rate, words):
    with pytest.raises(ValueError, match=words):
        read(f"Fx [N],x [um]\n{rows(FX, LASER)}", rate=rate)
    assert read(f"Fx [N],x [um]\n{rows(FX, LASER)}", rate="10 kHz", window=["1 ms", "2 ms"]).samples == 11


def uneven(*, jitter=0.0, lost=(), n=400):
    rng = np.random.default_rng(0)
    time = np.delete(np.arange(n) * 1e-4, lost)
    return time + 1e-4 * jitter * rng.uniform(-1, 1, len(time))


@pytest.mark.parametrize("time", [uneven(jitter=0.2), uneven(lost=(50, 51, 52)), uneven(jitter=0.1, lost=(7, 99, 100))])
def test_uneven_times_are_interpolated_on_request(read, time):
    content = "time [s],Fx [N],x [um]\n" + "".join(f"{t:.9g},{np.sin(300 * t):.9g},{1 + 2 * t:.9g}\n" for t in time)
    with pytest.raises(TraceError, match="resample = true"):
        read(content)
    trace = read(content, resample=True)
    assert np.ptp(np.diff(trace.time)) < 1e-12
    assert abs(trace.step / 1e-4 - 1) < 0.02
    assert time[-1] - trace.step < trace.time[-1] <= time[-1] + 1e-12
    np.testing.assert_allclose(trace.values[:, 1], (1 + 2 * trace.time) * 1e-6, rtol=1e-7)
    np.testing.assert_allclose(trace.values[:, 0], np.sin(300 * trace.time), atol=(300 * 4e-4) ** 2 / 8 * 1.1)


def test_even_times_are_left_alone_and_long_gaps_refused(read):
    content = "time [s],Fx [N]\n" + rows(TIME, FX)
    np.testing.assert_array_equal(read(content, resample=True).values, read(content).values)
    time = uneven(lost=(50, 51, 52, 53))
    with pytest.raises(TraceError, match=r"row 52, column time: a step of 0\.0005 s .* over three lost samples at most"):
        read("time [s],Fx [N]\n" + rows(time, 1 + time), resample=True)
    with pytest.raises(TraceError, match="sort the samples"):
        read("time [s],Fx [N]\n" + rows(TIME[::-1], FX), resample=True)


# ---- case files


CASE = Path(__file__).parents[1] / "docs" / "cases" / "kr240_1dof.toml"


def case_with(folder, keys):
    (folder / "case.toml").write_text(f'{CASE.read_text()}\n[fit.free]\nforce.k0 = {{}}\n[[trace]]\nfile = "a.h5"\n{keys}\n')
    return folder / "case.toml"


def test_a_case_file_says_how_a_file_is_read(tmp_path):
    time = uneven(lost=(50,))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"], file["F"] = time, 1 + time
    keys = 'format = "hdf5"\ncolumns = { time = "t [s]", Fx = "-F [kN]" }\nresample = true'
    (trace,) = load_fit(case_with(tmp_path, keys)).traces
    assert isinstance(trace, Trace)
    np.testing.assert_allclose(trace.values[:, 0], -1e3 * (1 + trace.time))
    keys = 'columns = { Fx = "F [N]" }\nrate = "10 kHz"'
    assert load_fit(case_with(tmp_path, keys)).traces[0].samples == 399


def test_the_example_of_the_readme_reads_an_export_of_dynoware(tmp_path):
    readme = (CASE.parents[2] / "README.md").read_text(encoding="utf-8")
    (keys,) = re.findall(r"(?m)^ *(columns = .*)$", readme)
    (tmp_path / "slot.csv").write_text(dynoware(names="Time,Fx,Fy,laser", units="s,N,N,"), encoding="utf-8")
    trace = read_trace(tmp_path / "slot.csv", **tomllib.loads(keys))
    np.testing.assert_allclose(trace.values[:, 0], -FZ)
    assert trace.channels == ("Fx", "Fy", "x")


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ('colums = { Fx = "F" }', "unknown key colums. Did you mean columns?"),
        ('columns = ["Fx"]', 'columns = ["Fx"] given; it must be a table'),
        ("format = 5", "format = 5 given; it must be a word"),
        ('resample = "yes"', 'resample = "yes" given; it must be true or false'),
        ("columns = { Fx = 5 }", "it must be the name of a column"),
    ],
)
def test_keys_that_do_not_fit_are_refused(tmp_path, keys, words):
    write_hdf5(tmp_path / "a.h5")
    with pytest.raises(ValueError, match=re.escape(words)):
        load_fit(case_with(tmp_path, keys))


# ---- bad input


def refusal(path, reader=read_trace, **keywords):
    """What is read, and the words in which it is refused: one of them None."""
    try:
        return reader(path, **keywords), None
    except TraceError as error:
        return None, str(error)


def checked(path, content, expected=EXPECTED, **keywords):
    """Read `content`: refused in our words, or read, and then each sample is the right one. Returns the trace."""
    path.write_bytes(content)
    trace, words = refusal(path, **keywords)
    if words is not None:
        assert words.startswith(f"{path}: ")
        assert len(words) < 6000
    elif expected is not None:
        index = np.round((trace.time - TIME[0]) / 1e-4).astype(int)
        np.testing.assert_allclose(trace.values, expected[index], rtol=1e-9)
    return trace


bounded = settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


@bounded
@given(at=st.floats(0, 1))
def test_a_truncated_file_is_read_correctly_or_refused(file, at):
    content = file.read_bytes()
    kept = content[: int(at * len(content))]
    if file.name == "trace.csv":
        # The last row of a CSV file need not have an end: whether a number was cut short there cannot be seen.
        kept = kept[: kept.rfind(b"\n") + 1] + (kept[kept.rfind(b"\n") + 1 :].rpartition(b",")[0])
    checked(file.with_name(f"cut_{file.name}"), kept, columns=COLUMNS)


@bounded
@given(at=st.floats(0, 1), junk=st.binary(min_size=1, max_size=50))
def test_junk_in_the_head_is_no_other_error(file, at, junk):
    content = file.read_bytes()
    position = int(at * min(len(content), 600))
    checked(file.with_name(f"junk_{file.name}"), content[:position] + junk, None, columns=COLUMNS)


@bounded
@given(
    content=st.binary(max_size=200),
    head=st.sampled_from([b"", b"TDSm", b"\x89HDF\r\n\x1a\n", b"MATLAB 5.0", b"\xff\xfe", b"DynoWare,"]),
)
@pytest.mark.parametrize("name", ["a.csv", "a.mat", "a.h5", "a.tdms"])
def test_random_bytes_are_refused(tmp_path, name, content, head):
    assert checked(tmp_path / name, head + content) is None


cells = st.one_of(
    st.sampled_from(
        ["", "nan", "-", "1e400", "1,5", "1.5", "1.234,5", "1,234", "0x10", "1_000", '"', "s", "N", "٣", "\u2028"]
    ),
    st.floats().map(str),
    st.text(max_size=8),
)
names = st.one_of(
    st.sampled_from(["time [s]", "Time", "Fx [N]", "Fx", "x (um)", "x [µm]", "Fx [blob]", "[N]"]), st.text(max_size=12)
)


@settings(bounded, max_examples=150)
@given(
    header=st.lists(names, max_size=5),
    body=st.lists(st.lists(cells, max_size=5), max_size=6),
    delimiter=st.sampled_from(",;\t"),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "latin-1"]),
    above=st.sampled_from(["", "DynoWare,Version 2\n", "DynoWare;Version 2\nTime;Fx\n", "\n", "\ufeff"]),
)
def test_any_table_is_read_or_refused_in_our_words(tmp_path, header, body, delimiter, encoding, above):
    lines = [delimiter.join(row) for row in [header, *body]]
    content = (above + "\n".join(lines) + "\n").encode(encoding, errors="replace")
    checked(tmp_path / "a.csv", content, None)
    _, words = refusal(tmp_path / "a.csv", read_load_test)
    assert words is None or words.startswith(f"{tmp_path / 'a.csv'}: ")


@settings(bounded, max_examples=60)
@given(
    cut=st.integers(0, N - 1),
    where=st.integers(0, 2),
    cell=cells.filter(lambda cell: "\n" not in cell and "\r" not in cell),
    delimiter=st.sampled_from(",;\t"),
    comma=st.booleans(),
)
def test_one_odd_cell_is_found_or_is_what_it_says(tmp_path, cut, where, cell, delimiter, comma):
    header = delimiter.join(["time [s]", "Fx [N]", "x [um]"])
    table = [[f"{x:.7g}" for x in row] for row in zip(TIME, FX, LASER, strict=True)]
    if comma and delimiter != ",":
        table = [[x.replace(".", ",") for x in row] for row in table]
    table[cut][where] = cell
    text = "\n".join([header, *(delimiter.join(row) for row in table)]) + "\n"
    trace = checked(tmp_path / "a.csv", text.encode("utf-8", errors="replace"), None)
    if trace is not None:
        expected = np.column_stack([FX, LASER * 1e-6])
        changed = ~np.isclose(trace.values, expected, rtol=1e-9)
        assert changed.sum() <= 1
        if changed.any():
            plain = next(iter(csv.reader(io.StringIO(cell), delimiter=delimiter)))[0]
            number = float(plain.strip().replace(",", ".") if comma and delimiter != "," else plain)
            np.testing.assert_allclose(trace.values[changed], number * (1e-6 if where == 2 else 1), rtol=1e-9)


@settings(bounded, max_examples=20)
@given(n=st.integers(1, 3000), name=st.sampled_from(["Fx [N]", "Fx", "µ", "time [s]", "x" * 300]))
def test_huge_headers_and_duplicate_columns_are_refused_in_few_words(tmp_path, n, name):
    header = ",".join(["time [s]", "Fx [N]", *[name] * n])
    row = ",".join(["1"] * (n + 2))
    assert checked(tmp_path / "a.csv", f"{header}\n{row}\n{row}\n".encode()) is None
    assert checked(tmp_path / "b.csv", f"{header}\n{row}\n{row}\n".encode(), columns={"Fx": "Fq"}) is None


def test_what_only_a_trace_can_tell_names_the_path_too(tmp_path):
    words = f"^{re.escape(str(tmp_path / 'a.csv'))}: channel Fx is zero throughout"
    (tmp_path / "a.csv").write_text("time [s],Fx [N]\n0,0\n1,0\n")
    with pytest.raises(TraceError, match=words):
        read_trace(tmp_path / "a.csv")


def test_empty_files_are_refused(tmp_path):
    for name in WRITERS:
        assert checked(tmp_path / name, b"") is None
    with pytest.raises(TraceError, match="the trace cannot be read: Is a directory"):
        read_trace(tmp_path)
    with h5py.File(tmp_path / "none.h5", "w") as file:
        file["K"] = np.eye(3)
    with pytest.raises(TraceError, match="the file is empty; there is no array of samples"):
        read_trace(tmp_path / "none.h5")
