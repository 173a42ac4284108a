"""The verdict of one flight in words: what stands at the top of the recording."""

import math

from bench.drawing import OUTCOME_WORDS
from bench.flight_summary import trial_verdict
from sitl.trial_types import TrialResult


def flight_markdown(result: TrialResult) -> str:
    """Markdown: outcome, cause, and the figures of one flight."""
    verdict = trial_verdict(result.to_dict()).value
    words = OUTCOME_WORDS.get(result.outcome, result.outcome)
    part = f" ({result.part})" if result.part else ""
    autopilot = " ".join(result.autopilot.get(key, "") for key in ("kind", "version")).strip() or "unknown"
    lines = [
        f"**{result.scene}**, seed {result.seed}",
        f"smallest clearance **{metres(result.min_clearance_m)}**, course {seconds(result.duration_s)}, "
        + ("landed" if result.landed else "not landed"),
        f"stack {result.stack}, denoiser {result.denoiser}, shield {result.shield}",
        f"simulated, autopilot {autopilot}",
    ]
    return "\n\n".join([f"## {verdict}: {words}{part}", result.cause, *lines]) + "\n"


def metres(value: float | None) -> str:
    """"0.31 m", or "not measured"."""
    return "not measured" if value is None or not math.isfinite(value) else f"{value:.2f} m"


def seconds(value: float | None) -> str:
    """"12.4 s", or "not measured"."""
    return "not measured" if value is None or not math.isfinite(value) else f"{value:.1f} s"


def viewer_text(text: str) -> str:
    """The text with "?" for what the Rerun viewer's only font may lack: it dies (0.41, headless) of a missing glyph."""
    return "".join(c if c == "\n" or " " <= c <= "~" or ("\xa1" <= c <= "\xff" and c != "\xad") else "?" for c in text)
