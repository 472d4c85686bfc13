"""Files as instruments write them, as measured records that the command reads."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from metasense import records
from metasense.records import RecordsError, convert, read

tomllib = pytest.importorskip("tomllib")
RATE = 100.0
N = 51
ORDER = ["f", "ax", "ay", "w"]


@pytest.fixture(scope="module")
def truth() -> dict[str, np.ndarray]:
    """A clock (s), a force, and three signals that are no round numbers."""
    rng = np.random.default_rng(11)
    time = np.arange(N) / RATE
    force = np.where((time > 0.1) & (time < 0.2), np.sin((time - 0.1) * 10 * np.pi), 0.0) + 1e-3 * rng.normal(size=N)
    return {"t": time, "f": force, **{name: rng.normal(size=N) for name in ORDER[1:]}}


def table(truth, delimiter=",", decimal=".", names=("t", *ORDER), quote="", time=None) -> str:
    cells = [time or [repr(float(x)) for x in truth["t"]]] + [[repr(float(x)) for x in truth[name]] for name in ORDER]
    rows = [delimiter.join(quote + cell.replace(".", decimal) + quote for cell in row) for row in zip(*cells)]
    return "\n".join([delimiter.join(names), *rows, ""])


def loaded(toml: Path) -> list[dict[str, np.ndarray]]:
    files = tomllib.loads(toml.read_text(encoding="utf-8"))["recorded"]["files"]
    return [dict(np.load(toml.with_name(name))) for name in files]


def check(toml: Path, truth, time_error: float = 1e-15) -> None:
    [held] = loaded(toml)
    assert np.abs(held["time"] - truth["t"]).max() <= time_error
    assert np.array_equal(held["force"], truth["f"][None])
    assert np.array_equal(held["signals"], np.stack([truth[name] for name in ORDER[1:]], axis=1)[None])


PICK = {"time": "t", "force": "f", "signals": ["ax", "ay", "w"]}
NUMBERS = {"time": 0, "force": 1, "signals": [2, 3, 4]}


@pytest.mark.parametrize(
    ("delimiter", "decimal", "quote"),
    [
        (",", ".", ""),
        (";", ".", ""),
        (";", ",", ""),
        ("\t", ".", ""),
        ("\t", ",", ""),
        (",", ".", '"'),
        (",", ",", '"'),
        (" ", ".", ""),
        ("|", ",", ""),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le"])
def test_delimiters_decimal_marks_quotes_and_encodings_are_found(truth, tmp_path, delimiter, decimal, quote, encoding):
    file = tmp_path / "a.CSV"
    file.write_bytes(table(truth, delimiter, decimal, quote=quote).replace("\n", "\r\n").encode(encoding))
    check(convert(file, tmp_path / "r.npz", **PICK)[0], truth)


PREAMBLES = {
    "comment": "# made by me\n",
    "apart": "Operator,M,of,this,rig\n\n",
    "meta": "Device: WT901\nRate,100 Hz\n\n",
    "numbers": "Version;2\nRate;2048\nChannels;4\nBits;16\n\n",
    "excel": "sep=,\n",
}


LVM = """LabVIEW Measurement\t
Separator\tTab
Date\t2026/10/02
Time\t07:48:45.123
***End_of_Header***\t
\t
Channels\t4\t\t\t\t
Samples\t60\t60\t60\t60\t
X0\t0.0\t0.0\t0.0\t0.0\t
Delta_X\t0.01\t0.01\t0.01\t0.01\t
***End_of_Header***\t\t\t\t\t
"""
WRITTEN = {
    "labview": lambda truth: LVM + table(truth, "\t").replace("w\n", "w\tComment\n"),
    "delimiter at the end": lambda truth: "".join(
        line + ",\n" * (n > 0) + "\n" * (n == 0) for n, line in enumerate(table(truth).splitlines())
    ),
    "text with another delimiter": lambda truth: "\n".join(
        f"{'name' if n == 0 else 'sensor 1, left'};{line}" for n, line in enumerate(table(truth, ";").splitlines())
    ),
    "minus sign": lambda truth: table(truth).replace("-", "\u2212"),
    "blank lines and a footer": lambda truth: table(truth).replace("\n", "\r\r") + "End of data",
    "names in a comment": lambda truth: "# exported\n# " + table(truth),
    "aligned": lambda truth: table(truth, ",").replace(",", "    "),
    "blanks after delimiters": lambda truth: table(truth, ",").replace(",", ", "),
    "milliseconds": lambda truth: table(truth, time=[str(10 * n) for n in range(N)]).replace("t,f", "t (ms),f"),
    "units below": lambda truth: table(truth, ";", time=[str(10 * n) for n in range(N)]).replace("w\n", "w\nms;N;g;g;dps\n"),
    "separate date": lambda truth: "\n".join(
        ("date;" if n == 0 else "2026-10-02;") + line
        for n, line in enumerate(table(truth, ";", time=stamps(STAMPS["clock"])).splitlines())
    ),
}


@pytest.mark.parametrize("write", WRITTEN.values(), ids=WRITTEN)
def test_tables_are_read_as_instruments_write_them(truth, tmp_path, write):
    (tmp_path / "a.csv").write_bytes(write(truth).encode())
    pick = {**PICK, "time": "X_Value"} if "X_Value" in write(truth) else PICK
    check(convert(tmp_path / "a.csv", tmp_path / "r.npz", **pick)[0], truth)


def test_digits_in_groups_have_one_meaning_with_a_decimal_mark(tmp_path):
    (tmp_path / "a.csv").write_text("t;f\n" + "".join(f"{n};1.{n:03}.250,5\n" for n in range(9)))
    [held] = loaded(convert(tmp_path / "a.csv", tmp_path / "r.npz", time="t", force="f")[0])
    assert np.array_equal(held["force"][0], [1_000_250.5 + 1000 * n for n in range(9)])


@pytest.mark.parametrize("preamble", PREAMBLES.values(), ids=PREAMBLES)
def test_a_preamble_is_left_out(truth, tmp_path, preamble):
    (tmp_path / "a.csv").write_text(preamble + table(truth))
    check(convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK)[0], truth)


def test_columns_are_chosen_in_any_language_or_by_number(truth, tmp_path):
    names = ["时间(s)", "力 (kN)", "加速度X(g)", "Beschleunigung [g]", "角速度(°/s)"]
    (tmp_path / "a.csv").write_bytes(table(truth, names=names).encode("gb18030"))
    with pytest.raises(RecordsError, match=r"a.csv: line 1: byte .* pass encoding .*gb18030"):
        convert(tmp_path / "a.csv", tmp_path / "r.npz", **NUMBERS)
    toml, notes = convert(
        tmp_path / "a.csv", tmp_path / "r.npz", encoding="gb18030", time=0, force="力", signals=["加速度x", "Beschleunigung", 4]
    )
    check(toml, truth)
    said = tomllib.loads(toml.read_text())
    assert said["recorded"]["force_unit"] == "kN" and not notes
    assert (said["signals"]["acceleration_unit"], said["signals"]["angular_velocity_unit"]) == ("g", "deg/s")
    (tmp_path / "b.csv").write_text("\n".join(table(truth).splitlines()[1:]))
    toml, notes = convert(tmp_path / "b.csv", tmp_path / "r.npz", **NUMBERS)
    check(toml, truth)
    assert [note.split()[0] for note in notes] == ["force_unit", "acceleration_unit", "angular_velocity_unit"]


def test_an_offset_of_the_force_is_noted(truth, tmp_path):
    for level, count in [(0.0, 0), (0.3, 1)]:
        (tmp_path / "a.csv").write_text(table({**truth, "f": truth["f"] + level}))
        toml, notes = convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK)
        assert sum("set remove_offset = true below [recorded] in r.toml" in note for note in notes) == count, notes
        assert np.array_equal(loaded(toml)[0]["force"][0], truth["f"] + level)


def test_a_line_of_units_below_the_names_is_read(truth, tmp_path):
    lines = table(truth, ";").splitlines()
    (tmp_path / "a.csv").write_text("\n".join([lines[0], "(s);(N);(m/s²);(m/s²);(rad/s)", *lines[1:]]))
    toml, _ = convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK)
    check(toml, truth)
    assert tomllib.loads(toml.read_text())["signals"]["acceleration_unit"] == "m/s2"


def stamps(form: str) -> list[str]:
    milliseconds = [47_995 + 10 * n for n in range(N)]  # passes a full minute
    return [form.format(h=7, m=ms // 60_000, s=ms % 60_000 // 1000, ms=ms % 1000) for ms in milliseconds]


STAMPS = {
    "iso": "2026-10-02T{h:02}:{m:02}:{s:02}.{ms:03}Z",
    "witmotion": "2026-10-02 {h:02}:{m:02}:{s:02}.{ms:03}",
    "colon": "2026-10-2 {h}:{m:02}:{s:02}:{ms:03}",
    "german": "02.10.2026 {h:02}:{m:02}:{s:02},{ms:03}",
    "american": "10/02/2026 {h}:{m:02}:{s:02}.{ms:03} AM",
    "clock": "{h:02}:{m:02}:{s:02}.{ms:03}",
    "nanoseconds": "2026-10-02 {h:02}:{m:02}:{s:02}.{ms:03}000000",
}


@pytest.mark.parametrize("form", STAMPS.values(), ids=STAMPS)
def test_time_stamps_are_clocks(truth, tmp_path, form):
    (tmp_path / "a.csv").write_text(table(truth, ";", time=stamps(form)))
    check(convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK)[0], truth, 1e-15)


@pytest.mark.parametrize(("unit", "digits"), [("s", 3), ("ms", 0), ("us", -3), ("ns", -6)])
def test_ticks_since_an_epoch_are_exact(truth, tmp_path, unit, digits):
    ticks = [1_790_000_000_000 + 10 * n for n in range(N)]
    text = [f"{t / 1000:.3f}" if unit == "s" else str(t * 10**-digits) for t in ticks]
    (tmp_path / "a.csv").write_text(table(truth, time=text))
    check(convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK)[0], truth, 1e-15)


def test_midnight_passes_and_dates_place_the_clocks_of_two_files(truth, tmp_path):
    clock = [f"{'23:59:59' if n < 20 else '00:00:00'}.{(800 + 10 * n) % 1000:03}" for n in range(N)]
    (tmp_path / "a.csv").write_text(table(truth, time=clock))
    check(convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK)[0], truth)
    (tmp_path / "f.csv").write_text(table(truth, time=stamps(STAMPS["iso"])))
    later = [f"2026-10-02 07:00:{48 + (15 + 10 * n) // 1000}.{(15 + 10 * n) % 1000:03}" for n in range(N)]
    (tmp_path / "s.csv").write_text(table(truth, "\t", time=later))
    [held] = loaded(convert(tmp_path / "f.csv", tmp_path / "r.npz", signal_files=[tmp_path / "s.csv"], **PICK)[0])
    assert np.abs(held["signal_time"] - held["time"] - 0.020).max() < 1e-12
    (tmp_path / "s.csv").write_text(table(truth, "\t"))
    with pytest.raises(RecordsError, match="s.csv: its clock is of the kind 'relative'.*signal_start"):
        convert(tmp_path / "f.csv", tmp_path / "r.npz", signal_files=[tmp_path / "s.csv"], **PICK)
    [held] = loaded(
        convert(tmp_path / "f.csv", tmp_path / "r.npz", signal_files=[tmp_path / "s.csv"], signal_start=0.25, **PICK)[0]
    )
    assert np.abs(held["signal_time"] - truth["t"] - 0.25).max() < 1e-12


def test_a_witmotion_log_is_read(truth, tmp_path):
    names = "time\tDeviceName\tChipTime()\tAccX(g)\tAccY(g)\tAsZ(°/s)\t"
    rows = zip(stamps(STAMPS["witmotion"]), *(truth[name] for name in ORDER[1:]))
    lines = [f"{t}\tWT901BLE(F1:2C:00:11:22:33)\tnull\t{float(x)!r}\t{float(y)!r}\t{float(w)!r}\t" for t, x, y, w in rows]
    (tmp_path / "s.txt").write_bytes("\r\n".join([names, *lines, ""]).encode("utf-8-sig"))
    (tmp_path / "f.csv").write_text(table(truth))
    pick = {"force": "f", "time": "t", "signals": ["AccX", "AccY", "AsZ"], "signal_files": [tmp_path / "s.txt"]}
    toml, _ = convert(tmp_path / "f.csv", tmp_path / "r.npz", **pick, signal_rate=RATE)
    check(toml, truth)
    assert tomllib.loads(toml.read_text())["signals"] == {
        "channels": ["signals"], "time": "signal_time", "acceleration_unit": "g", "angular_velocity_unit": "deg/s"
    }  # fmt: skip


REFUSED = {
    "columns": (lambda text: text, {"force": "Kraft"}, "has no column 'Kraft'; choose by number or name from: 0 't', 1 'f'"),
    "twice": (lambda text: text.replace("t,f,ax", "t,f,f"), {}, "has 2 columns 'f': choose one by its number"),
    "empty": (lambda text: text.replace("\n0.25,", "\n0.25, ").replace("0.3,", ","), {}, "'t' is empty .*empty=\"skip\""),
    "again": (lambda text: text + text, {}, "contains 2 tables, from lines 2, 54: pass table"),
    "clock": (lambda text: text.replace("\n0.25,", "\n0.24,"), {}, r"line 27: 't' = '0.24' is not later .*: pass rate"),
    "text": (lambda text: text.replace("\n0.25,", "\n0.25x,"), {}, r"line 27: 't' = '0.25x' is not a number"),
    "binary": (lambda text: "PK" + chr(0) + text, {}, "is neither text nor MATLAB.*export it as CSV"),
    "spreadsheet": (lambda text: "PK\3\4" + text, {}, "export a spreadsheet as CSV"),
    "no table": (lambda _: "nothing\nhere\n", {}, "contains no table .* pass delimiter, decimal, skip or comment"),
    "no clock": (lambda text: text, {"time": None}, r"pass time \(a column\) or rate"),
    "force as signal": (lambda text: text, {"signals": ["f", "ax", "ay"]}, "'f' is chosen as force and as signal"),
    "signal twice": (lambda text: text, {"signals": ["ax", 2, "w"]}, "'ax' is read twice"),
    "force twice": (lambda text: text, {"force": ["f", "f"]}, "'f' is read twice"),
    "never": (lambda text: text, {"trigger": 7.0, "length": 0.1}, "trigger = 7.0: the force never reaches it; its peak"),
    "unit": (lambda text: text, {"force_unit": "lbf"}, "force_unit = 'lbf': must be one of N, mN, kN"),
    "nothing": (lambda _: "", {}, "a.csv: is empty"),
    "blank lines": (lambda _: "\n \n", {}, "a.csv: is empty"),
    "comments": (lambda _: "# t,f\n# 0,1\n", {}, "a.csv: contains no lines but comments"),
    "one row": (
        lambda text: "\n".join(line if n < 2 else line.split(",")[0] + ",,,," for n, line in enumerate(text.splitlines())),
        {"empty": "skip"},
        r"columns \['f', 't'\] have values together in 1 of 51 rows",
    ),
    "pattern": (lambda text: text, {"panel_pattern": "P("}, r"panel_pattern = 'P\(': is no regular expression"),
    "no signals": (lambda text: text, {"signals": None, "signal_files": ["s.csv"]}, r"signal_files: pass signals"),
    "count": (lambda text: text, {"signal_files": "s.csv", "signals": "ax"}, r"s.csv: cannot be read"),
}


@pytest.mark.parametrize(("change", "options", "message"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_read_names_file_place_and_option(truth, tmp_path, change, options, message):
    (tmp_path / "a.csv").write_text(change(table(truth)))
    with pytest.raises(RecordsError, match=message):
        convert(tmp_path / "a.csv", tmp_path / "r.npz", **{**PICK, **options})


def test_what_has_two_meanings_is_refused_and_read_with_the_option(truth, tmp_path):
    commas = "t,f\n" + "".join(f"0,{n:02},{n},{n}{n % 7}\n" for n in range(10, 60))
    (tmp_path / "a.csv").write_text(commas)
    with pytest.raises(RecordsError, match='decimal commas between commas.*delimiter="," and decimal=","'):
        convert(tmp_path / "a.csv", tmp_path / "r.npz", time="t", force="f")
    [held] = loaded(convert(tmp_path / "a.csv", tmp_path / "r.npz", time="t", force="f", delimiter=",", decimal=",")[0])
    assert held["time"][3] == 0.13 and held["force"][0, 3] == 13.136
    thousands = "t;f\n" + "".join(f"{n};{n + 1},25{n % 10}\n" for n in range(50))
    (tmp_path / "a.csv").write_text(thousands)
    with pytest.raises(RecordsError, match="may have a decimal comma or thousands: pass decimal"):
        convert(tmp_path / "a.csv", tmp_path / "r.npz", time="t", force="f")
    [held] = loaded(convert(tmp_path / "a.csv", tmp_path / "r.npz", time="t", force="f", decimal=",")[0])
    assert held["force"][0, 7] == 8.257
    slashes = table(truth, time=[f"0{2 + n // 40}/10/2026 23:59:59.{(400 + 10 * n) % 1000:03}" for n in range(N)])
    (tmp_path / "a.csv").write_text(slashes)
    with pytest.raises(RecordsError, match="day and month in either order: pass time_format"):
        convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK)
    (tmp_path / "a.csv").write_text("0,1,2\n" + "".join(f"{n}.5,{n * n},1\n" for n in range(9)))
    with pytest.raises(RecordsError, match="may be names or values: pass skip"):
        convert(tmp_path / "a.csv", tmp_path / "r.npz", time=0, force=1)
    for skip, count in [(0, 10), (1, 9)]:
        [held] = loaded(convert(tmp_path / "a.csv", tmp_path / "r.npz", time=0, force=1, skip=skip)[0])
        assert held["force"].shape == (1, count)
    (tmp_path / "a.csv").write_text("".join(f"{n},{n * n}\n" for n in range(9)))
    with pytest.raises(RecordsError, match='pass decimal="," or delimiter=","'):
        convert(tmp_path / "a.csv", tmp_path / "r.npz", time=0, force=1)
    (tmp_path / "a.csv").write_text(table(truth) + "\n" + table(truth).replace("0.5,", "0.55,"))
    [held] = loaded(convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK, table=2)[0])
    assert held["time"][-1] == 0.55


def long_recording(double: bool = True):
    """Four blows at 2 kHz, of which the second has a rebound and the last is cut off by the end; a slower chip beside."""
    time = np.arange(0, 4.0, 1 / 2000)
    onsets = [0.5, 1.5, 2.5, 3.9]
    force = 0.02 + sum(
        np.where((time >= t) & (time < t + 0.01), 5 * np.sin((time - t) * 100 * np.pi), 0.0) for t in [*onsets, 1.55]
    )
    panel = np.where(time < 2.0, 1, 2)
    chip = np.arange(0.0013, 4.0, 1 / 200)
    return time, force, panel, chip, onsets


def test_several_blows_are_cut_from_one_long_recording(tmp_path):
    time, force, panel, chip, onsets = long_recording()
    signals = np.stack([np.sin(7 * chip), np.cos(5 * chip), chip], axis=1)
    (tmp_path / "f.csv").write_text(
        "t;F;p\n" + "".join(f"{t!r};{f!r};{p}\n" for t, f, p in zip(time.tolist(), force.tolist(), panel.tolist()))
    )
    (tmp_path / "s.csv").write_text(
        "t;x;y;w\n" + "".join(";".join(map(repr, row)) + "\n" for row in np.column_stack([chip, signals]).tolist())
    )
    pick = {"time": "t", "force": "F", "panel": "p", "first_panel": 1, "trigger": 1.0, "length": 0.4, "before": 0.02}
    toml, notes = convert(
        tmp_path / "f.csv", tmp_path / "r.npz", signals=["x", "y", "w"], signal_files=[tmp_path / "s.csv"], **pick
    )
    assert tomllib.loads(toml.read_text())["recorded"]["panels"] == [0, 0, 1]
    assert sum("left out" in note for note in notes) == 1
    for held, onset in zip(loaded(toml), onsets):
        begins = time[np.flatnonzero((force - 0.02 >= 1.0) & (time >= onset))[0]] - 0.02
        first = int(round(begins * 2000))
        assert held["force"].shape[-1] == 801 and np.array_equal(held["force"][0], force[first : first + 801])
        assert np.abs(held["time"] - np.arange(801) / 2000).max() < 1e-12
        at = held["signal_time"] + begins
        assert np.abs(held["signals"][0, :, 2] - at).max() < 1e-12 and at[0] <= begins and at[-1] >= begins + 0.4
    # of one clock and one length: one array
    (tmp_path / "one.csv").write_text("t,F,x\n" + "".join(f"{t!r},{f!r},{t!r}\n" for t, f in zip(time.tolist(), force.tolist())))
    [held] = loaded(
        convert(tmp_path / "one.csv", tmp_path / "r.npz", time="t", force="F", signals=["x"], trigger=1.0, length=0.4, before=0.02)[
            0
        ]
    )
    assert held["force"].shape == (3, 801) and held["signals"].shape == (3, 801, 1)
    # a rebound is a blow of its own where windows are short and the level re-arms at once, and not where it must rest for long
    short = {"length": 0.03, "before": 0.005}
    assert len(records.blows(time, force, 1.0, **short)) == 5
    assert len(records.blows(time, force, 1.0, rearm=0.1, **short)) == 4


def test_a_panel_is_named_by_the_file(truth, tmp_path):
    for n, panel in enumerate([2, 1, 3]):
        (tmp_path / f"blow{n}_P{panel}.csv").write_text(table({**truth, "f": truth["f"] * (1 + n)}))
    files = sorted(tmp_path.glob("*.csv"))
    toml, _ = convert(files, tmp_path / "r.npz", **PICK, panel_pattern=r"_P(\d+)", first_panel=1)
    assert tomllib.loads(toml.read_text())["recorded"]["panels"] == [1, 0, 2]
    with pytest.raises(RecordsError, match="blow0_P2.csv: panel_pattern = 'Q"):
        convert(files, tmp_path / "r.npz", **PICK, panel_pattern=r"Q(\d)")
    with pytest.raises(RecordsError, match="panel 1 is below first_panel = 2"):
        convert(files, tmp_path / "r.npz", **PICK, panel_pattern=r"_P(\d+)", first_panel=2)


def test_rows_without_a_slower_sensor_are_left_out_where_asked(truth, tmp_path):
    lines = table(truth).splitlines()
    sparse = [line if n % 2 == 0 else ",".join(line.split(",")[:2]) + ",,," for n, line in enumerate(lines[1:])]
    (tmp_path / "a.csv").write_text("\n".join([lines[0], *sparse]))
    [held] = loaded(convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK, empty="skip")[0])
    assert held["force"].shape == (1, N) and np.array_equal(held["signal_time"], truth["t"][::2])
    assert np.array_equal(held["signals"][0, :, 1], truth["ay"][::2])
    with pytest.raises(RecordsError, match="line 3: has no signals, so signal_rate would count .* pass signal_time"):
        convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK, empty="skip", signal_rate=RATE / 2)


def test_matlab_files_of_both_versions(truth, tmp_path):
    io = pytest.importorskip("scipy.io")
    io.savemat(
        tmp_path / "a.mat",
        {"t": truth["t"][:, None], "data": {"f": truth["f"], "imu": np.stack([truth[n] for n in ORDER[1:]], axis=1)}},
    )
    pick = {"time": "t", "force": "data/f", "signals": ["data/imu[0]", "data/imu[1]", "data/imu[2]"]}
    check(convert(tmp_path / "a.mat", tmp_path / "r.npz", **pick)[0], truth)
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "b.mat", "w", userblock_size=512) as file:  # MATLAB stores the transpose
        file["t"], file["data/f"] = truth["t"][None], truth["f"][None]
        file["data/imu"] = np.stack([truth[n] for n in ORDER[1:]])
    with (tmp_path / "b.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + bytes([0, 2]) + b"IM")
    check(convert(tmp_path / "b.mat", tmp_path / "r.npz", **pick)[0], truth)
    data = Path(io.__file__).parent / "matlab/tests/data"
    if data.is_dir():  # files that MATLAB wrote and scipy ships
        for name in ["testdouble_7.4_GLNX86.mat", "testdouble_7.1_GLNX86.mat", "testdouble_6.1_SOL2.mat", "big_endian.mat"]:
            file = data / name
            own = [value for value in io.loadmat(file).values() if getattr(value, "dtype", np.dtype("O")).kind == "f"]
            held = [column for recording in read(file) for column in recording.columns]
            assert sum(len(column.values) for column in held) == sum(value.size for value in own), name


def test_hdf5_groups_are_records_and_units_are_read(truth, tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for blow in range(3):
            for name in ["t", *ORDER]:
                file[f"blow{blow}/{name}"] = truth[name] * (1 + blow if name != "t" else 1)
            file[f"blow{blow}/f"].attrs["units"] = "mN"
    toml, _ = convert(tmp_path / "a.h5", tmp_path / "r.npz", **PICK)
    [held] = loaded(toml)
    assert held["force"].shape == (3, N) and np.array_equal(held["force"][2], 3 * truth["f"])
    assert tomllib.loads(toml.read_text())["recorded"]["force_unit"] == "mN"
    with h5py.File(tmp_path / "c.h5", "w") as file:
        file["t"] = (1_790_000_000_000_000_000 + np.arange(N) * 10_000_000).astype(np.int64)
        file["daq/f"], file["imu"] = truth["f"], np.stack([truth[n] for n in ORDER[1:]])
    check(convert(tmp_path / "c.h5", tmp_path / "r.npz", time="t", force="daq/f", signals=["imu[0]", "imu[1]", "imu[2]"])[0], truth)


UNITS = [
    ("f", "lbf", {"force_unit": "N"}),
    ("f", "MN", {"force_unit": "mN"}),
    ("ax", "mg", {"acceleration_unit": "g"}),
    ("w", "rpm", {"angular_velocity_unit": "rad/s"}),
]


@pytest.mark.parametrize(("column", "unit", "option"), UNITS)
def test_a_stated_unit_that_is_unknown_is_refused_unless_the_option_is_given(truth, tmp_path, column, unit, option):
    names = [f"{name} ({unit})" if name == column else name for name in ("t", *ORDER)]
    (tmp_path / "a.csv").write_text(table(truth, names=names))
    [(key, value)] = option.items()
    known = {"force_unit": "N, mN, kN", "acceleration_unit": "g, m/s2, mm/s2", "angular_velocity_unit": "deg/s, rad/s"}[key]
    stated = rf"a.csv: column '{column} \({unit}\)' states the unit '{unit}'; known are {known}: convert it, or pass {key}"
    with pytest.raises(RecordsError, match=stated):
        convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK)
    toml, _ = convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK, **option)
    check(toml, truth)
    said = tomllib.loads(toml.read_text())
    assert {**said["recorded"], **said["signals"]}[key] == value


TIMES = [("usec", 1e-6), ("microseconds", 1e-6), ("Milliseconds", 1e-3), ("hours", 3600.0), ("local", 1.0)]


@pytest.mark.parametrize(("unit", "seconds"), TIMES)
def test_units_of_time_are_known_by_name_or_refused(truth, tmp_path, unit, seconds):
    for stated, option in [(unit, {}), ("ticks", {"time_unit": "s"})]:
        names = [f"t ({stated})", *ORDER]
        (tmp_path / "a.csv").write_text(table(truth, names=names))
        [held] = loaded(convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK, **option)[0])
        assert np.allclose(held["time"], truth["t"] * (1.0 if option else seconds), rtol=1e-12, atol=0.0)
    with pytest.raises(RecordsError, match=r"'t \(ticks\)' states the unit 'ticks'; known are d, h, .*: pass time_unit"):
        convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK)


@pytest.mark.parametrize("wrong", ["24:00:00.100", "07:60:00.100", "07:00:60.100"])
def test_times_beyond_a_day_an_hour_or_a_minute_are_refused(truth, tmp_path, wrong):
    (tmp_path / "a.csv").write_text(table(truth, time=[*stamps(STAMPS["clock"])[:-1], wrong]))
    with pytest.raises(RecordsError, match=f"line 52: 't' = '{wrong}' is no time of day"):
        convert(tmp_path / "a.csv", tmp_path / "r.npz", **PICK)


def test_a_file_is_universal_by_the_number_of_its_first_data_set(tmp_path):
    (tmp_path / "a.csv").write_text("".join(f"{-1.5 + n},{58 + n * n}.5,2.5\n" for n in range(5)))
    assert read(tmp_path / "a.csv")[0].columns[0].values[0] == "-1.5"
    for kind in ["   151", "   164", "    58b     1", "    58"]:
        (tmp_path / "a.uff").write_bytes(f"    -1\r\n{kind}\r\n".encode())
        with pytest.raises((RecordsError, ImportError), match="UFF|data set 58|pyuff"):
            read(tmp_path / "a.uff")


def test_archives_contain_the_arrays_alone(truth, tmp_path, monkeypatch):
    seen = {}
    monkeypatch.setattr(np, "savez_compressed", lambda path, **arrays: seen.update(arrays))
    records.save(tmp_path / "r.npz", [records.Record(truth["t"], truth["f"])])
    assert set(seen) == {"time", "force"}


@pytest.mark.parametrize("kind", [0, 1])
def test_universal_files_in_text_and_binary(truth, tmp_path, kind):
    pyuff = pytest.importorskip("pyuff")
    file = tmp_path / "a.uff"
    for blow in range(2):
        for node, name in enumerate(ORDER):
            data = pyuff.prepare_58(
                binary=kind, func_type=1, rsp_node=node, rsp_dir=3, ref_node=1, ref_dir=3, id1=name, id2="NONE", id3="NONE", id4="NONE",
                id5="NONE", data=truth[name] * (1 + blow), x=truth["t"], ord_data_type=4, abscissa_spacing=1, orddenom_spec_data_type=0,
                ordinate_axis_units_lab="N" if name == "f" else "m/s^2",
            )  # fmt: skip
            pyuff.UFF(str(file)).write_sets(data, "add")  # its "overwrite" loses binary sets
    toml, _ = convert(file, tmp_path / "r.npz", force="f", signals=ORDER[1:])
    [held] = loaded(toml)
    exact = 1e-15 if kind else 1e-11  # text has 12 digits
    assert held["force"].shape == (2, N) and np.abs(held["force"][1] - 2 * truth["f"]).max() <= exact * 2
    assert np.abs(held["signals"][0, :, 1] - truth["ay"]).max() <= exact * 4 and np.abs(held["time"] - truth["t"]).max() < 1e-6
    assert tomllib.loads(toml.read_text())["recorded"]["force_unit"] == "N"


def test_tdms_groups_are_records(truth, tmp_path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
        for blow in range(2):
            properties = {"wf_increment": 1 / RATE, "wf_start_offset": 0.0}
            units = {"f": "N", "w": "rad/s"}
            of = [
                nptdms.ChannelObject(
                    f"blow {blow}", name, truth[name] * (1 + blow), {**properties, "unit_string": units.get(name, "g")}
                )
                for name in ORDER
            ]
            file.write_segment(of)
    [held] = loaded(convert(tmp_path / "a.tdms", tmp_path / "r.npz", force="f", signals=ORDER[1:])[0])
    assert np.array_equal(held["force"], np.stack([truth["f"], 2 * truth["f"]]))
    assert np.abs(held["time"] - truth["t"]).max() < 1e-12


def test_a_missing_package_names_the_extra(truth, tmp_path, monkeypatch):
    (tmp_path / "a.tdms").write_bytes(b"TDSm" + bytes(200))
    monkeypatch.setitem(sys.modules, "nptdms", None)
    with pytest.raises(ImportError, match=r"a.tdms: needs npTDMS.*metasense\[records\]"):
        convert(tmp_path / "a.tdms", tmp_path / "r.npz", **PICK)


def test_the_command_converts_what_a_fit_reads(body, spec, command, tmp_path):
    """Signals of the body as instruments write them, with noise of 0.1 %: the fit finds the body's material."""
    noise = np.random.default_rng(4)
    forces = body.stimuli("train")[:4]
    signals = body.simulate(body.alpha, forces).signals
    time = np.arange(1, body.instants + 1) * body.duration / body.instants
    (tmp_path / "raw").mkdir()
    for n, (force, of) in enumerate(zip(forces, signals)):
        columns = np.column_stack([time, force[0, 1:], of[:, :2] / 9806.65, np.rad2deg(of[:, 2])])
        columns[:, 2:] += 1e-3 * np.abs(columns[:, 2:]).max(axis=0) * noise.normal(size=(len(time), 3))
        columns = np.vstack([[0.0] * 5, columns])
        rows = ["\t".join(repr(x).replace(".", ",") for x in row) for row in columns.tolist()]
        text = "\r\n".join(["Gerät\tWT9011", "", "Zeit (s)\tKraft (N)\tbx (g)\tby (g)\tω (°/s)", *rows])
        (tmp_path / f"raw/Stoß{n}.txt").write_bytes(text.encode("utf-16"))
    done = subprocess.run(
        [sys.executable, "-m", "metasense.records", "raw/*.txt", "--out", "r.npz", "--time", "Zeit", "--force", "Kraft", "--signals", "bx,by,ω"],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0 and "note" not in done.stderr, done.stderr
    found = command("lab", "identify", spec, "--records", "r.toml", "--fit", "stretch,bend", "--format", "json", cwd=tmp_path)
    rows = {row["parameter"]: row for row in json.loads(found)}
    for name, true in [("stretch", 3.0), ("bend", 1.0)]:
        assert abs(rows[name]["fitted"] - true) < 0.01 * true, rows
    done = subprocess.run(
        [sys.executable, "-m", "metasense.records", "absent.csv", "--out", "r.npz", "--force", "0"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2 and done.stderr.startswith("error: absent.csv: cannot be read")
