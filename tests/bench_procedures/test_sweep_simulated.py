"""Whole sweeps of the emulated device in simulated time: what it was given is found, and bad input loses nothing."""

import csv
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from sweep_helpers import Silent, plan_of, sweep

from bench.interrupt import Interrupts
from bench.journal import FILE_NAME, read_journal
from bench.procedures.analysis import headline
from bench.procedures.bench import Bench, Heard
from bench.procedures.emulated_device import EmulatedSpec
from bench.procedures.points import points_of, read_sweep
from bench.procedures.schedule import schedule
from bench.procedures.shields_command import compare_shields
from bench.procedures.sweep_page import write_sweep_page
from bench.procedures.sweep_session import plan_of_run, rebuild_sweep, steps_left
from bench.procedures.sweep_summary import summarise_sweeps
from bench.thrust_stand.protocol import StandReading
from saranga.errors import UsageError
from saranga.fixtures import fixture_names
from saranga.recording import read_recording
from sitl.acoustics.noise_model import load_noise_model

GIVEN = {"foam": 12.0, "plastic": 9.0}
QUIET = EmulatedSpec(sonar="batdeck", mounting_sd_db=0.0, shields=("foam=12", "plastic=9"))
ONE_SENSOR = {"rig": {"frames": 20, "rate_hz": 50.0, "sensor": "left"}}


class Wrapped:
    """A bench that spoils what comes from the stand."""

    def __init__(self, bench: Bench, spoil: Any) -> None:
        self._bench = bench
        self._spoil = spoil
        self.wanted = 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bench, name)

    def set_throttle(self, value: float) -> None:
        self.wanted = value
        self._bench.set_throttle(value)

    def poll(self, timeout_s: float) -> Heard:
        heard = self._bench.poll(timeout_s)
        return Heard([self._spoil(r) for r in heard.readings], heard.cycles)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """One whole sweep with recordings, the devices with two sensors."""
    spec = replace(QUIET, sonar="pair", mounting_sd_db=0.2, seed=5)
    summary, run = sweep(tmp_path_factory.mktemp("runs"), plan_of(drift_check=True), spec, record=True)
    return summary, run.folder


def test_the_given_insertion_loss_is_found_within_half_a_decibel(done: tuple[dict[str, Any], Path]) -> None:
    summary, _ = done
    for name, given in GIVEN.items():
        found = summary["insertion_loss_db"][name]
        assert found["value"] == pytest.approx(given, abs=0.5)
        assert found["interval"][0] < given < found["interval"][1]
    assert summary["comparisons"][0]["answer"] == "quieter"
    assert summary["fits"]["none"]["power_law"]["coefficients"][1] == pytest.approx(1.25, abs=0.03)
    assert summary["verdict"] in ("PASS", "MARGINAL")
    assert summary["origin"] == "emulated"
    assert set(summary["other_sensors"]) == {"right"}
    assert summary["coherence"]["by_condition"]["none"] < 0.05


def test_everything_raw_is_kept_and_the_report_is_rebuilt_from_the_journal(done: tuple[dict[str, Any], Path]) -> None:
    summary, folder = done
    records = read_journal(folder / FILE_NAME)
    steps = records.of("step")
    assert len(steps) == len(schedule(plan_of(drift_check=True))) == summary["metrics"]["steps_planned"]
    for key in ("step", "block", "shield", "throttle", "phase", "thrust_n", "rpm", "noise", "settled", "origin"):
        assert key in steps[5]
    frames = sum(1 for _ in read_recording(folder / "echoes.mcap").frames())
    assert frames > 2 * sum(s["noise"]["left"]["frames"] for s in steps)
    rows = list(csv.DictReader((folder / "stand.csv").open()))
    assert {int(r["step"]) for r in rows} == {s["step"] for s in steps}
    again = rebuild_sweep(folder)
    assert json.loads(json.dumps(again, default=str)) == json.loads((folder / "summary.json").read_text())
    assert again["insertion_loss_db"] == summary["insertion_loss_db"]
    page = write_sweep_page(folder).read_text()
    assert "emulated" in page and page.count("<svg") >= 5
    assert not re.search(r"<script|<link|src=|@import", page)  # works offline


def test_noise_models_read_back_and_name_their_source(done: tuple[dict[str, Any], Path]) -> None:
    summary, folder = done
    model = load_noise_model(folder / summary["noise_models"]["foam"])
    assert model.origin == "emulated"
    assert folder.name in model.source
    assert model.insertion_loss_db is not None
    assert all(abs(v - GIVEN["foam"]) < 0.8 for v in model.insertion_loss_db)
    assert model.interval_low_db is not None and model.interval_high_db is not None
    assert model.reference_rms is not None


def test_the_same_seeds_give_the_same_numbers(tmp_path: Path) -> None:
    plan = plan_of(blocks=1, **ONE_SENSOR)
    one, _ = sweep(tmp_path, plan, QUIET)
    two, _ = sweep(tmp_path, plan, QUIET)
    assert one["points"] == two["points"]
    assert one["insertion_loss_db"]["foam"]["interval"] is None
    assert one["verdict"] != "PASS"
    assert any(c["name"] == "blocks" and c["verdict"] == "FAIL" for c in one["checks"])


