"""`saranga-bench stand import`: files of thrust stands with all their quirks, or one clear error."""

import csv
import io
import json
import os
from pathlib import Path

import numpy as np
import pytest

from bench.cli import main
from bench.thrust_stand.formats import format_names, read_sweep
from bench.thrust_stand.units import UNITS, conversion
from saranga.errors import UsageError
from saranga.fixtures import fixture_dir

SWEEPS = fixture_dir() / "thrust" / "rcbenchmark-1520"
NAMES = sorted(path.name for path in SWEEPS.glob("*.csv"))
RECORDINGS = Path(os.environ.get("SARANGA_THRUST_RECORDINGS", Path(__file__).parents[2] / "../shared/data/thrust"))
G = 9.80665

HEADER_1520 = ("Time (s),ESC signal (µs),Servo 1 (µs),Servo 2 (µs),Servo 3 (µs),Thrust (gf),Voltage (V),Current (A),"
               "Motor Electrical Speed (RPM),Motor Optical Speed (RPM),Electrical Power (W),Overall Efficiency (gf/W),"
               "App message,")
HEADER_1580 = ("Time (s),ESC signal (µs),Servo 1 (µs),Servo 2 (µs),Servo 3 (µs),AccX (g),AccY (g),AccZ (g),"
               "Torque (N·m),Thrust (N),Voltage (V),Current (A),Motor Electrical Speed (rad/s),"
               "Motor Optical Speed (rad/s),Electrical Power (W),Mechanical Power (W),Motor Efficiency (%),"
               "Propeller Mech. Efficiency (N/W),Overall Efficiency (N/W),Vibration (g),App message,")


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = 0
    try:
        main([str(a) for a in arguments])
    except SystemExit as ended:
        code = int(ended.code or 0)
    out, err = capsys.readouterr()
    return code, out, err


def row_1520(k: int, thrust: str | None = None, message: str = "") -> str:
    rpm = 2000 * k
    thrust = f"{1e-6 * rpm**2:.6f}" if thrust is None else thrust
    return f"{1.5 * k},{1000 + 100 * k},,,,{thrust},11.1,{0.5 * k},{rpm},0,{5.55 * k},3.2,{message},"


def file_1520(path: Path, rows: list[str] | None = None, header: str = HEADER_1520, encoding: str = "utf-8-sig",
              end: str = "\r\n") -> Path:
    rows = [row_1520(k) for k in range(6)] if rows is None else rows
    path.write_bytes(end.join([header, *rows, ""]).encode(encoding))
    return path


# ---- the real files -------------------------------------------------------------------------------
@pytest.mark.parametrize("name", NAMES)
def test_every_real_1520_sweep_imports_with_right_units_and_a_small_residual(
        name: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "stand", "import", SWEEPS / name, "--json")
    assert code == 0, err
    got = json.loads(out)
    rows = list(csv.reader(io.StringIO((SWEEPS / name).read_text(encoding="utf-8-sig"))))
    header, body = rows[0], [row for row in rows[1:] if row]
    thrust_n = [float(row[header.index("Thrust (gf)")]) * G * 1e-3 for row in body]
    rpm = np.array([float(row[header.index("Motor Electrical Speed (RPM)")]) for row in body])
    assert got["rows"] == len(body) == 11
    assert got["thrust_n"] == pytest.approx(thrust_n, rel=1e-12)
    assert got["rpm"] == pytest.approx(rpm)
    assert {"name": "Thrust", "unit": "gf"}.items() <= got["columns"][5].items()
    assert {"name": "ESC signal", "unit": "µs"}.items() <= got["columns"][1].items()
    assert [c["name"] for c in got["columns"]][-1] == "App message", "the comma at the end of the line is no column"
    turning = rpm > 0
    k = np.linalg.lstsq(rpm[turning, None] ** 2, np.abs(thrust_n)[turning], rcond=None)[0][0]
    assert got["thrust_fit"]["k"] == pytest.approx(k, rel=1e-9)
    assert 1.1e-8 < k < 1.8e-8
    assert 0.001 < got["thrust_fit"]["residual_of_max"] < 0.02
    assert got["thrust_fit"]["residual_of_max"] <= got["thrust_fit"]["largest_residual_of_max"] < 0.04


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="other people's recordings are absent: set "
                    "SARANGA_THRUST_RECORDINGS to their folder")
