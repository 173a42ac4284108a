"""`python -m saranga evaluate`."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from test_evaluation_recording import records, write

from saranga.__main__ import main
from saranga.denoise import load_denoiser
from saranga.errors import DeviceError, UsageError
from saranga.evaluation import comparison, loading
from saranga.evaluation.power import energy_of, idle_power_w, load_power
from saranga.evaluation.power.rapl import Rapl
from saranga.evaluation.sets import pair_set

QUICK = ["evaluate", "--images", "10", "--denoisers", "gaussian,tbd"]


@pytest.fixture(autouse=True)
def same_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command sets thread counts for itself; leave the process as it was."""
    monkeypatch.setattr(os, "environ", os.environ.copy())


def test_json_has_what_scripts_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "made" / "here"
    assert main([*QUICK, "--psnr", "10,-4.9", "--json", "--out", str(out)]) == 0
    printed = capsys.readouterr()
    tree = json.loads(printed.out)
    assert json.loads((out / "evaluation.json").read_text()) == tree
    assert set(tree["methods"]) == {"gaussian", "tbd"} and set(tree["baseline"]) == {"nothing"}
    for method in tree["methods"].values():
        assert set(method["hit_rate"]) == set(method["hit_rate_strongest"]) == {"10", "-4.9"}
        low, high = method["hit_rate_interval"]["10"]
        assert 0 <= low <= method["hit_rate"]["10"] <= high <= 1
        assert method["false_alarms_per_frame"] < 1 and 0 < method["f1"] <= method["f1_within_5cm"] <= 1
        assert 0 < method["median_error_m"] < 0.05 and 0 < method["ms_per_image"] < 100
        assert set(method["sets"]) == {"constant", "single", "multiple"}
        assert method["sets"]["single"]["10"]["azimuth"]["one_to_one"]["hits"] > 0
        assert method["sets"]["constant"]["10"]["azimuth"] == {}
    assert tree["methods"]["tbd"]["hit_rate_strongest"]["10"] >= 0.9
    nothing = tree["baseline"]["nothing"]
    assert nothing["hit_rate"]["10"] == 0 and nothing["median_error_m"] is None and nothing["f1"] == 0
    assert tree["complete"] is True and tree["run"] == str(out) and tree["provenance"]["seed"] == 20260
    assert tree["psnr"]["over_one_quadrature_db"] == pytest.approx(3.0103, abs=1e-4)
    assert tree["psnr"]["psnr_image_db"]["single"]["10"] >= 10.0
    with np.load(out / "examples.npz", allow_pickle=False) as file:
        names = list(file["methods"])
        assert file["images"].shape == (12, 32, 512) and file["edges"].shape == (12, 3, 512)
        k = next(i for i, (kind, psnr) in enumerate(zip(file["kind"], file["psnr_db"], strict=True))
                 if kind == "constant" and psnr == 10)
        batch = next(pair_set("constant", 10, 10.0).batches())
        assert np.array_equal(file["images"][k], batch.images[0, 0])
        assert file["truth_range_m"][k, 0] == pytest.approx(batch.truth["path_m"][0, 0, 0] / 2)
        assert not file["edges"][k, names.index("nothing")].any() and file["edges"][k, names.index("tbd")].any()
    assert sorted(p.name for p in out.iterdir()) == ["evaluation.json", "examples.npz"]


def test_tables_for_people_show_the_baseline(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*QUICK, "--psnr", "15", "--sets", "constant,single", "--seed", "3"]) == 0
    text = capsys.readouterr().out
    assert "constant: one reflector of constant strength" in text and "multiple" not in text
    rows = [line.split() for line in text.splitlines() if line.startswith("nothing")]
    assert rows[0] == ["nothing", "0/0/0"] and len(rows) == 4
    assert "over one quadrature add 3.01 dB" in text


def test_interrupted_keeps_the_sets_that_are_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                      capsys: pytest.CaptureFixture[str]) -> None:
    real = comparison.Comparison._add_point

    def interrupt(self: comparison.Comparison, pairs, found) -> None:  # type: ignore[no-untyped-def]
        if pairs.psnr_db == 0.0:
            raise KeyboardInterrupt
        real(self, pairs, found)

    monkeypatch.setattr(comparison.Comparison, "_add_point", interrupt)
    assert main([*QUICK, "--psnr", "10,0", "--json", "--out", str(tmp_path)]) == 130
    printed = capsys.readouterr()
    assert "interrupted: 3 sets are finished" in printed.err
    for tree in (json.loads(printed.out), json.loads((tmp_path / "evaluation.json").read_text())):
        assert tree["complete"] is False
        assert list(tree["methods"]["tbd"]["hit_rate"]) == ["10"] and tree["methods"]["tbd"]["f1"] > 0
    assert [s["kind"] for s in tree["sets"]] == ["noise", "mix", "constant"]