def test_an_interrupted_sweep_is_readable_and_goes_on_to_the_same_steps(tmp_path: Path) -> None:
    plan = plan_of(**ONE_SENSOR)
    interrupts = Interrupts()

    def stop_after(count: int) -> None:
        if count == 14:
            interrupts.signal_name = "SIGINT"

    cut, run = sweep(tmp_path, plan, QUIET, interrupts, Silent(stop_after), record=True)
    assert cut["state"] == "interrupted"
    assert cut["metrics"]["steps"] == 14
    assert cut["verdict"] in ("INCONCLUSIVE", "FAIL")
    stopped = read_journal(run.folder / FILE_NAME).of("stopped")[-1]
    assert stopped["report"]["idle"] is True
    assert plan_of_run(run.folder) == plan
    assert len(steps_left(run.folder, plan)) == len(schedule(plan)) - 14
    whole, again = sweep(tmp_path, plan, QUIET, resume=run.folder, record=True)
    assert again.folder == run.folder
    assert whole["state"] == "finished"
    assert whole["metrics"]["steps"] == len(schedule(plan))
    assert (run.folder / "echoes-2.mcap").is_file()
    sweep_again = read_sweep(run.folder)
    assert [s["step"] for s in sweep_again.steps] == list(range(len(schedule(plan))))
    assert whole["insertion_loss_db"]["foam"]["value"] == pytest.approx(12.0, abs=0.5)


def test_a_torn_journal_still_gives_its_finished_steps(tmp_path: Path) -> None:
    _, run = sweep(tmp_path, plan_of(**ONE_SENSOR), QUIET)
    journal = run.folder / FILE_NAME
    data = journal.read_bytes()
    lines = data.split(b"\n")
    steps = [k for k, line in enumerate(lines) if b'"kind":"step"' in line]
    journal.write_bytes(b"\n".join(lines[:steps[20]]) + b"\n" + lines[steps[20]][:40])
    summary = rebuild_sweep(run.folder)
    assert summary["metrics"]["steps"] == 20
    assert summary["state"] == "cut off"
    assert summary["verdict"] == "ERROR"


@pytest.mark.parametrize(("spoil", "message"), [
    (lambda r: replace(r, thrust_n=math.nan), "thrust readings are NaN"),
    (lambda r: replace(r, thrust_n=-r.thrust_n), "wrong way round"),
])
def test_a_stand_that_reads_nonsense_stops_the_sweep_and_loses_nothing(tmp_path: Path, spoil: Any,
                                                                       message: str) -> None:
    benches: list[Wrapped] = []

    def wrap(bench: Bench) -> Wrapped:
        benches.append(Wrapped(bench, spoil))
        return benches[0]

    summary, run = sweep(tmp_path, plan_of(**ONE_SENSOR), QUIET, wrap=wrap)
    assert summary["verdict"] == "ERROR"
    assert summary["state"] == "failed"
    assert message in summary["errors"][0]
    records = read_journal(run.folder / FILE_NAME)
    assert records.of("stopped")[-1]["report"]["confirmed"] is True
    assert [s["phase"] for s in records.of("step")] == ["background"]
    assert not list(run.folder.glob("noise-model-*.toml"))


def test_a_dead_sensor_is_named_and_a_rig_without_a_stand_refused(tmp_path: Path) -> None:
    summary, _ = sweep(tmp_path, plan_of(), replace(QUIET, sonar="pair", faults=("dead_sensor=left",)))
    assert summary["verdict"] == "ERROR"
    assert "0 of 20 records of sensor 'left'" in summary["errors"][0]
    with pytest.raises(UsageError, match="not one it was given"):
        sweep(tmp_path, plan_of(conditions=[{"name": "a", "shield": "velvet"}]),
              replace(QUIET, shields=("velvet=3", "foam=2")), wrap=lambda b: _mounting_unknown(b))


def _mounting_unknown(bench: Any) -> Any:
    mount = bench.mount
    bench.mount = lambda condition: mount(condition.model_copy(update={"shield": "silk"}))
    return bench


def test_levels_by_thrust_are_reached(tmp_path: Path) -> None:
    plan = plan_of(blocks=1, levels={"thrusts_n": [0.6, 1.5, 2.5]}, conditions=[{"name": "bare"}], **ONE_SENSOR,
                   settle={"least_s": 0.3, "window_s": 0.3, "most_s": 8.0})
    summary, _ = sweep(tmp_path, plan, QUIET)
    wanted = {s.step: s.level for s in schedule(plan)}
    for p in summary["points"]:
        assert p["thrust_n"] == pytest.approx(wanted[p["step"]], rel=0.02)


def test_a_shield_so_good_that_only_the_background_is_heard_has_a_bound_and_no_value(tmp_path: Path) -> None:
    summary, _ = sweep(tmp_path, plan_of(**ONE_SENSOR), replace(QUIET, shields=("foam=58", "plastic=9")))
    foam = summary["insertion_loss_db"]["foam"]
    assert foam["value"] is None
    assert "at least" in foam["why"]
    assert any(c["name"] == "insertion_loss_db of foam" and c["verdict"] == "INCONCLUSIVE" for c in summary["checks"])
    assert "foam" not in {p["condition"] for p in summary["points"] if p["usable"]}