def test_every_recording_there_is_imports(capsys: pytest.CaptureFixture[str]) -> None:
    files = sorted(RECORDINGS.glob("*/*.csv"))
    assert files
    for path in files:
        code, out, err = run(capsys, "stand", "import", path, "--json")
        assert code == 0, err
        got = json.loads(out)
        assert got["rows"] > 3 and got["thrust_fit"]["residual_of_max"] < 0.03, path
        if "1580" in str(path):
            names = {c["quantity"] for c in got["columns"]}
            assert {"torque_n_m", "vibration_m_s2", "thrust_n"} <= names
            assert 1.0 < max(got["quantities"]["vibration_m_s2"]) < 10.0, "given in g, imported in m/s2"
            assert max(got["thrust_n"]) == pytest.approx(48.537 * G * 1e-3, rel=1e-3)


# ---- quirks ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(("unit", "factor"), [
    ("gf", G * 1e-3), ("g", G * 1e-3), ("kgf", G), ("N", 1.0), ("mN", 1e-3), ("lbf", 4.4482216152605),
    ("ozf", 0.27801385095378), ("KGF", G), ("n", 1.0)])
def test_thrust_comes_in_newtons_whatever_unit_the_user_chose(unit: str, factor: float, tmp_path: Path) -> None:
    path = file_1520(tmp_path / "u.csv", header=HEADER_1520.replace("Thrust (gf)", f"Thrust ({unit})"))
    assert read_sweep(path).quantities["thrust_n"] == pytest.approx([1e-6 * (2000 * k) ** 2 * factor for k in range(6)])


@pytest.mark.parametrize(("quantity", "unit", "factor", "offset"), [
    ("torque", "N·m", 1.0, 0.0), ("torque", "N⋅m", 1.0, 0.0), ("torque", "Nm", 1.0, 0.0), ("torque", "N-m", 1.0, 0.0),
    ("torque", "N·mm", 1e-3, 0.0), ("torque", "lbf·in", 0.1129848290276, 0.0), ("torque", "ozf·in", 0.00706155181, 0.0),
    ("torque", "kgf·cm", 0.0980665, 0.0), ("torque", "NÂ·m", 1.0, 0.0), ("rotation", "rad/s", 9.5492965855, 0.0),
    ("rotation", "RPM", 1.0, 0.0), ("rotation", "Hz", 60.0, 0.0), ("time", "µs", 1e-6, 0.0), ("time", "μs", 1e-6, 0.0),
    ("time", "us", 1e-6, 0.0), ("temperature", "ºC", 1.0, 0.0), ("temperature", "°F", 5 / 9, -160 / 9),
    ("temperature", "K", 1.0, -273.15), ("acceleration", "g", G, 0.0), ("acceleration", "m/s²", 1.0, 0.0)])
def test_units_in_all_their_spellings(quantity: str, unit: str, factor: float, offset: float) -> None:
    got = conversion(quantity, unit)
    assert got is not None
    assert got == pytest.approx((factor, offset), rel=1e-9)


def test_no_unit_is_taken_for_another() -> None:
    assert conversion("force", "V") is None
    assert conversion("force", "Mn") is None or conversion("force", "Mn") == (1e-3, 0.0)
    assert conversion("voltage", "mv") == (1e-3, 0.0)
    for quantity, (_, table) in UNITS.items():
        for unit, factors in table.items():
            assert conversion(quantity, unit) == factors, (quantity, unit)


