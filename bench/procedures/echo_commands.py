"""The commands `beam`, `reference-echo`, `accuracy` and `energy`: from options to a run, a result and an exit code."""

import contextlib
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench.interrupt import Interrupts, interruptible
from bench.journal import FILE_NAME, Journal, open_journal, read_journal
from bench.procedures.plan import BeamPlan, EchoPlan, load_plan, plan_from_tables
from bench.procedures.runner import Interrupted
from bench.procedures.schedule import plan_hash
from bench.procedures.terminal import duration_text, terminal_hands
from bench.provenance import git_state, versions
from bench.store import Run, Store, read_run, runs_root, write_json
from saranga.errors import BenchError, UsageError


def beam_command(name: str, rig: str | None, resume: str | None, dry_run: bool, as_json: bool, out: Path | None) -> int:
    """Returns the exit code."""
    from bench.emulated import is_emulated
    from bench.procedures.beam import BeamPoint, beam_result, measure_beam, places
    from bench.procedures.echo_bench import echo_bench

    store = Store(runs_root(out))
    folder = store.resolve(resume) if resume is not None else None
    plan = _plan_of(folder) if folder is not None else load_plan(name)
    if not isinstance(plan, BeamPlan):
        raise UsageError(f"plan {name!r} is of procedure {plan.procedure!r}, not beam")
    order = places(plan)
    hands_s = 0.0 if is_emulated(rig) else plan.mount_s
    total_s = len(order) * (hands_s + plan.rig.frames / plan.rig.rate_hz)
    _say(f"{plan.name}: {len(order)} places, about {duration_text(total_s)}, nothing spins, plan hash "
         f"{plan_hash(plan)}")
    if dry_run:
        lines = [f"{p.distance_m:g} m, {p.azimuth_deg:+g} degrees" for _, p in order]
        _print({"dry_run": True, "verdict": None, "plan_hash": plan_hash(plan), "places": lines},
               "\n".join(lines), as_json)
        return 0
    if rig is None:
        raise UsageError("no rig: give --rig URL, or --rig emulated: for a rehearsal")
    known: list[BeamPoint] = []

    def work(run: Run, journal: Journal, interrupts: Interrupts) -> dict[str, Any]:
        records = read_journal(run.folder / FILE_NAME).of("place")
        known.extend(BeamPoint(**r["point"]) for r in records)
        done = frozenset((p.repeat, p.distance_m, p.azimuth_deg) for p in known)
        what = f"{1e3 * plan.pole_diameter_m:g} mm pole"
        with interruptible_bench(lambda: echo_bench(rig, plan.rig, what, terminal_hands, _recording(run.folder),
                                                    interrupts.asked)) as bench:
            journal.append("devices", origin=bench.origin, rig={"url": bench.name})

            def keep(point: BeamPoint) -> None:
                journal.append("place", point=point.to_dict(), origin=bench.origin)
                known.append(point)
                _say(f"{len(known):3d}/{len(order)} {point.distance_m:g} m {point.azimuth_deg:+g} degrees: "
                     f"{point.level_db:.1f} dB, {point.over_noise_db:.0f} over the noise")
                if interrupts.asked():
                    raise Interrupted

            measure_beam(plan, bench, keep, done)
            return beam_result(known, plan, bench.origin)

    summary, code = _run("beam", plan, store, folder, {"rig_url": rig}, work)
    if summary.get("points"):
        from bench.procedures.beam_page import write_beam_page

        summary["page"] = str(write_beam_page(Path(summary["run"]), summary))
    widths = {d: w for d, w in summary.get("width_6db_deg", {}).items() if w is not None}
    text = (f"{summary['verdict']}  beam pattern, {summary.get('origin', 'unknown')}: {len(summary.get('points', []))} "
            f"of {len(order)} places\n" + "\n".join(f"  {d} m: {w:.0f} degrees wide at -6 dB (two way)" for d, w in
                                                widths.items()) + f"\n  run    {summary['run']}")
    _print(summary, text, as_json)
    return code


def echo_command(name: str, rig: str | None, as_json: bool, out: Path | None) -> int:
    """Returns the exit code."""
    from bench.procedures.echo_bench import echo_bench
    from bench.procedures.reference_echo import capture_echo

    plan = load_plan(name)
    if not isinstance(plan, EchoPlan):
        raise UsageError(f"plan {name!r} is of procedure {plan.procedure!r}, not echo")
    if rig is None:
        raise UsageError("no rig: give --rig URL, or --rig emulated: for a rehearsal")

    def work(run: Run, journal: Journal, interrupts: Interrupts) -> dict[str, Any]:
        recording = _recording(run.folder)
        with interruptible_bench(lambda: echo_bench(rig, plan.rig, plan.object, terminal_hands, recording,
                                                    interrupts.asked)) as bench:
            journal.append("devices", origin=bench.origin, rig={"url": bench.name})
            found = capture_echo(plan, bench, recording)
        journal.append("echo", **found)
        return found

    summary, code = _run("echo", plan, Store(runs_root(out)), None, {"rig_url": rig}, work)
    text = f"{summary['verdict']}  reference echo of {plan.object}"
    if "use" in summary:
        text += (f", {summary['origin']}: {summary['frames']} records, echo at {summary['range_m']:.3f} m, "
                 f"{summary['over_median']:.0f} times the median\n  use    {summary['use']}")
    _print(summary, text + f"\n  run    {summary['run']}", as_json)
    return code


