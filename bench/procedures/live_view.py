"""A sweep as it runs, in the Rerun viewer on the loopback: thrust and throttle, noise of every sensor, and the points.

What is shown is only a picture of what goes into the journal: a viewer that dies ends nothing.
"""

import contextlib
from typing import Any, Protocol

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from bench.procedures.bench import Heard
from bench.procedures.noise_metric import iq_of
from bench.procedures.plan import NoisePlan
from bench.procedures.schedule import Step
from bench.procedures.sweep_figures import COLOURS, REFERENCE_COLOUR
from bench.view import Viewer
from saranga.echo import FULL_SCALE

TIMELINE = "bench_time"
LEAST_RMS = 1e-5


class Watched(Protocol):
    """The watcher underneath."""

    def begin(self, step: Step, left_s: float) -> None: ...
    def heard(self, step: Step, heard: Heard, now_s: float) -> None: ...
    def finish(self, step: Step, record: dict[str, Any]) -> None: ...


class LiveView:
    """Passes everything on to `inner`, and draws it. `recording` is told by `connect`, for tests too."""

    def __init__(self, plan: NoisePlan, inner: Watched, viewer: Viewer | None = None,
                 recording: rr.RecordingStream | None = None) -> None:
        self._plan = plan
        self._inner = inner
        self._viewer = viewer
        self._start_s: float | None = None
        self._points: dict[str, list[tuple[float, float]]] = {}
        others = iter(COLOURS * 4)
        self._colours = {c.name: REFERENCE_COLOUR if c.reference else next(others) for c in plan.conditions}
        if recording is None:
            self._viewer = viewer or Viewer([])
            recording = rr.RecordingStream("saranga_bench_sweep")
            recording.connect_grpc(f"rerun+http://127.0.0.1:{self._viewer.port}/proxy")
        self._rec = recording
        self._rec.send_blueprint(_blueprint())
        self._rec.log("plan", rr.TextDocument(f"**{plan.name}**, {plan.blocks} blocks", media_type="text/markdown"),
                      static=True)

    def begin(self, step: Step, left_s: float) -> None:
        self._inner.begin(step, left_s)
        text = (f"## block {step.block + 1}: {step.condition}, {step.phase}\n\nlevel {step.level:g}, "
                f"{left_s / 60:.1f} min left")
        with contextlib.suppress(Exception):
            self._rec.log("now", rr.TextDocument(text, media_type="text/markdown"))

    def heard(self, step: Step, heard: Heard, now_s: float) -> None:
        self._inner.heard(step, heard, now_s)
        with contextlib.suppress(Exception):
            self._draw(heard, now_s)

    def finish(self, step: Step, record: dict[str, Any]) -> None:
        self._inner.finish(step, record)
        with contextlib.suppress(Exception):
            self._draw_point(step, record)

    def close_view(self) -> None:
        """Say goodbye; the viewer's window is closed with the sweep."""
        with contextlib.suppress(Exception):
            self._rec.flush()
        if self._viewer is not None:
            self._viewer.close()

    def _draw(self, heard: Heard, now_s: float) -> None:
        self._start_s = now_s if self._start_s is None else self._start_s
        self._rec.set_time(TIMELINE, duration=now_s - self._start_s)
        for r in heard.readings[-1:]:
            for name in ("thrust_n", "throttle", "rpm", "voltage_v", "current_a"):
                value = getattr(r, name)
                if np.isfinite(value):
                    self._rec.log(f"stand/{name}", rr.Scalars(value))
        for cycle in heard.cycles[-1:]:
            for role, frame in cycle.frames.items():
                iq = iq_of(frame, self._plan.rig.skip_samples)
                rms = float(np.sqrt(np.mean(np.abs(iq) ** 2))) / FULL_SCALE
                self._rec.log(f"noise/{role}", rr.Scalars(20.0 * np.log10(max(rms, LEAST_RMS))))
                self._rec.log(f"record/{role}", rr.BarChart(np.abs(iq) / FULL_SCALE))

    def _draw_point(self, step: Step, record: dict[str, Any]) -> None:
        noise = record["noise"].get(self._plan.rig.sensor)
        if step.level == 0.0 or noise is None or record["thrust_n"] is None:
            return
        mine = self._points.setdefault(step.condition, [])
        # Drawn in a plane: thrust to the right, level in dB (over 10) upwards.
        mine.append((record["thrust_n"], -2.0 * np.log10(max(noise["rms"], LEAST_RMS))))
        colour = self._colours[step.condition]
        self._rec.log(f"points/{step.condition}", rr.Points2D(
            mine, radii=0.03, colors=[int(colour[k:k + 2], 16) for k in (1, 3, 5)]))


def _blueprint() -> rrb.Blueprint:
    plots = [rrb.TimeSeriesView(origin="/noise", name="Noise, dB re 20 000"),
             rrb.TimeSeriesView(origin="/stand/thrust_n", name="Thrust, N"),
             rrb.TimeSeriesView(origin="/stand/throttle", name="Throttle")]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(rrb.TextDocumentView(origin="/now", name="Now"),
                         rrb.Spatial2DView(origin="/points", name="Points: thrust in N to the right, level up"),
                         row_shares=[1, 4]),
            rrb.Vertical(*plots, rrb.BarChartView(origin="/record/left", name="Newest record, left")),
            column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed"), collapse_panels=True)
