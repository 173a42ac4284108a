"""A sweep or a comparison of shields as text: verdict first, then why, then where to look."""

from pathlib import Path
from typing import Any


def summary_text(summary: dict[str, Any]) -> str:
    """For people."""
    metrics = summary["metrics"]
    lines = [f"{summary['verdict']}  noise sweep, {summary['origin']}: {metrics['steps']} of "
             f"{metrics['steps_planned']} steps, sensor {summary['sensor']}"
             + ("" if summary["state"] == "finished" else f" ({summary['state']})")]
    if summary["insertion_loss_db"]:
        lines.append(f"  insertion loss at {summary['target_kgf']:g} kgf of one motor, 95 % interval")
        lines += [f"    {name:<14} {loss_text(loss)}" for name, loss in summary["insertion_loss_db"].items()]
    lines += [f"  {c['sentence']}" for c in summary["comparisons"]]
    if summary["optimum_height"]:
        lines.append(f"  height: {summary['optimum_height']['sentence']}")
    lines += _hover_lines(summary)
    lines += range_lines(summary["prediction"])
    lines += flight_lines(summary.get("flights"))
    lines += [f"  {c['verdict']:<12} {c['name']}: {c['why']}" for c in summary["checks"] if c["verdict"] != "PASS"]
    if summary.get("noise_models"):
        run = Path(summary["run"])
        first = next((n for n in summary["noise_models"] if n != summary["reference"]), None)
        if first:
            lines.append(f"  fly    saranga-bench fly poles --shield {run}:{first}")
    if summary["state"] in ("interrupted", "failed", "cut off"):
        lines.append(f"  go on  saranga-bench sweep --resume {Path(summary['run']).name.rsplit('-', 1)[-1]}"
                     " with the same --rig and --stand")
    lines.append(f"  run    {summary['run']}")
    return "\n".join(lines)


def loss_text(loss: dict[str, Any]) -> str:
    """"12.2 dB (11.4 to 13.0)"."""
    if loss["value"] is None:
        return f"no value: {loss['why']}"
    where = "" if loss["where"].startswith("at the thrust") else f", {loss['where']}"
    if loss["interval"] is None:
        return f"{loss['value']:.2f} dB (one block: no interval){where}"
    low, high = loss["interval"]
    return f"{loss['value']:.2f} dB ({low:.2f} to {high:.2f}, {loss['blocks']} blocks){where}"


def _hover_lines(summary: dict[str, Any]) -> list[str]:
    lines = []
    for reading, level in summary["hover"].items():
        known = {n: v["value"] for n, v in level["noise_rms"].items() if v["value"] is not None}
        text = ", ".join(f"{n} {v:.4f}" for n, v in known.items()) or next(
            (v["why"] for v in level["noise_rms"].values()), "nothing measured")
        lines.append(f"  hover, read as {reading.replace('_', ' ')} ({level['thrust_kgf']:g} kgf): {text}")
    return lines


def range_lines(prediction: dict[str, Any]) -> list[str]:
    """Predicted detection ranges."""
    lines = []
    for threshold in prediction["thresholds"]:
        lines.append(f"  predicted detection range, {threshold['name']} ({threshold['psnr_db']:+.1f} dB)")
        for name, ranges in prediction["ranges_m"].items():
            cells = []
            for target, r in ranges[threshold["name"]].items():
                span = f" ({r['interval'][0]:.2f} to {r['interval'][1]:.2f})" if r["interval"] and len(
                    set(r["interval"])) > 1 else ""
                cells.append(f"{target} {r['value']:.2f} m{span}")
            lines.append(f"    {name:<14} {', '.join(cells)}")
    return lines


def flight_lines(flights: dict[str, Any] | None) -> list[str]:
    """Success rates behind each shield."""
    if not flights:
        return []
    lines = [f"  flown on scene {flights['scene']}, embedded autopilot, {flights['origin']}"]
    for name, f in flights["by_shield"].items():
        if f.get("error"):
            lines.append(f"    {name:<14} not flown: {f['error']}")
            continue
        low, high = f["interval"]
        lines.append(f"    {name:<14} {f['successes']} of {f['trials']} clean ({low:.0%} to {high:.0%})")
    return lines
