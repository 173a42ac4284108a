"""`saranga-bench stand check | drivers | fit`: exit codes, the object for scripts, and that nothing ever spins."""

import json
from pathlib import Path
from typing import Any

import pytest
from stand_fakes import ScriptedLink, StandStream, teensy_link

from bench.cli import main
from bench.thrust_stand.drivers.teensy import TeensyStand
from bench.thrust_stand.plant_file import load_plant_file
from bench.thrust_stand.stand_check import check_stand
from saranga.errors import DeviceError
from saranga.fixtures import fixture_dir

SWEEPS = fixture_dir() / "thrust" / "rcbenchmark-1520"


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = 0
    try:
        main([str(a) for a in arguments])
    except SystemExit as ended:
        code = int(ended.code or 0)
    out, err = capsys.readouterr()
    return code, out, err


class PacedStream(StandStream):
    """Fifty readings a second, as the device has them."""

    def __init__(self, *args: Any, share: float = 1.0, **fields: Any) -> None:
        super().__init__(*args, **fields)
        import time

        self.clock, self.share = time.monotonic, share
        self.began_s, self.said = self.clock(), 0

    def __call__(self) -> bytes:
        due = int((self.clock() - self.began_s) * 50 * self.share) + 1
        data = b"".join(super(PacedStream, self).__call__() for _ in range(due - self.said))
        self.said = due
        return data


def checked(stream: StandStream) -> dict[str, Any]:
    """The link's script has no write but HELLO?: a throttle command would fail the test."""
    link: ScriptedLink = teensy_link(stream=stream)
    report = check_stand(TeensyStand(link), watch_s=0.5)
    assert link.expected == [] and link.closed == 1
    return {check["name"]: check for check in report["checks"]} | {"": report}


def test_a_good_stand_passes_all_checks_and_is_told_nothing() -> None:
    got = checked(PacedStream())
    assert got[""]["verdict"] == "PASS"
    assert {name: check["verdict"] for name, check in got.items() if name} == dict.fromkeys(
        ["measures", "readings", "rate", "idle", "rest", "tare"], "PASS")
    assert got[""]["provenance"]["origin"] == "measured" and got[""]["provenance"]["dead_man_s"] == 5.0
    json.dumps(got[""], allow_nan=False)


NAN = float("nan")


@pytest.mark.parametrize(("stream", "name", "verdict"), [
    (lambda: PacedStream(NAN), "measures", "FAIL"),
    (lambda: PacedStream(rpm=NAN), "measures", "MARGINAL"),
    (lambda: PacedStream(share=0.05), "rate", "FAIL"),
    (lambda: PacedStream(rpm=3000.0), "idle", "FAIL"),
    (lambda: PacedStream(throttle=0.2), "idle", "FAIL"),
    (lambda: PacedStream(rpm=3000.0), "tare", "FAIL"),
])
def test_a_stand_with_a_fault_does_not_pass(
        stream: Any, name: str, verdict: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.thrust_stand.calibration.TARE_TIMEOUT_S", 1.0)
    got = checked(stream())
    assert got[name]["verdict"] == verdict
    assert got[""]["verdict"] == ("MARGINAL" if verdict == "MARGINAL" else "FAIL")
    assert got[name]["action"]


def test_a_reading_that_turns_to_nan_does_not_pass() -> None:
    class Failing(PacedStream):
        def __call__(self) -> bytes:
            if self.said > 10:
                self.fields["thrust_n"] = NAN
            return super().__call__()

    got = checked(Failing())
    assert got["readings"]["verdict"] == "FAIL" and "'thrust_n'" in got["readings"]["value"]
    assert got["tare"]["verdict"] == "FAIL"


def test_a_stand_that_is_lost_during_the_check_is_an_error() -> None:
    link = teensy_link(stream=PacedStream())
    stand = TeensyStand(link)
    real = stand.read

    def read(timeout_s: float) -> Any:
        link.lost = True
        return real(timeout_s)

    stand.read = read  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match="unplugged"):
        check_stand(stand, watch_s=0.2)
    assert link.closed == 1


def test_check_of_the_emulated_stand_passes_and_says_emulated(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "stand", "check", "emulated:?seed=2", "--json")
    assert code == 0, err
    got = json.loads(out)
    assert got["verdict"] == "PASS" and got["provenance"]["origin"] == "emulated"
    code, out, _ = run(capsys, "stand", "check", "emulated:?seed=2")
    assert code == 0 and "emulated; throttle, dead-man 5 s" in out and "sign of the thrust can only be seen" in out


def test_check_of_a_recording_sees_its_sign(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "stand", "check", f"file:{SWEEPS / 'g1_11.csv'}?speed=0", "--json")
    assert code == 0 and json.loads(out)["verdict"] == "PASS"
    code, out, _ = run(capsys, "stand", "check", f"file:{SWEEPS / 'g1_11.csv'}?speed=0&thrust_sign=-1", "--json")
    got = json.loads(out)
    assert code == 1 and got["verdict"] == "FAIL"
    assert "calibration is negative" in got["checks"][-1]["value"]


def test_check_of_nothing_ends_with_the_right_code(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "stand", "check", "teensy+tcp://127.0.0.1:9", "--json")
    assert code == 4 and "cannot connect" in err and json.loads(out)["verdict"] == "ERROR"
    code, _, err = run(capsys, "stand", "check", "teensi:")
    assert code == 2 and "did you mean 'teensy'" in err


def test_drivers_are_listed_with_their_urls(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "stand", "drivers", "--json")
    found = {driver["name"]: driver for driver in json.loads(out)["drivers"]}
    assert code == 0 and found["motortest"]["spins"] and not found["motortest"]["measures"]
    _, text, _ = run(capsys, "stand", "drivers")
    assert all(driver["urls"] in text for driver in found.values())


def test_ones_own_sweeps_become_an_emulated_stand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "mine.toml"
    command = ["stand", "fit", SWEEPS / "g1_7.csv", SWEEPS / "g1_11.csv", "--name", "mine", "--diameter-m", "0.127",
               "--out", out]
    code, text, err = run(capsys, *command)
    assert code == 0, err
    assert "speed within 0.4 %" in text
    assert load_plant_file(str(out)).motor == load_plant_file("g1").motor
    code, _, err = run(capsys, *command)
    assert code == 2 and "never overwritten" in err


@pytest.mark.parametrize(("files", "more", "words"), [
    (["g1_7.csv"], ["--diameter-m", "5"], r"0.02..2"),
    (["short.csv"], ["--diameter-m", "0.1"], "at least 6 are needed"),
    (["bare.csv"], ["--diameter-m", "0.1"], "a fit needs ESC signal"),
])
def test_sweeps_that_cannot_be_fitted_are_refused(
        files: list[str], more: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = (SWEEPS / "g1_7.csv").read_text(encoding="utf-8-sig").splitlines()
    (tmp_path / "g1_7.csv").write_text("\n".join(lines))
    (tmp_path / "short.csv").write_text("\n".join(lines[:5]))
    (tmp_path / "bare.csv").write_text("Time (s),Thrust (N)\n0,1\n1,2\n")
    code, _, err = run(capsys, "stand", "fit", *[tmp_path / f for f in files], "--name", "x", "--out",
                       tmp_path / "x.toml", *more)
    assert code == 2 and words in err
    assert not (tmp_path / "x.toml").exists()
