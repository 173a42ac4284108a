"""`saranga-bench preflight` whole: run folder, JSON, page, signature, exit codes, links that fail, interruption."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from parked_link import QUICK, judged

from bench.cli import main
from bench.preflight.command import Plan, preflight
from bench.preflight.page import grouped, write_page
from bench.preflight.rig_side import Reflector, parse_reflector
from bench.preflight.sign import canonical, load_key, make_key, problem, signed
from bench.preflight.stack_timing import time_stack
from bench.store import Store
from saranga.errors import UsageError


def run(arguments: list[str], capsys) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(["preflight", *arguments])
    out, err = capsys.readouterr()
    return ended.value.code or 0, out, err


@pytest.mark.wall_time
def test_the_whole_on_emulated_devices(tmp_path):
    said: list[str] = []
    plan = Plan("emulated:?port=pty&fault=BATT_LOW_VOLT=0", "emulated:", denoiser="gaussian",
                deadlines=QUICK, rig_seconds=3.0, stack_steps=60)
    result = preflight(plan, Store(tmp_path), said.append)
    folder = Path(result["run"])
    kept = json.loads((folder / "preflight.json").read_text())
    rows = {row["name"]: row for row in kept["checks"]}
    assert not kept["go"] and rows["battery_low_volt_v"]["verdict"] == "FAIL"
    assert "BYPASSED: BATT_LOW_VOLT is 0" in kept["reason"] and "battery_low_volt_v" in kept["bypassed"]
    assert rows["reflector_side"]["origin"] == "emulated" and rows["reflector_side"]["verdict"] == "PASS"
    assert kept["provenance"]["vehicle"]["url"].startswith("serial://") and kept["metrics"]["parameters_read"] > 80
    assert "NO-GO" in (folder / "preflight.html").read_text()
    assert (folder / "echoes.mcap").stat().st_size > 10_000 and (folder / "vehicle.json").is_file()
    assert any("watching" in text for text in said)
    # On a slow machine MAVSDK may not be done in time; what it says is then a remark.
    assert kept["metrics"]["mavsdk"].get("version") == [0, 1, 0] or kept["metrics"]["mavsdk"]["failed"]
    assert kept["metrics"]["dropped_by_guard"] == []


@pytest.mark.wall_time
def test_an_armed_vehicle_ends_it_at_once(tmp_path):
    plan = Plan("emulated:?fault=says_armed", "tcp://127.0.0.1:1", deadlines=QUICK)
    result = preflight(plan, Store(tmp_path))
    assert result["verdict"] == "FAIL" and result["reason"].startswith("NO-GO: vehicle_armed")
    assert not result["errors"] and result["metrics"]["total_s"] < 20.0
    assert json.loads((Path(result["run"]) / "vehicle.json").read_text())["stopped"]


def test_links_that_fail_are_one_error_and_everything_is_listed(tmp_path, capsys):
    code, out, err = run(["--vehicle", "serial:///dev/nothing-there", "--rig", "tcp://127.0.0.1:1", "--denoiser",
                          "gaussian", "--json", "--quiet", "--out", str(tmp_path)], capsys)
    result = json.loads(out)
    assert code == 4 and result["verdict"] == "ERROR" and result["go"] is False
    assert len(result["errors"]) == 1 and err.count("error: ") == 1
    assert "vehicle: serial:///dev/nothing-there" in result["errors"][0] and "rig: tcp://" in result["errors"][0]
    assert "2 of 2 links failed" in result["reason"] and len(result["checks"]) > 40
    assert (Path(result["run"]) / "preflight.html").is_file()


def test_an_interruption_leaves_a_run_that_can_be_read(tmp_path):
    result = preflight(Plan("tcp://127.0.0.1:1"), Store(tmp_path),
                       stop=lambda: True)
    assert result["verdict"] == "INCONCLUSIVE" and "interrupted" in result["reason"] and not result["errors"]
    assert json.loads((Path(result["run"]) / "preflight.json").read_text())["go"] is False
    assert Store(tmp_path).runs()[0].info["state"] == "interrupted"


@pytest.mark.wall_time
@pytest.mark.parametrize("at", ["starting an emulated", pytest.param("watching", marks=pytest.mark.slow)])
def test_ctrl_c_ends_it_with_130_and_a_run_that_can_be_read(tmp_path, at):
    command = [sys.executable, "-m", "bench.cli", "preflight", "--vehicle", "emulated:", "--json", "--no-mavsdk",
               "--out", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               start_new_session=True)
    for line in process.stderr:
        if at in line:
            break
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=100)
    result = json.loads(out)
    assert process.returncode == 130 and result["verdict"] == "INCONCLUSIVE" and not result["go"]
    assert (Path(result["run"]) / "preflight.html").is_file()


@pytest.mark.parametrize(("arguments", "says"), [
    ([], "give --vehicle URL, --rig URL or both"),
    (["--vehicle", "emulated:px4"], "'px4' is not known: embedded, arducopter"),
    (["--vehicle", "emulated:?fault=no_flo"], "did you mean 'no_flow'"),
    (["--vehicle", "emulated:?speed=3"], "no option 'speed'"),
    (["--rig", "emulated:?fault=swaped_sensors"], "swapped_sensors"),
    (["--rig", "emulated:triple"], "use emulated:"),
    (["--rig", "emulated:", "--reflector", "5,up"], "RANGE[,right|left]"),
    (["--rig", "emulated:", "--limits", "no-such"], "no-such"),
    (["--rig", "emulated:", "--parameters", "no-such"], "no-such"),
    (["--rig", "emulated:", "--sonar", "no-such"], "no-such"),
    (["--rig", "emulated:", "--skip", "batery"], "did you mean 'battery'"),
    (["--rig", "emulated:", "--system", "300"], "must be 1..255"),
    (["--rig", "emulated:", "--sign-key", "/nowhere/key"], "preflight key"),
])
def test_bad_input_is_told_before_anything_is_opened(tmp_path, capsys, arguments, says):
    code, _, err = run([*arguments, "--out", str(tmp_path)] if arguments else ["--quiet"], capsys)
    assert code == 2 and says in err
    assert not list(tmp_path.glob("*-preflight-*"))


def test_limits_that_lack_the_age_are_refused(tmp_path, capsys):
    limits = tmp_path / "mine.toml"
    limits.write_text('[limits.lean_deg]\nunit = "deg"\nat_most = 3\nreason = "r"\nsource = "s"\n')
    code, _, err = run(["--rig", "emulated:", "--limits", str(limits)], capsys)
    assert code == 2 and "evidence_age_s" in err


def test_reflector():
    assert parse_reflector("1.2") == Reflector("right", 1.2)
    assert parse_reflector("0.6,left") == Reflector("left", 0.6)
    assert parse_reflector("none") == Reflector("none", None)


# ---- signing -----------------------------------------------------------------------------------------
def test_a_signed_result_is_verified_and_a_changed_one_is_not(tmp_path, capsys, clean):
    key = tmp_path / "key"
    code, out, _ = run(["key", str(key)], capsys)
    assert code == 0 and key.stat().st_mode & 0o777 == 0o600
    result = signed(judged(clean) | {"run": "x"}, load_key(key))
    file = tmp_path / "preflight.json"
    file.write_text(json.dumps(result))
    code, out, _ = run(["verify", str(file), "--key", str(key)], capsys)
    assert code == 0 and "valid; it says GO" in out
    result["checks"][3]["value"] = 0.5
    file.write_text(json.dumps(result))
    code, out, _ = run(["verify", str(file), "--key", str(key), "--json"], capsys)
    assert code == 1 and json.loads(out)["problem"] == "it was changed after it was signed"
    assert json.loads(out)["go"] is False


def test_another_key_and_no_signature_are_told_apart(tmp_path, clean):
    for name in ("a", "b"):
        make_key(tmp_path / name)
    first, second = load_key(tmp_path / "a"), load_key(tmp_path / "b")
    result = judged(clean)
    assert problem(result, first) == "it is not signed"
    assert "another key" in problem(signed(result, first), second)
    assert canonical(signed(result, first)) == canonical(result)


def test_keys_that_are_no_keys(tmp_path):
    make_key(tmp_path / "key")
    with pytest.raises(UsageError, match="never overwritten"):
        make_key(tmp_path / "key")
    (tmp_path / "key").chmod(0o644)
    with pytest.raises(UsageError, match="chmod 600"):
        load_key(tmp_path / "key")
    (tmp_path / "short").write_text("abc")
    with pytest.raises(UsageError, match="needs 32"):
        load_key(tmp_path / "short")


# ---- page and stack ----------------------------------------------------------------------------------
def test_the_page_says_it_first_and_shows_what_failed(tmp_path, clean):
    clean.vehicle.parameters["FS_GCS_ENABLE"] = 0.0
    result = judged(clean)
    result["metrics"]["total_s"] = 20.0
    page = write_page(result, tmp_path / "p.html").read_text()
    assert page.index("NO-GO") < page.index("Not passed") < page.index("Passed")
    assert "BYPASSED: failsafe_off FS_GCS_ENABLE" in page
    assert "http" not in page.replace("http-equiv", "")


def test_rows_open_for_one_reason_are_one_row_on_the_page():
    open_rows = [{"verdict": "INCONCLUSIVE", "why": "no vehicle", "name": f"n{k}", "limit": "x", "source": "s"}
                 for k in range(5)]
    other = {"verdict": "FAIL", "why": "no vehicle", "name": "f", "limit": "x", "source": "s"}
    assert [row["name"] for row in grouped([other, *open_rows])] == ["f", "n0, n1, n2, n3, n4"]


def test_weights_are_hashed_and_steps_timed(tmp_path):
    side = time_stack("gaussian", "saranga", "pair", 0.5, tmp_path / "not" / "there", steps=5)
    assert len(side.step_ms) == 5 and not side.failed and side.runs_on is None
    assert side.weights_found == side.weights_expected and set(side.weights_expected) >= {"fp32", "int8"}


def test_a_stack_that_cannot_run_is_told(tmp_path):
    assert "unknown denoiser" in time_stack("no-such", "saranga", "pair", 0.5, tmp_path).failed
    assert "no-such" in time_stack("gaussian", "no-such", "pair", 0.5, tmp_path).failed