def test_several_runs_are_read_as_one_and_mixed_ones_refused(tmp_path: Path) -> None:
    plan = plan_of(blocks=2, **ONE_SENSOR)
    folders = [sweep(tmp_path, plan, replace(QUIET, seed=k, mounting_sd_db=0.3))[1].folder for k in (1, 2)]
    both = compare_shields(folders, at_thrust_kgf=0.15)
    assert both["insertion_loss_db"]["foam"]["blocks"] == 4
    assert both["target_kgf"] == 0.15
    assert load_noise_model(folders[-1] / both["noise_models"]["foam"]).source.count("run ") == 2
    with pytest.raises(UsageError, match="twice"):
        compare_shields([folders[0], folders[0]])
    other = plan_of(blocks=1, conditions=[{"name": "none", "reference": True}, {"name": "foam", "shield": "plastic"}],
                    **ONE_SENSOR)
    strange = sweep(tmp_path, other, QUIET)[1].folder
    with pytest.raises(UsageError, match="not the same"):
        compare_shields([folders[0], strange])
    with pytest.raises(UsageError, match="kgf"):
        compare_shields([folders[0]], at_thrust_kgf=-1.0)


def _coverage(root: Path, seeds: range) -> tuple[int, int, float]:
    """(intervals that cover, intervals, largest error of a mean over all seeds) for mountings that differ by 0.5 dB."""
    plan = plan_of(rig={"frames": 10, "rate_hz": 100.0, "sensor": "left"}, levels={"throttles": [0.3, 0.6]},
                   settle={"least_s": 0.1, "window_s": 0.1, "most_s": 2.0, "per_second": 0.2, "floor_n": 0.2})
    hits = total = 0
    errors: dict[str, list[float]] = {name: [] for name in GIVEN}
    for seed in seeds:
        folder = sweep(root, plan, replace(QUIET, seed=seed, mounting_sd_db=0.5))[1].folder
        analysis = summarise_sweeps([read_sweep(folder)])["analysis"]
        for name, given in GIVEN.items():
            loss = analysis.losses[name]
            estimate = headline(loss)[0]
            assert estimate.low is not None and estimate.high is not None
            hits += estimate.low <= given <= estimate.high
            errors[name].append(estimate.value - given)
            total += 1
    return hits, total, max(abs(sum(e) / len(e)) for e in errors.values())


def test_intervals_cover_what_was_given_over_a_few_seeds(tmp_path: Path) -> None:
    hits, total, bias_db = _coverage(tmp_path, range(1, 5))
    assert total == 8
    assert hits >= 6  # fewer happen once in 170 times at 95 %
    assert bias_db < 0.5


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_intervals_cover_what_was_given_at_the_nominal_rate_over_a_hundred_seeds(tmp_path: Path) -> None:
    hits, total, bias_db = _coverage(tmp_path, range(1, 101))
    print(f"covered {hits} of {total}, largest bias {bias_db:.3f} dB")
    assert total == 200
    # 190 expected, 3.1 its deviation, a little more as two shields share a reference: three of them either side.
    assert 180 <= hits <= 199
    assert bias_db < 0.15  # 0.5 dB of mounting over 300 mountings leaves 0.03


def test_every_shipped_noise_plan_runs_to_its_end_on_emulated_hardware(tmp_path: Path) -> None:
    from bench.procedures.plan import NoisePlan, load_plan

    for name in fixture_names("plans"):
        plan = load_plan(name)
        if not isinstance(plan, NoisePlan):
            continue
        short = plan.model_copy(update={
            "blocks": 1, "levels": plan.levels.model_copy(update={"throttles": plan.levels.throttles[:2]}),
            "rig": plan.rig.model_copy(update={"frames": 10}),
            "settle": plan.settle.model_copy(update={"least_s": 0.2, "window_s": 0.2})})
        summary, run = sweep(tmp_path, short, EmulatedSpec(sonar="batdeck"))
        assert summary["state"] == "finished", summary["errors"]
        assert len(points_of(read_sweep(run.folder))) >= 2


def test_readings_are_written_blank_where_nothing_is_measured(tmp_path: Path) -> None:
    from bench.procedures.stand_file import StandFile

    file = StandFile(tmp_path / "stand.csv")
    file.write(3, [StandReading(time_s=1.5, thrust_n=2.0)])
    file.close()
    with (tmp_path / "stand.csv").open("a") as torn:
        torn.write("4,1.6,2.")
    again = StandFile(tmp_path / "stand.csv")
    again.write(5, [StandReading(time_s=1.7, rpm=100.0)])
    again.close()
    rows = list(csv.DictReader((tmp_path / "stand.csv").open()))
    assert [r["step"] for r in rows] == ["3", "5"]
    assert (rows[0]["thrust_n"], rows[0]["rpm"], rows[1]["rpm"]) == ("2", "", "100")
