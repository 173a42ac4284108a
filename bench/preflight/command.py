"""`saranga-bench preflight`: gather once, judge everything, keep and sign the result."""

import contextlib
import dataclasses
import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.emulated import Started, is_emulated
from bench.journal import FILE_NAME, open_journal
from bench.preflight import judge, rig_side
from bench.preflight.collect import ARMED, Conversation, Deadlines, Say, Stop
from bench.preflight.collect import gather as gather_vehicle
from bench.preflight.emulated import order_vehicle
from bench.preflight.evidence import Evidence
from bench.preflight.fix import Ask, ask_on_terminal, fix_parameters
from bench.preflight.guard import GuardedLink
from bench.preflight.mavsdk_bridge import ask_mavsdk
from bench.preflight.page import write_page
from bench.preflight.parameter_difference import PARAMETER_SETS, wanted_parameters
from bench.preflight.sign import load_key, signed
from bench.preflight.stack_timing import time_stack
from bench.provenance import git_state, sha256_of, versions
from bench.rig.check import known_limits as known_rig_limits
from bench.rig.rehearsal import order_rig
from bench.store import Run, Store, write_json
from bench.verdict import Limit, Verdict, load_limits, worst
from saranga.echo import load_sonar
from saranga.errors import BenchError, DeviceError, UsageError
from saranga.fixtures import fixture_path
from saranga.transport import open_transport

RESULT_FILE, PAGE_FILE, VEHICLE_FILE = "preflight.json", "preflight.html", "vehicle.json"
MAVSDK_S = 14.0
LOG_S = 70.0
SPEED_M_S = 0.5
REHEARSAL_TRIES = 4


@dataclass(frozen=True)
class Plan:
    """What to do. `skip` names checks that the operator bypasses; `deadlines` and the seconds are for tests."""

    vehicle: str | None = None
    rig: str | None = None
    limits: str = "preflight"
    rig_limits: str = "rig"
    parameters: tuple[str, ...] = PARAMETER_SETS
    sonar: str = "pair"
    reflector: rig_side.Reflector = field(default_factory=rig_side.Reflector)
    temperature_c: float | None = None
    denoiser: str = "saranga"
    stack: str = "saranga"
    system: int = 1
    skip: tuple[str, ...] = ()
    fix_parameters: bool = False
    mavsdk: bool = True
    download_log: bool = False
    sign_key: Path | None = None
    deadlines: Deadlines = field(default_factory=Deadlines)
    rig_seconds: float = rig_side.SECONDS
    stack_steps: int = 120


def preflight(plan: Plan, store: Store, say: Say = lambda text: None, stop: Stop = lambda: False,
              ask: Ask = ask_on_terminal) -> dict[str, Any]:
    """Gather, judge, write the run folder.

    Returns:
        The result, as in `preflight.json`: verdict, go, reason, checks, metrics, provenance, run, errors.

    Raises:
        UsageError: a bad name, limit, key or URL; nothing was opened then.
    """
    limits, rig_limits, key = _checked(plan)
    title = f"preflight {plan.vehicle or '-'} {plan.rig or '-'}"
    run = store.create("preflight", title, plan=_plain(plan))
    try:
        with contextlib.ExitStack() as started, \
                open_journal(run.folder / FILE_NAME, run=run.id, plan=_plain(plan), versions=versions()) as journal:
            rehearsal = is_emulated(plan.vehicle) or is_emulated(plan.rig)
            plan = _start_emulated(plan, started, say, stop)
            began = time.monotonic()
            evidence, phases, fixed = _gather(plan, run, say, stop, ask, started, REHEARSAL_TRIES if rehearsal else 1)
            result = judge_evidence(plan, evidence, limits, rig_limits, stop())
            result["metrics"] |= {"phases_s": phases, "total_s": round(time.monotonic() - began, 2), **fixed}
            for row in result["checks"]:
                journal.append("check", **row)
            journal.append("end", verdict=result["verdict"])
        result["run"] = str(run.folder)
        if key is not None:
            result = signed(result, key)
        if evidence.vehicle is not None:
            write_json(run.folder / VEHICLE_FILE, _finite(dataclasses.asdict(evidence.vehicle)))
        write_json(run.folder / RESULT_FILE, result)
        write_page(result, run.folder / PAGE_FILE)
    except UsageError:
        store.discard(run)
        raise
    except BaseException as error:
        store.finish(run, "crashed", Verdict.ERROR.value, {"error": str(error)})
        raise
    store.finish(run, "interrupted" if stop() else "finished", result["verdict"],
                 {"go": result["go"], "reason": result["reason"], "metrics": result["metrics"]})
    return result


