"""`saranga-bench rig check`: two short runs of the rig, every check of `bench/rig/checks`, one verdict."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bench.rig.checks
from bench.findings import judge_finding
from bench.journal import FILE_NAME, open_journal
from bench.provenance import git_state, versions
from bench.rig.driver import Rig, open_rig
from bench.rig.evidence import Evidence
from bench.store import Store
from bench.verdict import Limit, Verdict, load_limits, worst
from saranga.echo import EchoCycle, load_sonar
from saranga.errors import BenchError, UsageError
from saranga.plugins import plugins
from saranga.wire import MODE_RECEIVE_ONLY, MODE_TRANSMIT_RECEIVE

ODR = 6
SAMPLES = 340
"""What the general-purpose firmware gives at most (hardware.md): 2.2 m."""
LOUD_SHARE = 0.6
Stop = Callable[[], bool]


@dataclass(frozen=True)
class CheckPlan:
    """What to do. `reflector`: side of the pole that the operator put up, or "none"; seconds of both runs together."""

    url: str
    seconds: float = 10.0
    rate_hz: float = 50.0
    sonar: str = "pair"
    reflector: str = "right"
    reflector_range_m: float | None = None
    temperature_c: float | None = None
    limits: str = "rig"

    def __post_init__(self) -> None:
        if not 3.0 <= self.seconds <= 600.0:
            raise UsageError(f"--seconds {self.seconds}: must be 3..600, for both runs together")
        if not 1.0 <= self.rate_hz <= 100.0:
            raise UsageError(f"--rate {self.rate_hz}: must be 1..100 Hz")
        if self.reflector not in ("left", "right", "none"):
            raise UsageError(f"--reflector {self.reflector!r}: must be left, right or none")
        if self.reflector_range_m is not None and not 0.3 <= self.reflector_range_m <= 2.0:
            raise UsageError(f"--range {self.reflector_range_m}: must be 0.3..2 m")


def gather(rig: Rig, plan: CheckPlan, stop: Stop = lambda: False) -> Evidence:
    """Self test, link test, a run with the transmitter on, a run without.

    Raises:
        DeviceError: the rig refuses, hangs, or does not come back.
    """
    assert rig.hello is not None
    evidence = Evidence(rig.hello, load_sonar(plan.sonar), asked_rate_hz=plan.rate_hz, reflector=plan.reflector,
                        reflector_range_m=plan.reflector_range_m)
    missing = [role for role in evidence.roles if role not in evidence.sonar.positions_m]
    if missing:
        raise UsageError(f"{rig.name}: the rig has a sensor {', '.join(missing)} that sonar {plan.sonar!r} does not: "
                         "name the right one with --sonar")
    evidence.tested = rig.self_test()
    wrong = rig.link_test()
    evidence.link_wrong = {s.role: wrong[s.sensor] for s in rig.hello.sensors if s.role}
    rig.configure(ODR, SAMPLES, ring_down_samples=0)
    # What came before the runs (a frame joined in its middle, the tests) is not their fault.
    before, cycles_before = deepcopy(rig.counters), deepcopy(rig.cycle_counters)
    evidence.loud = _run(rig, MODE_TRANSMIT_RECEIVE, plan, LOUD_SHARE, evidence, stop)
    evidence.quiet = _run(rig, MODE_RECEIVE_ONLY, plan, 1.0 - LOUD_SHARE, evidence, stop)
    for name in ("bad_cobs", "bad_crc", "bad_message", "sequence_gaps", "duplicates"):
        setattr(evidence.link, name, getattr(rig.counters, name) - getattr(before, name))
    evidence.incomplete = rig.cycle_counters.incomplete - cycles_before.incomplete
    evidence.missing = rig.cycle_counters.missing - cycles_before.missing
    evidence.overruns, evidence.restarts = rig.losses.overruns, rig.losses.restarts
    evidence.unplugged, evidence.silences = rig.losses.unplugged, rig.losses.silences
    evidence.drift, evidence.c_m_s = rig.clock.drift(), rig.sound_speed_m_s
    return evidence


def _run(rig: Rig, mode: int, plan: CheckPlan, share: float, evidence: Evidence, stop: Stop) -> list[EchoCycle]:
    cycles: list[EchoCycle] = []
    rig.start(mode, plan.rate_hz)
    began = rig.now()
    while rig.now() - began < plan.seconds * share and not stop():
        cycles += rig.poll(0.1)
    evidence.ran_s += rig.now() - began
    cycles += rig.stop()
    return [c for c in cycles if all(f.mode == mode for f in c.frames.values())]


def examine(evidence: Evidence, limits: list[Limit], origin: str) -> list[dict[str, Any]]:
    """Every check of the folder on the evidence; JSON-ready, each with the cause if its limit is not kept."""
    by_name = {limit.name: limit for limit in limits}
    rows = []
    for name, module in plugins(bench.rig.checks).items():
        for finding in module.build()(evidence):
            checked = judge_finding(finding, by_name, origin)
            bad = checked.verdict in (Verdict.FAIL, Verdict.ERROR, Verdict.MARGINAL)
            rows.append({**checked.to_dict(), "check": name, "of": finding.of, "cause": finding.cause if bad else ""})
    return rows


def known_limits() -> list[str]:
    """Names that the shipped limits file has."""
    return [limit.name for limit in load_limits("rig")]


def check_rig(plan: CheckPlan, store: Store, stop: Stop = lambda: False) -> dict[str, Any]:
    """Check a rig; everything it said, the checks and the verdict go into a run folder.

    Raises:
        UsageError: the plan or the limits are wrong; nothing was opened then.
        DeviceError: no rig there, the wrong firmware, or one that went away and did not come back.
    """
    limits = load_limits(plan.limits, known_limits())
    load_sonar(plan.sonar)
    run = store.create("rig_check", f"rig check {plan.url}", plan=plan.__dict__)
    try:
        rig = open_rig(plan.url, record=run.folder / "echoes.mcap", temperature_c=plan.temperature_c,
                       metadata={"run": run.id, "procedure": "rig check"})
    except BenchError:
        store.discard(run)
        raise
    try:
        with open_journal(run.folder / FILE_NAME, run=run.id, plan=plan.__dict__, versions=versions()) as journal:
            evidence = gather(rig, plan, stop)
            rows = examine(evidence, limits, rig.origin)
            for row in rows:
                journal.append("check", **row)
            summary = _summary(plan, rig, evidence, rows, stop(), run.folder)
            journal.append("end", verdict=summary["verdict"])
    except BaseException as error:
        rig.close()
        store.finish(run, "crashed", Verdict.ERROR.value, {"error": str(error)})
        raise
    rig.close()
    store.finish(run, "interrupted" if stop() else "finished", summary["verdict"],
                 {key: summary[key] for key in ("causes", "metrics")})
    return summary


def _summary(plan: CheckPlan, rig: Rig, evidence: Evidence, rows: list[dict[str, Any]], interrupted: bool,
             folder: Path) -> dict[str, Any]:
    verdict = worst(Verdict(row["verdict"]) for row in rows)
    if interrupted and verdict in (Verdict.PASS, Verdict.MARGINAL):
        verdict = Verdict.INCONCLUSIVE
    drift = evidence.drift
    return {
        "verdict": verdict.value,
        "checks": rows,
        "causes": list(dict.fromkeys(row["cause"] for row in rows if row["cause"])),
        "outcomes": [],
        "metrics": {
            "cycles": len(evidence.loud) + len(evidence.quiet),
            "incomplete_cycles": evidence.incomplete,
            "missing_cycles": evidence.missing,
            "noise_floor_counts": {role: evidence.noise_rms_counts(role) for role in evidence.roles},
            "clock_drift_ppm": None if drift is None else drift.ppm,
            "clock_drift_interval_ppm": None if drift is None else [drift.low_ppm, drift.high_ppm],
            "temperature_c": rig.temperature_c,
            "sound_speed_m_s": rig.sound_speed_m_s,
            "counters": rig.counters.__dict__,
        },
        "provenance": {
            "origin": rig.origin,
            "url": plan.url,
            "firmware": evidence.hello.firmware,
            "sensors": [{"role": s.role, "serial": s.serial, "fop_hz": s.fop_hz, "bandwidth_hz": s.bandwidth_hz}
                        for s in evidence.hello.sensors],
            "git": git_state(),
            "limits": plan.limits,
        },
        "interrupted": interrupted,
        "run": str(folder),
    }