def test_a_1580_file_has_torque_and_vibration_and_speeds_in_other_units(tmp_path: Path) -> None:
    rows = [f"{k},{1000 + 100 * k},,,,0.01,0,-0.98,{0.001 * k},{0.4 * k * k},7.8,{k},{104.7197551 * k},0,9,5,50,1,1,"
            f"0.25,," for k in range(1, 6)]
    got = read_sweep(file_1520(tmp_path / "b.csv", rows, HEADER_1580))
    assert got.quantities["rpm"] == pytest.approx([1000 * k for k in range(1, 6)])
    assert got.quantities["torque_n_m"] == pytest.approx([0.001 * k for k in range(1, 6)])
    assert got.quantities["vibration_m_s2"] == pytest.approx([0.25 * G] * 5)
    fit = got.fit()
    assert not isinstance(fit, str) and fit.k == pytest.approx(0.4e-6) and fit.residual_of_max < 1e-9


def test_columns_may_come_in_any_order_and_be_missing(tmp_path: Path) -> None:
    path = tmp_path / "o.csv"
    path.write_text("RPM (1/min),Note,Thrust (mN)\n1000,first,1000\n2000,,4000\n3000,,9000\n")
    got = read_sweep(path)
    assert got.quantities["thrust_n"] == pytest.approx([1.0, 4.0, 9.0])
    assert got.quantities["rpm"] == pytest.approx([1000, 2000, 3000])
    assert set(got.quantities) == {"thrust_n", "rpm"}


def test_negative_thrust_keeps_its_sign_and_the_fit_uses_its_size(tmp_path: Path) -> None:
    rows = [row_1520(k, thrust=f"{-1e-6 * (2000 * k) ** 2:.6f}") for k in range(6)]
    path = file_1520(tmp_path / "n.csv", rows)
    got = read_sweep(path)
    fit = got.fit()
    assert not isinstance(fit, str)
    assert (got.quantities["thrust_n"][1:] < 0).all() and got.thrust_sign == -1
    assert fit.k == pytest.approx(1e-6 * G * 1e-3) and fit.residual_of_max < 1e-6
    assert any("thrust is negative in 5 of 6 rows" in note for note in got.notes)
    turned = read_sweep(path, thrust_sign=-1)
    assert (turned.quantities["thrust_n"][1:] > 0).all() and turned.thrust_sign == 1


def test_blank_cells_are_not_measured_and_null_in_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [row_1520(k) for k in range(5)] + [row_1520(5, thrust="")]
    code, out, _ = run(capsys, "stand", "import", file_1520(tmp_path / "b.csv", rows), "--json")
    got = json.loads(out)
    assert code == 0 and got["rows"] == 6
    assert got["thrust_n"][-1] is None and got["thrust_fit"]["rows"] == 4


def test_rows_without_a_speed_do_not_count_in_the_fit(tmp_path: Path) -> None:
    rows = [row_1520(k) for k in range(6)]
    rows[0] = rows[0].replace(",0.000000,", ",25.0,")  # the motor turns too slowly for its electrical speed to be seen
    fit = read_sweep(file_1520(tmp_path / "z.csv", rows)).fit()
    assert not isinstance(fit, str) and fit.rows == 5 and fit.residual_of_max < 1e-6


def test_no_fit_without_a_speed_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "s.csv"
    path.write_text("Time (s),Thrust (gf)\n0,1\n1,2\n")
    _, out, _ = run(capsys, "stand", "import", path, "--json")
    got = json.loads(out)
    assert got["thrust_fit"]["k"] is None and got["thrust_fit"]["why"] == "no column of rotation speed"
    assert got["rpm"] == [None, None]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_encodings_and_line_ends(encoding: str, end: str, tmp_path: Path) -> None:
    got = read_sweep(file_1520(tmp_path / "e.csv", encoding=encoding, end=end))
    assert got.rows == 6 and got.columns[1].unit == "µs"
    assert got.quantities["esc_s"] == pytest.approx([1e-3 + 1e-4 * k for k in range(6)])


def test_semicolons_and_decimal_commas(tmp_path: Path) -> None:
    text = "\n".join([HEADER_1520, *(row_1520(k) for k in range(6))])
    path = tmp_path / "d.csv"
    path.write_text(text.replace(",", ";").replace(".", ","), encoding="utf-8")
    assert read_sweep(path).quantities["thrust_n"] == pytest.approx(
        read_sweep(file_1520(tmp_path / "p.csv")).quantities["thrust_n"])
    path.write_text(text.replace(",", "\t"), encoding="utf-8")
    assert read_sweep(path).rows == 6