def _checked(plan: Plan) -> tuple[list[Limit], list[Limit], bytes | None]:
    """Everything that can be wrong with the plan, before anything is opened."""
    if plan.vehicle is None and plan.rig is None:
        raise UsageError("nothing to check: give --vehicle URL, --rig URL or both; emulated: rehearses")
    if not 1 <= plan.system <= 255:
        raise UsageError(f"--system {plan.system}: must be 1..255")
    limits = load_limits(plan.limits, judge.known_limits())
    rig_limits = load_limits(plan.rig_limits, known_rig_limits())
    judge.examine(Evidence(), limits, rig_limits, plan.skip)
    wanted_parameters(plan.parameters)
    load_sonar(plan.sonar)
    if is_emulated(plan.vehicle):
        order_vehicle(plan.vehicle or "")
    if is_emulated(plan.rig):
        order_rig(plan.rig or "")
    return limits, rig_limits, load_key(plan.sign_key) if plan.sign_key is not None else None


def _start_emulated(plan: Plan, started: contextlib.ExitStack, say: Say, stop: Stop) -> Plan:
    """Both at once, then wait for both; what cannot start is a link that failed, found when it is opened."""
    orders: dict[str, Started] = {}
    if is_emulated(plan.vehicle):
        orders["vehicle"] = started.enter_context(
            contextlib.closing(Started(order_vehicle(plan.vehicle or ""))))
    if is_emulated(plan.rig):
        orders["rig"] = started.enter_context(
            contextlib.closing(Started(order_rig(plan.rig or ""))))
    if orders:
        say(f"starting an emulated {' and '.join(orders)}")
    urls = {part: process.url(stop) for part, process in orders.items()}
    return dataclasses.replace(plan, vehicle=urls.get("vehicle") or plan.vehicle, rig=urls.get("rig") or plan.rig)


def _gather(plan: Plan, run: Run, say: Say, stop: Stop, ask: Ask,
            started: contextlib.ExitStack, tries: int) -> tuple[Evidence, dict[str, float], dict[str, Any]]:
    """The evidence, how long each part took, and what was done to parameters. A part that fails is said, not raised."""
    evidence, phases, fixed = Evidence(wanted=wanted_parameters(plan.parameters)), {}, {}

    def part(name: str, action: Callable[[], None]) -> None:
        began = time.monotonic()
        try:
            if stop():
                evidence.absent[name] = "interrupted by the operator"
            else:
                action()
        except UsageError:
            raise
        except BenchError as error:
            evidence.absent[name] = str(error)
        phases[name] = round(time.monotonic() - began, 2)

    part("vehicle", lambda: fixed.update(_vehicle(plan, evidence, run.folder, say, stop, ask)))
    if evidence.vehicle is not None and evidence.vehicle.stopped == ARMED:
        evidence.absent |= dict.fromkeys(("rig", "stack"), "not begun: the vehicle is armed")
        evidence.now_s = time.monotonic()
        return evidence, phases, fixed
    part("rig", lambda: _rig(plan, evidence, run.folder, say, stop))
    say(f"stack: timing {plan.stack} with {plan.denoiser}")
    started.close()  # emulated devices would compute beside the stack, as they never do in flight
    part("stack", lambda: _stack(plan, evidence, run.folder, tries))
    evidence.now_s = time.monotonic()
    return evidence, phases, fixed


def _vehicle(plan: Plan, evidence: Evidence, folder: Path, say: Say, stop: Stop, ask: Ask) -> dict[str, Any]:
    if plan.vehicle is None:
        evidence.absent["vehicle"] = "no --vehicle was given"
        return {}
    link = GuardedLink(open_transport(plan.vehicle))
    with contextlib.closing(link):
        conversation = Conversation(link, plan.system, stop=stop)
        try:
            return _converse(plan, evidence, conversation, folder, say, ask)
        finally:
            with contextlib.suppress(DeviceError):
                conversation.put_rates_back()