def test_what_cannot_be_loaded_is_said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
                                       tmp_path: Path) -> None:
    def load(name: str, **options: object):  # type: ignore[no-untyped-def]
        if name == "tdlms":
            raise DeviceError("weights 'x' are missing: train them first")
        if name.startswith("tv"):
            raise ImportError("No module named 'scipy'")
        return load_denoiser(name, **options)

    monkeypatch.setattr(loading, "load_denoiser", load)
    monkeypatch.setattr(loading, "denoiser_names", lambda: ["gaussian", "tdlms", "tv-l1"])
    path = write(tmp_path / "x.mcap", records(4, 1.0, 8.0))
    command = ["evaluate", "--recording", str(path), "--truth-m", "1.0"]
    assert main([*command, "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert list(tree["methods"]) == ["gaussian"]
    assert tree["skipped"] == {"tdlms": "weights 'x' are missing: train them first",
                               "tv-l1": "No module named 'scipy'"}
    assert main(command) == 0
    assert "skipped tv-l1: No module named 'scipy'" in capsys.readouterr().out
    assert main([*command, "--denoisers", "tv-l1"]) == 4
    assert "denoiser 'tv-l1' cannot be loaded: No module named 'scipy'" in capsys.readouterr().err


def test_a_recording_as_json_and_as_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "x.mcap", records(12, 2.5, 8.0))
    command = ["evaluate", "--recording", str(path), "--denoisers", "gaussian,tbd"]
    assert main([*command, "--json", "--truth-m", "2.5", "--tolerance-m", "0.05", "--out", str(tmp_path / "o")]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert json.loads((tmp_path / "o" / "evaluation.json").read_text()) == tree
    for method in tree["methods"].values():
        assert method["frames"] == 12 and method["hit_rate"] >= 0.9 and method["median_error_m"] < 0.02
        assert method["false_alarms_per_frame"] < 0.5
    assert tree["recording"]["lost"]["frames_missing"] == 0 and tree["truth"]["source"] == "given"
    path.write_bytes(path.read_bytes()[:-300])
    assert main([*command, "--temperature", "20"]) == 0
    printed = capsys.readouterr()
    assert "(consensus), +-0.1 m" in printed.out and "12 of 12 frames" in printed.out
    assert "warning:" in printed.err and "cut off" in printed.err


def test_bad_input_is_one_line_and_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(write(tmp_path / "x.mcap", records(3, 1.0)))
    (tmp_path / "evaluation.json").write_text("{}")
    (tmp_path / "flight.csv").write_text("1,2\n")
    for more, words in (
        (["--denoisers", "tdb"], "unknown denoiser 'tdb' (did you mean 'tbd'?)"),
        (["--denoisers", "tbd,tbd"], "name each wanted one once"),
        (["--images", "3"], "--images is 3: it must be 10..100000"),
        (["--psnr", "10,x"], "give numbers of dB"),
        (["--psnr", "10,nan"], "within -30..60 dB"),
        (["--sets", "constant,double"], "give some of constant, single, multiple"),
        (["--power", "raple"], "unknown power source 'raple' (did you mean 'rapl'?)"),
        (["--out", str(tmp_path)], "exists: results are never overwritten"),
        (["--truth-m", "1"], "--truth-m needs --recording FILE"),
        (["--recording", path, "--images", "50"], "--images is for the common sets"),
        (["--recording", path, "--truth-m", "far"], "give metres or 'consensus'"),
        (["--recording", path, "--truth-m", "9"], "--truth-m 9 m is outside the record"),
        (["--recording", path, "--tolerance-m", "-1"], "--tolerance-m -1 m: it must be over 0"),
        (["--recording", path, "--columns-m", "0"], "--columns-m 0 m"),
        (["--recording", path, "--role", "down"], "no frame of a sensor 'down'"),
        (["--recording", path, "--temperature", "200"], "--temperature 200 C"),
        (["--recording", str(tmp_path / "flight.csv")], "opens no known format"),
        (["--recording", str(tmp_path / "no.mcap")], "does not exist"),
    ):
        assert main(["evaluate", *more]) == 2, more
        message = capsys.readouterr().err
        assert message.startswith("error: ") and words in message and message.count("\n") == 1, message


def counters(root: Path, energy_uj: int) -> Path:
    for name, value in (("intel-rapl:0", energy_uj), ("intel-rapl:0:0", 7), ("intel-rapl:1", 2 * energy_uj)):
        zone = root / name
        zone.mkdir(parents=True, exist_ok=True)
        (zone / "energy_uj").write_text(f"{value}\n")
        (zone / "max_energy_range_uj").write_text("1000000\n")
    return root


def test_energy_counters_are_summed_and_followed_when_they_wrap(tmp_path: Path) -> None:
    meter = Rapl(counters(tmp_path, 400_000))
    counters(tmp_path, 450_000)
    assert meter.energy_j() == pytest.approx(0.05 + 0.10)  # packages alone, not their parts
    counters(tmp_path, 100_000)
    assert meter.energy_j() == pytest.approx(0.15 + 0.65 + 0.30)
    with pytest.raises(DeviceError, match=r"no energy counters in .*leave out --power"):
        load_power("rapl", root=tmp_path / "none")
    with pytest.raises(UsageError, match="has no option 'path'"):
        load_power("rapl", path=tmp_path)


@pytest.mark.wall_time
def test_energy_an_inference_is_over_the_idle_power() -> None:
    """A load of 10 W above 5 W idle, of which a call takes 20 ms."""
    from time import perf_counter, sleep

    class Meter:
        name = "fake"
        busy_s = 0.0

        def energy_j(self) -> float:
            return 5.0 * perf_counter() + 10.0 * self.busy_s

    meter = Meter()

    def call() -> None:
        began = perf_counter()
        sleep(0.02)
        meter.busy_s += perf_counter() - began

    idle_w = idle_power_w(meter, 0.05)
    found = energy_of(call, meter, idle_w, 0.3)
    assert idle_w == pytest.approx(5.0, rel=0.01) and found.calls >= 10
    assert found.net_mj == pytest.approx(10.0 * 20, rel=0.2) and found.gross_mj == pytest.approx(15.0 * 20, rel=0.2)
