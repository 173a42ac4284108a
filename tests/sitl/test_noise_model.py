"""Measured noise models: the file, what is refused, what a flight hears of it, and what it says of itself."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bench.cli import app, main
from saranga.echo import load_sonar
from saranga.errors import UsageError
from sitl.acoustics.atmosphere import StandardAir
from sitl.acoustics.noise_model import NoiseModel, load_noise_model, save_noise_model
from sitl.acoustics.shield import Shield, load_shield, load_shielding, shield_path
from sitl.acoustics.sonar import AcousticModel
from sitl.airframe import load_airframe
from sitl.primitives import Primitives

HOVER_N = 0.46 * 9.80665 / 4
STILL = (np.array([0.0, 0.0, -1.0]), np.array([1.0, 0, 0, 0]), np.zeros(3))
THRUST = (0.4, 0.8, 1.2, 1.6)
GEOMETRY = load_sonar("pair")
BARE = AcousticModel(Primitives.empty(), StandardAir(), GEOMETRY, load_shield("none"), 1)


def swept(**changes: object) -> NoiseModel:
    """Losses of 8 to 14 dB over a reference that grows as T^1.25."""
    reference = tuple(0.2 * (t / 1.2) ** 1.25 for t in THRUST)
    noise = tuple(r * 10 ** (-loss / 20) for r, loss in zip(reference, (8.0, 10.0, 12.0, 14.0), strict=True))
    values: dict[str, object] = {
        "name": "bench-foam", "description": "a test's own", "origin": "measured", "source": "sweep 7, HQ 3x4x3",
        "thrust_n": THRUST, "noise_rms": noise, "reference_rms": reference, "hub_distance_m": 0.07}
    return NoiseModel(**(values | changes))  # type: ignore[arg-type]


def heard(shield: Shield | NoiseModel) -> AcousticModel:
    return AcousticModel(Primitives.empty(), StandardAir(), GEOMETRY, shield, 1)


def test_a_file_reads_back_as_the_same_model(tmp_path: Path) -> None:
    for model in (swept(), swept(reference_rms=None, description='quotes " and \\ and\nlines'),
                  swept(interval_low_db=(7.0, 9, 11, 13), interval_high_db=(9.0, 11, 13, 15))):
        path = save_noise_model(model, tmp_path / "deep" / "noise-model.toml")
        assert load_noise_model(path) == model
        assert not list(path.parent.glob("*.part"))


def test_insertion_loss_is_made_from_the_two_levels_and_interpolated() -> None:
    model = swept()
    assert model.insertion_loss_db == pytest.approx((8.0, 10.0, 12.0, 14.0))
    assert model.loss_at_db(np.array([0.8, 1.0, 1.6])) == pytest.approx([10.0, 11.0, 14.0])
    # Beyond the sweep nothing was measured: the nearest end holds.
    assert model.loss_at_db(np.array([0.0, 0.1, 3.0])) == pytest.approx([8.0, 8.0, 14.0])
    assert list(model.outside(np.array([0.39, 0.4, 1.6, 1.61]))) == [True, False, False, True]


def test_level_beyond_the_sweep_follows_the_law_of_thrust() -> None:
    model = swept()
    assert model.rms_at(np.array([3.2])) == pytest.approx(model.noise_rms[-1] * 2**1.25)
    assert model.rms_at(np.array([0.2])) == pytest.approx(model.noise_rms[0] * 0.5**1.25)
    assert model.rms_at(np.array([0.0])) == 0.0
    assert model.rms_at(np.array([1.0])) == pytest.approx((model.noise_rms[1] + model.noise_rms[2]) / 2)


def test_with_a_reference_each_motor_loses_what_was_measured_at_its_thrust() -> None:
    model = heard(swept())
    for thrust_n, loss_db in ((0.8, 10.0), (1.2, 12.0), (1.4, 13.0)):
        assert model.insertion_loss_db("left", np.full(4, thrust_n)) == pytest.approx(loss_db)
    # One motor alone, then all: powers add.
    alone = [heard(swept()).noise_rms_counts("left", thrust) ** 2 - 60.0**2 for thrust in np.diag([0.8, 1.2, 1.6, 1.0])]
    together = model.noise_rms_counts("left", np.array([0.8, 1.2, 1.6, 1.0])) ** 2 - 60.0**2
    assert together == pytest.approx(sum(alone), rel=1e-9)
    # The records themselves are as much quieter.
    quiet, loud = (np.concatenate([m.cycle(*STILL, np.full(4, 1.2), 25_600 * k, receive_only=True)["left"][4:]
                                   for k in range(60)]).astype(float) for m in (model, BARE))
    assert 10 * np.log10(np.mean(loud**2) / np.mean(quiet**2)) == pytest.approx(12.0, abs=0.3)


def test_without_a_reference_the_level_is_carried_by_distance() -> None:
    model = heard(swept(reference_rms=None))
    sensor = np.array(GEOMETRY.positions_m["left"])
    for motor, hub in enumerate(np.array(load_airframe().motor_positions_m)):
        thrust = np.zeros(4)
        thrust[motor] = 1.2
        distance_m = max(float(np.linalg.norm(hub - sensor)), 0.0381)
        wanted = 20_000 * swept().noise_rms[2] * 0.07 / distance_m
        assert np.sqrt(model.noise_rms_counts("left", thrust) ** 2 - 60.0**2) == pytest.approx(wanted, rel=1e-9)


def test_a_model_like_the_computed_foam_gives_the_noise_of_the_computed_foam() -> None:
    foam = heard(load_shield("foam"))
    loss_db = foam.insertion_loss_db("left")
    reference = tuple(0.2 * t for t in THRUST)
    model = heard(swept(reference_rms=reference, noise_rms=tuple(r * 10 ** (-loss_db / 20) for r in reference)))
    hover = np.full(4, HOVER_N)
    assert model.noise_rms_counts("left", hover) == pytest.approx(foam.noise_rms_counts("left", hover), rel=1e-9)


def test_a_sweep_that_says_nothing_about_hover_is_refused() -> None:
    with pytest.raises(UsageError, match=r"'bench-foam' was swept from 0.4 to 0.8 N.*hovering takes 1.13 N.*sweep to"):
        heard(swept(thrust_n=(0.4, 0.5, 0.6, 0.8)))
    heard(swept(thrust_n=(0.4, 0.5, 0.6, 0.95)))


def test_flight_beyond_the_sweep_is_counted_and_idling_on_the_ground_is_not() -> None:
    model = heard(swept())
    for k, thrust in enumerate(([0.0] * 4, [1.1] * 4, [1.1, 1.1, 1.1, 1.7], [0.3, 1.2, 1.2, 1.2])):
        model.cycle(*STILL, np.array(thrust), 25_600 * k)
    said = model.noise_provenance()
    assert said["origin"] == "measured" and said["source"] == "sweep 7, HQ 3x4x3"
    assert said["cycles"] == 3
    assert said["above_sweep_share"] == pytest.approx(1 / 3) and said["below_sweep_share"] == pytest.approx(1 / 3)
    assert said["largest_thrust_n"] == 1.7
    # The rig replaces the model on CONFIG: the count goes on.
    assert model.with_geometry(samples=128).noise_provenance()["cycles"] == 3
    assert BARE.noise_provenance()["origin"] == "simulated"


@pytest.mark.parametrize(("changes", "says"), [
    ({"thrust_n": (0.4, 0.8, 0.8, 1.6)}, r"thrust_n\[2\] is 0.8 after 0.8: it must increase"),
    ({"thrust_n": (0.4, 1.2, 0.8, 1.6)}, r"thrust_n\[2\]"),
    ({"thrust_n": (0.0, 0.8, 1.2, 1.6)}, r"thrust_n\[0\] is 0 N: it must be over 0"),
    ({"thrust_n": (), "noise_rms": (), "reference_rms": None}, "thrust_n has 0 values"),
    ({"thrust_n": (1.0,), "noise_rms": (0.1,), "reference_rms": None}, "thrust_n has 1 values"),
    ({"noise_rms": (0.1, 0.2, 0.3)}, "noise_rms has 3 values, thrust_n 4"),
    ({"noise_rms": (0.1, float("nan"), 0.3, 0.4)}, r"noise_rms\[1\] is nan: it must be a finite"),
    ({"reference_rms": (0.1, 0.2, float("inf"), 0.4)}, r"reference_rms\[2\] is inf"),
    ({"noise_rms": (0.0, 0.2, 0.3, 0.4)}, r"noise_rms\[0\] is 0: .* over 0 and at most 1.2"),
    ({"noise_rms": (0.1, 0.2, 0.3, 20_000.0)}, r"noise_rms\[3\] is 20000"),
    ({"insertion_loss_db": (8.0, 10.0, 12.0, 20.0)}, r"insertion_loss_db\[3\] is 20 dB.*there is 14.0 dB"),
    ({"reference_rms": None, "insertion_loss_db": (8.0, 10, 12, 14)}, "without reference_rms"),
    ({"interval_low_db": (7.0, 9, 11, 13)}, "belong together"),
    ({"interval_low_db": (9.0, 9, 11, 13), "interval_high_db": (7.0, 10, 12, 14)}, r"interval_low_db\[0\] is 9, over"),
    ({"origin": "guessed"}, "origin is 'guessed': it must be one of measured"),
    ({"hub_distance_m": float("nan")}, "hub_distance_m is nan"),
    ({"name": ""}, "name is empty")])
def test_what_no_measurement_can_be_is_refused(changes: dict[str, object], says: str) -> None:
    with pytest.raises(UsageError, match=says):
        swept(**changes)


@pytest.mark.parametrize(("change", "says"), [
    (("[noise_model]", "[noise]"), r"table \[shield\] is missing"),
    (("noise_rms =", "noise_rsm ="), "'noise_rsm' is not known"),
    (("hub_distance_m = 0.07", "hub_distance_m = nan"), "hub_distance_m"),
    (("hub_distance_m = 0.07", ""), "'hub_distance_m' is missing"),
    (("thrust_n = [0.4, 0.8", "thrust_n = [0.9, 0.8"), r"thrust_n\[1\] is 0.8 after 0.9"),
    (("thrust_n = [0.4", "thrust_n = [nan"), r"thrust_n"),
    (("thrust_n = [", "thrust_n = [[1], "), r"thrust_n"),
    (('origin = "measured"', 'origin = "guessed"'), "origin"),
    (("[noise_model]", "[noise_model]\nname = 3\n[x]"), "TOML|name"),
    (("[noise_model]", "[[noise_model]]"), "must be a table")])
def test_a_bad_file_is_named_with_its_key(tmp_path: Path, change: tuple[str, str], says: str) -> None:
    path = save_noise_model(swept(), tmp_path / "bad.toml")
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change))
    with pytest.raises(UsageError, match=says) as error:
        load_shielding(str(path))
    assert str(path) in str(error.value)


def test_empty_and_binary_files_are_refused(tmp_path: Path) -> None:
    for content in (b"", b"\xff\xfe\x00", b"[noise_model]\n"):
        path = tmp_path / "noise-model.toml"
        path.write_bytes(content)
        with pytest.raises(UsageError, match=r"noise-model\.toml"):
            load_shielding(str(path))


def test_one_loader_takes_names_paths_and_runs(tmp_path: Path) -> None:
    assert isinstance(load_shielding("foam"), Shield)
    one = save_noise_model(swept(), tmp_path / "run-a" / "noise-model.toml")
    assert load_shielding(str(one)) == load_shielding(str(tmp_path / "run-a")) == swept()
    for name in ("foam", "plastic"):
        save_noise_model(dataclasses.replace(swept(), name=name), tmp_path / "run-b" / name / "noise-model.toml")
    assert load_shielding(f"{tmp_path / 'run-b'}:plastic").name == "plastic"
    assert shield_path(f"{tmp_path / 'run-b'}:foam").parent.name == "foam"
    with pytest.raises(UsageError, match=r"holds 2 noise models: choose one of .*run-b:foam, .*run-b:plastic"):
        load_shielding(str(tmp_path / "run-b"))
    with pytest.raises(UsageError, match=r"no noise model 'mesh': known are foam, plastic"):
        load_shielding(f"{tmp_path / 'run-b'}:mesh")
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match="holds no noise model"):
        load_shielding(str(tmp_path / "empty"))
    with pytest.raises(UsageError, match=r"unknown shield 'foma' \(did you mean 'foam'"):
        load_shielding("foma")


def test_where_only_a_geometry_will_do_a_measurement_is_refused(tmp_path: Path) -> None:
    path = save_noise_model(swept(), tmp_path / "noise-model.toml")
    with pytest.raises(UsageError, match="measured noise model: here the geometry of a shield is needed"):
        load_shield(str(path))


def test_a_flight_on_a_measured_shield_is_judged_and_says_so(tmp_path: Path) -> None:
    save_noise_model(swept(), tmp_path / "sweep" / "noise-model.toml")
    result = CliRunner().invoke(app, ["fly", "poles", "--seed", "1", "--denoiser", "gaussian", "--json", "--shield",
                                      str(tmp_path / "sweep"), "--out", str(tmp_path / "runs")])
    assert result.exit_code in (0, 1), result.output
    said = json.loads(result.stdout)
    noise = said["provenance"]["shield_noise"]
    assert noise["origin"] == "measured" and noise["source"] == "sweep 7, HQ 3x4x3" and noise["cycles"] > 100
    assert len(said["provenance"]["sha256"]["shield"]) == 64
    assert "sweep 7, HQ 3x4x3" in (Path(said["run"]) / "report.html").read_text()
    # It is another world than the computed shield's.
    plain = CliRunner().invoke(app, ["fly", "poles", "--seed", "1", "--denoiser", "gaussian", "--json", "--out",
                                     str(tmp_path / "runs")])
    other = json.loads(plain.stdout)
    assert other["metrics"]["determinism_hash"] != said["metrics"]["determinism_hash"]
    assert other["provenance"]["shield_noise"]["origin"] == "simulated"


def test_a_bad_shield_on_the_command_line_exits_2_with_its_fault(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = save_noise_model(swept(), tmp_path / "noise-model.toml")
    path.write_text(path.read_text().replace("thrust_n = [0.4, 0.8", "thrust_n = [0.9, 0.8"))
    with pytest.raises(SystemExit) as stop:
        main(["fly", "poles", "--shield", str(path), "--out", str(tmp_path / "runs")])
    assert stop.value.code == 2
    assert "thrust_n[1] is 0.8 after 0.9" in capsys.readouterr().err