def _converse(plan: Plan, evidence: Evidence, conversation: Conversation, folder: Path, say: Say,
              ask: Ask) -> dict[str, Any]:
    link, stop = conversation.link, conversation.stop
    needed = [name for p in evidence.wanted for name in {p.name, p.name_v45}]
    vehicle = gather_vehicle(conversation, needed, say, plan.deadlines)
    evidence.vehicle = vehicle
    fixed: dict[str, Any] = {}
    if plan.fix_parameters and not vehicle.stopped:
        fixed["parameters_fixed"] = dataclasses.asdict(fix_parameters(conversation, link, evidence.wanted, ask))
    if not plan.mavsdk:
        evidence.absent["mavsdk"] = "switched off by --no-mavsdk"
    elif not vehicle.stopped:
        say("vehicle: the same through MAVSDK")
        log = folder / "vehicle.bin" if plan.download_log else None
        evidence.mavsdk = ask_mavsdk(link, LOG_S if plan.download_log else MAVSDK_S, log, stop)
    fixed["dropped_by_guard"] = sorted(set(link.dropped))
    return fixed


def _rig(plan: Plan, evidence: Evidence, folder: Path, say: Say, stop: Stop) -> None:
    if plan.rig is None:
        evidence.absent["rig"] = "no --rig was given"
        return
    say(f"rig: link and self test, then {plan.rig_seconds:g} s of echoes and noise")
    evidence.rig = rig_side.gather(plan.rig, plan.sonar, plan.reflector, plan.temperature_c, folder / "echoes.mcap",
                                   stop, plan.rig_seconds)


def _stack(plan: Plan, evidence: Evidence, folder: Path, tries: int) -> None:
    evidence.stack = time_stack(plan.denoiser, plan.stack, plan.sonar, SPEED_M_S, folder, plan.stack_steps, tries=tries)


def judge_evidence(plan: Plan, evidence: Evidence, limits: list[Limit], rig_limits: list[Limit],
                   interrupted: bool = False) -> dict[str, Any]:
    """The result from the evidence alone: nothing is asked or measured here."""
    rows = judge.examine(evidence, limits, rig_limits, plan.skip)
    verdict = worst(Verdict(row["verdict"]) for row in rows)
    asked = {"vehicle": plan.vehicle, "rig": plan.rig}
    failed = [f"{part}: {evidence.absent[part]}" for part, url in asked.items()
              if url is not None and part in evidence.absent]
    reason = judge.go_text(verdict, rows, {row["origin"] for row in rows})
    armed = evidence.vehicle is not None and evidence.vehicle.stopped == ARMED
    if failed and not interrupted and not armed:
        verdict, reason = Verdict.ERROR, f"NO-GO: {len(failed)} of {sum(map(bool, asked.values()))} links failed: " \
            + "; ".join(failed)
    elif interrupted:
        verdict = Verdict.INCONCLUSIVE if verdict.accepted else verdict
        reason = "NO-GO: interrupted by the operator"
    if armed or interrupted:
        failed = []
    vehicle, rig = evidence.vehicle, evidence.rig
    return {
        "verdict": verdict.value,
        "go": verdict.accepted,
        "reason": reason,
        "checks": rows,
        "bypassed": sorted({row["name"] for row in rows if row["bypassed"]}),
        "errors": ["; ".join(failed)] if failed else [],
        "outcomes": [],
        "metrics": {"checks": len(rows), "parameters_read": len(vehicle.parameters) if vehicle else 0,
                    "mavsdk": evidence.mavsdk},
        "provenance": {
            "vehicle": None if vehicle is None else {
                "url": vehicle.url, "system": vehicle.system, "origin": vehicle.origin, "embedded": vehicle.embedded,
                "version": vehicle.version, "firmware_hash": vehicle.firmware_hash},
            "rig": None if rig is None else {"url": rig.url, "origin": rig.origin, "firmware":
                                             rig.evidence.hello.firmware},
            "denoiser": plan.denoiser, "stack": plan.stack,
            "limits": {name: sha256_of(fixture_path("limits", name)) for name in (plan.limits, plan.rig_limits)},
            "parameters": {name: sha256_of(fixture_path("parameters", name)) for name in plan.parameters},
            "weights_sha256": evidence.stack.weights_found if evidence.stack else {},
            "utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "git": git_state(),
            "versions": versions(),
        },
        "run": None,
    }


def _finite(value: Any) -> Any:
    """With None for what is no number: JSON has no word for it, and vehicles do say NaN."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    return [_finite(item) for item in value] if isinstance(value, list | tuple) else value


def _plain(plan: Plan) -> dict[str, Any]:
    return json.loads(json.dumps(dataclasses.asdict(plan), default=str))