def accuracy_command(file: Path, true_m: float, sensor: str, message: str, sensor_id: int | None, column: str | None,
                     scale: float, as_json: bool) -> int:
    """Returns the exit code."""
    from bench.procedures.accuracy import accuracy_result, read_csv, read_mavlink, read_rig

    if message not in ("DISTANCE_SENSOR", "OBSTACLE_DISTANCE"):
        raise UsageError(f"--message {message!r}: DISTANCE_SENSOR or OBSTACLE_DISTANCE")
    if not scale > 0.0:
        raise UsageError(f"--scale {scale}: must be positive")
    if file.suffix == ".mcap":
        readings = read_rig(file, sensor)
    elif file.suffix in (".tlog", ".bin", ".log"):
        readings = read_mavlink(file, message, sensor_id)
    else:
        readings = read_csv(file, column, scale)
    found = accuracy_result(readings, true_m)
    low, high = found["interval"]
    spread = "" if found["bias_m"] is None else f", bias {1e3 * found['bias_m']:+.0f} mm"
    text = (f"accuracy {found['accuracy']:.3f} ({low:.3f} to {high:.3f}), {found['origin']}: {found['readings']} "
            f"readings, {found['undefined']} undefined{spread}; the paper's sonar: {found['paper_sonar']:g}")
    _print({"verdict": None, "outcomes": [], "checks": [], "metrics": found, "provenance": {"source": readings.source},
            "run": None}, text, as_json)
    return 0


def energy_command(power: str, denoiser: str, calls: int, idle_s: float, as_json: bool) -> int:
    """Returns the exit code."""
    import numpy as np

    from bench.power import energy_per_call, load_power_source
    from saranga.denoise import load_denoiser
    from saranga.echo import HISTORY_ROWS, EchoFrame, EchoImage

    source = load_power_source(power)
    model = load_denoiser(denoiser)
    image = EchoImage()
    rng = np.random.default_rng(1)
    for trigger in range(HISTORY_ROWS):
        iq = np.rint(1_000.0 * rng.standard_normal((256, 2))).astype(np.int16)
        image.push(EchoFrame("left", 0, trigger, trigger, 25_600 * trigger, 53_000.0, 6, 0, iq), 343.0)
    about = source.open()
    try:
        for _ in range(10):
            model(image)
        found = energy_per_call(lambda: model(image), source, calls, idle_s)
    finally:
        source.close()
    text = (f"{denoiser}: {1e3 * found.net_j:.2f} mJ an inference over idle, {1e3 * found.gross_j:.2f} mJ in all, "
            f"{1e3 * found.seconds / found.calls:.2f} ms ({found.origin}, {about}); the paper: 10.6 mJ in 14.57 ms on "
            "an Edge TPU")
    _print({"verdict": None, "outcomes": [], "checks": [], "metrics": asdict(found),
            "provenance": {"power": about, "denoiser": denoiser, **versions()}, "run": None}, text, as_json)
    return 0


@contextlib.contextmanager
def interruptible_bench(make: Callable[[], Any]) -> Any:
    """The bench, closed at the end whatever happens."""
    bench = make()
    try:
        yield bench
    finally:
        bench.close()


def _run(kind: str, plan: BeamPlan | EchoPlan, store: Store, folder: Path | None, inputs: dict[str, Any],
         work: Callable[[Run, Journal, Interrupts], dict[str, Any]]) -> tuple[dict[str, Any], int]:
    """One run of a procedure without a motor: journal, ending, summary. PASS: it came to its end."""
    if folder is not None:
        run = read_run(folder)
        if run is None:
            raise UsageError(f"{folder}: has no readable run.json: it cannot be resumed")
    else:
        run = store.create(kind, plan.name, argv=sys.argv[1:], **inputs)
    header = {"run_kind": kind, "run": str(run.folder), "plan": plan.model_dump(mode="json"),
              "plan_hash": plan_hash(plan), "versions": versions(), "git": git_state(), **inputs}
    state, code, summary = "finished", 0, {}
    errors: list[str] = []
    with interruptible() as interrupts, open_journal(run.folder / FILE_NAME, **header) as journal:
        try:
            summary = work(run, journal, interrupts)
        except Interrupted:
            state, code = "interrupted", 130
            journal.append("interrupted", signal=interrupts.signal_name)
        except BenchError as error:
            state, code = "failed", error.exit_code
            errors.append(str(error))
            journal.append("error", type=type(error).__name__, error=str(error), exit_code=error.exit_code)
        journal.append("end", state=state)
    verdict = {"finished": "PASS", "interrupted": "INCONCLUSIVE", "failed": "ERROR"}[state]
    summary |= {"verdict": verdict, "state": state, "errors": errors, "outcomes": [], "checks": [], "metrics": {},
                "provenance": {"plan_hash": plan_hash(plan), "git": git_state()}, "run": str(run.folder)}
    write_json(run.folder / "summary.json", summary)
    store.finish(run, state, verdict, {})
    return summary, code


def _plan_of(folder: Path) -> Any:
    return plan_from_tables(read_journal(folder / FILE_NAME).header["plan"], f"{folder}: plan in the journal")


def _recording(folder: Path) -> Path:
    path, number = folder / "echoes.mcap", 1
    while path.exists():
        number += 1
        path = folder / f"echoes-{number}.mcap"
    return path


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _print(summary: dict[str, Any], text: str, as_json: bool) -> None:
    from bench.sweep_cli import print_result

    print_result(summary, text, as_json)
