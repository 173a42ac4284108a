"""`rig check`: a healthy emulated rig passes, and each planted fault is found and named."""

import pytest
from simulated_rig import SimulatedLink, simulated_check

from bench.rig.check import CheckPlan, examine, gather, known_limits
from bench.rig.driver import Rig
from bench.rig.faults import fault_names
from bench.verdict import Verdict, load_limits

# fault -> the check that must fail, and what its cause must say
FOUND = {
    "swapped_sensors": ("reflector_side", "swapped"),
    "dead_transmitter": ("transmit_counts left", "no sound"),
    "desync_us": ("sync_offset_us right", "desynchronised"),
    "desync_us=800": ("sync_coherence right", "desynchronised"),
    "desync_jitter_us": ("sync_coherence right", "desynchronised"),
    "desync_jitter_us=10": ("sync_coherence right", "desynchronised"),
    "fop_drift_hz_s": ("fop_drift_hz_s left", "fop is drifting"),
    "fop_drift_hz_s=-8": ("fop_drift_hz_s right", "fop is drifting"),
    "missing_horn": ("ring_down_ratio left", "horn is missing"),
    "dead_sensor": ("frames_received_share right", "right sensor sent 0 records"),
    "dead_sensor=left": ("link_wrong_share left", "did not come"),
    "link_errors": ("link_wrong_share right", "came back wrong"),
    "noisy_sensor=left": ("noise_floor_counts left", "too loud"),
    "duplicates": ("frames_duplicated_share", "duplicates"),
    "repeats": ("frames_repeated_share left", "read twice"),
    "drops": ("frames_lost_share", "dropped"),
    "corrupt": ("frames_bad_share", "damaged"),
    "clock_ppm": ("clock_drift_ppm", "another speed"),
    "reset_at_s=4": ("device_restarts", "started again"),
    "unplug_at_s=4": ("cable_losses", "port was lost 1 times"),
}
# Seen by others: the driver refuses or gives up (test_rig_driver.py), or they are of the stand.
ELSEWHERE = {"unplug_for_s", "hang_at_s", "firmware", "protocol", "no_dead_man", "throttle_stuck", "nan_stand_at_s",
             "negative_thrust"}


@pytest.mark.parametrize("sonar", ["pair", "triple"])
@pytest.mark.parametrize("seed", range(1, 4))
def test_a_healthy_rig_passes_every_check(sonar, seed):
    verdict, checks = simulated_check(sonar=sonar, seed=seed)
    assert verdict is Verdict.PASS, {name: row["why"] for name, row in checks.items() if row["verdict"] != "PASS"}
    assert {row["origin"] for row in checks.values()} == {"emulated"}
    assert all(row["cause"] == "" for row in checks.values())


@pytest.mark.parametrize("fault", FOUND)
def test_a_planted_fault_is_found_and_named(fault):
    more = ["unplug_for_s=1"] if fault.startswith("unplug") else []
    verdict, checks = simulated_check(fault, *more)
    name, cause = FOUND[fault]
    assert verdict is Verdict.FAIL
    assert checks[name]["verdict"] == "FAIL" and cause in checks[name]["cause"]


def test_every_fault_of_the_emulator_is_looked_for():
    assert {text.partition("=")[0] for text in FOUND} | ELSEWHERE == set(fault_names())


def test_one_per_cent_of_duplicates_is_found_whatever_the_seed():
    # 1000 frames: none is a duplicate with probability 4e-5.
    for seed in range(2, 6):
        verdict, checks = simulated_check("duplicates=0.01", seed=seed)
        assert verdict is Verdict.FAIL and checks["frames_duplicated_share"]["verdict"] == "FAIL", seed


def test_a_dead_transmitter_leaves_open_what_needs_its_sound():
    _, checks = simulated_check("dead_transmitter")
    assert {name for name, row in checks.items() if row["verdict"] == "INCONCLUSIVE"} == {
        "ring_down_ms left", "ring_down_ratio left", "sync_offset_us right", "sync_coherence right", "reflector_side"}


@pytest.mark.parametrize(("where", "why"), [("none", "no reflector is heard"), ("0.8,2", "straight ahead")])
def test_without_a_reflector_to_the_side_the_roles_stay_open(where, why):
    verdict, checks = simulated_check(emulated={"reflector": where})
    assert verdict is Verdict.INCONCLUSIVE and why in checks["reflector_side"]["why"]
    verdict, checks = simulated_check(emulated={"reflector": where}, reflector="none")
    assert verdict is Verdict.PASS and "reflector_side" not in checks


def test_a_reflector_on_the_other_side_than_said_fails():
    verdict, checks = simulated_check(emulated={"reflector": "0.8,-30"})
    assert verdict is Verdict.FAIL and checks["reflector_side"]["value"] < -0.4
    verdict, _ = simulated_check(emulated={"reflector": "0.8,-30"}, reflector="left")
    assert verdict is Verdict.PASS


def test_a_reflector_at_a_known_distance_is_ranged():
    # 0.8 m from the middle to the pole's axis, 0.03 m radius; the left sensor is 0.03 m further away.
    verdict, checks = simulated_check(reflector_range_m=0.8)
    assert verdict is Verdict.PASS and checks["reflector_range_error_m left"]["value"] == pytest.approx(0.0, abs=0.02)
    verdict, checks = simulated_check(reflector_range_m=1.0)
    assert verdict is Verdict.FAIL and "ranged wrongly" in checks["reflector_range_error_m left"]["cause"]


def test_a_limit_that_asks_for_measured_values_does_not_take_emulated_ones(tmp_path):
    path = tmp_path / "strict.toml"
    path.write_text('[limits.noise_floor_counts]\nunit = "counts"\nat_most = 200\nrequires = "measured"\n'
                    'reason = "r"\nsource = "s"\n')
    link = SimulatedLink()
    rig = Rig(link, now=link.now)
    rig.open()
    rows = examine(gather(rig, CheckPlan("emulated:")), load_limits(str(path)), rig.origin)
    floors = [row for row in rows if row["name"].startswith("noise_floor")]
    assert [row["verdict"] for row in floors] == ["INCONCLUSIVE"] * 2
    # What the file has no limit for never passes either.
    assert {row["verdict"] for row in rows} == {"INCONCLUSIVE"}


def test_every_shipped_limit_belongs_to_a_check():
    _, checks = simulated_check(reflector_range_m=0.8)
    assert {name.partition(" ")[0] for name in checks} == set(known_limits())