def test_free_text_with_commas_and_columns_of_a_users_script(tmp_path: Path) -> None:
    rows = [row_1520(k) for k in range(6)]
    rows[3] = row_1520(3, message="Cutoff: Current (val=11.2, limit=11)")
    got = read_sweep(file_1520(tmp_path / "m.csv", rows))
    assert got.quantities["rpm"][3] == 6000 and any("1 rows have more cells" in note for note in got.notes)
    header = HEADER_1520 + "TargetRPM,kp,"
    rows = [row_1520(0).rstrip(",") + ",", *(row_1520(k) + "5000,0.1," for k in range(1, 6))]
    got = read_sweep(file_1520(tmp_path / "s.csv", rows, header))
    assert [c.name for c in got.columns][-2:] == ["TargetRPM", "kp"]
    assert np.isnan(got.columns[-1].values[0]) and got.columns[-1].values[1] == 0.1


def test_derived_columns_may_hold_what_a_division_by_zero_gives(tmp_path: Path) -> None:
    rows = [row_1520(k) for k in range(6)]
    rows[0] = rows[0].replace(",3.2,", ",Infinity,")
    rows[1] = rows[1].replace(",3.2,", ",NaN,")
    got = read_sweep(file_1520(tmp_path / "i.csv", rows))
    assert got.rows == 6 and any("Overall Efficiency" in note for note in got.notes)


def test_lines_before_the_header_are_passed_over_and_said(tmp_path: Path) -> None:
    path = file_1520(tmp_path / "h.csv", header="Test of Monday\n" + HEADER_1520)
    got = read_sweep(path)
    assert got.rows == 6 and got.notes[0] == "1 lines before the header are passed over"


def test_the_optical_speed_is_used_where_only_it_saw_the_motor(tmp_path: Path) -> None:
    rows = [row_1520(k).replace(f",{2000 * k},0,", f",0,{2000 * k},") for k in range(6)]
    got = read_sweep(file_1520(tmp_path / "r.csv", rows))
    assert got.quantities["rpm"][5] == 10000 and "rotation speed is the optical one" in got.notes
    with pytest.raises(UsageError, match="electrical or optical"):
        read_sweep(tmp_path / "r.csv", rpm="magnetic")


def test_two_speeds_that_disagree_are_said(tmp_path: Path) -> None:
    rows = [row_1520(k).replace(f",{2000 * k},0,", f",{2000 * k},{1000 * k},") for k in range(6)]
    notes = read_sweep(file_1520(tmp_path / "r.csv", rows)).notes
    assert any("disagree by a factor of 2.000" in note for note in notes)


# ---- faults ---------------------------------------------------------------------------------------
def with_cell(column: int, value: str, line: int = 3) -> list[str]:
    rows = [row_1520(k) for k in range(6)]
    cells = rows[line - 2].split(",")
    cells[column] = value
    rows[line - 2] = ",".join(cells)
    return rows


@pytest.mark.parametrize(("rows", "words"), [
    (with_cell(5, "abc"), r"f\.csv:3: column 'Thrust' is 'abc', not a finite number"),
    (with_cell(5, "NaN"), r"f\.csv:3: column 'Thrust' is 'NaN'"),
    (with_cell(8, "inf", 5), r"f\.csv:5: column 'Motor Electrical Speed' is 'inf'"),
    (with_cell(6, "1e999"), r"column 'Voltage' is '1e999'"),
    (with_cell(5, "1_000"), r"column 'Thrust' is '1_000'"),
    (with_cell(8, "-2000"), r"f\.csv:3: column 'Motor Electrical Speed' is '-2000'.*below 0"),
    ([], "the sweep is empty"),
    ([row_1520(0), "1.5,1100,,,,4"], r"f\.csv:3: 6 cells, but the header in line 1 names 13 columns"),
    ([row_1520(0), '0,1100,,,,"4'], r"f\.csv:\d: "),
    ([row_1520(0, thrust="1,5")], r"f\.csv:2: .*decimal comma"),
    ([row_1520(k, thrust="") for k in range(3)], r"column 'Thrust' is blank in all 3 rows"),
])
def test_a_faulty_row_names_file_line_column_and_value(rows: list[str], words: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=words):
        read_sweep(file_1520(tmp_path / "f.csv", rows))


@pytest.mark.parametrize(("header", "words"), [
    (HEADER_1520.replace("Thrust (gf)", "Thrust (furlong)"), r"f\.csv:1: column 'Thrust' has unit 'furlong'"),
    (HEADER_1520.replace("Voltage (V)", "Voltage (A)"), r"column 'Voltage' has unit 'A', which is no unit of voltage"),
    (HEADER_1520.replace("Servo 1 (µs)", "Thrust (N)"), r"columns 'Thrust' and 'Thrust' are both thrust_n"),
    (HEADER_1520.replace("Thrust (gf)", "Lift"), "no header of a thrust stand in its first 20 lines"),
    (HEADER_1520.replace("Servo 1 (µs)", ""), "column 3 has no name"),
])
def test_a_faulty_header_names_what_is_wrong(header: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=words):
        read_sweep(file_1520(tmp_path / "f.csv", header=header))


@pytest.mark.parametrize(("data", "words"), [
    (b"", "is empty"), (b"\n \n", "is empty"), (b"PK\x03\x04\x00\x00", "binary data"),
    (b"a;b\n1;2\n", "no header of a thrust stand"), (b"\xef\xbb\xbf", "is empty|no header")])
def test_what_is_no_sweep_is_refused(data: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_bytes(data)
    with pytest.raises(UsageError, match=words):
        read_sweep(tmp_path / "x.csv")


def test_mixed_decimal_marks_are_refused(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("Time (s);Thrust (N)\n0;1,5\n1;2.5\n")
    with pytest.raises(UsageError, match=r"decimal comma in line 2 \(1,5\) and decimal point in line 3 \(2\.5\)"):
        read_sweep(tmp_path / "x.csv")


def test_the_command_ends_with_code_2_and_an_object_for_scripts(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "stand", "import", "no/such.csv", "--json")
    assert code == 2 and "no/such.csv: cannot be read" in err
    assert json.loads(out)["verdict"] == "ERROR"
    code, _, err = run(capsys, "stand", "import", SWEEPS / "a1_7.csv", "--option", "rmp=optical")
    assert code == 2 and "did you mean 'rpm'" in err


# ---- out ------------------------------------------------------------------------------------------
def test_a_table_in_si_reads_back_the_same_and_is_never_overwritten(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "si.csv"
    code, text, _ = run(capsys, "stand", "import", SWEEPS / "a1_11.csv", "--out", out)
    assert code == 0 and "T = 1.244e-08 N/rpm^2" in text and "Thrust [gf]: 11 of 11 rows -> thrust_n in N" in text
    assert out.read_text().splitlines()[0] == "time_s,thrust_n,rpm,voltage_v,current_a,esc_s,power_w"
    again, first = read_sweep(out), read_sweep(SWEEPS / "a1_11.csv")
    assert again.format == "si"
    for name, values in first.quantities.items():
        assert again.quantities[name] == pytest.approx(values, rel=1e-8)
    code, _, err = run(capsys, "stand", "import", SWEEPS / "a1_11.csv", "--out", out)
    assert code == 2 and "never overwritten" in err


@pytest.mark.parametrize(("text", "words"), [
    ("time_s,thrust_n\n0,one\n", r"s\.csv:2: column 'thrust_n' is 'one'"),
    ("time_s,thrust_n,thrust_n\n0,1,1\n", "'thrust_n' is there twice"),
    ("time_s,thrust_n\n", "the sweep is empty"),
    ("time_s,thrust_n,rpm\n0,1\n", r"s\.csv:2: ends before column 'rpm'"),
])
def test_a_faulty_table_in_si_names_its_fault(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_text(text)
    with pytest.raises(UsageError, match=words):
        read_sweep(tmp_path / "s.csv")


def test_both_formats_are_found_by_name() -> None:
    assert format_names() == ["rcbenchmark", "si"]
