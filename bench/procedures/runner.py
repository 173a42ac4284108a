"""Runs a noise plan on a bench: mount, set, settle, listen, write down; one journal record a finished step.

What was heard is on disk before it is looked at (echoes.mcap by the bench, stand.csv here). However it ends - done,
interrupted, tripped, broken - the throttle is taken away first and the journal then says how.
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol

from bench.journal import Journal
from bench.procedures.bench import Bench, Heard
from bench.procedures.noise_metric import CoherenceMeter, NoiseMeter, rehearse_metric
from bench.procedures.plan import NoisePlan
from bench.procedures.schedule import Step, step_duration_s
from bench.procedures.settling import Settling
from bench.procedures.stand_file import StandFile
from bench.procedures.thrust_seeker import ThrustSeeker
from bench.thrust_stand.protocol import StandReading
from saranga.errors import DeviceError

POLL_S = 0.02
IDLE_THRUST_N = 0.05
STOPPED_RPM = 300.0
STANDSTILL_S = 30.0
ARRIVE_S = 10.0
ARRIVED = 0.005
LEAST_FINITE_SHARE = 0.8
SIGN_THROTTLE = 0.15
"""From this throttle on a propeller pulls; a stand that reads clearly negative there is wired or calibrated wrongly."""
SIGN_THRUST_N = -0.05
QUANTITIES = ("thrust_n", "torque_n_m", "rpm", "voltage_v", "current_a", "esc_temperature_c", "motor_temperature_c",
              "vibration_m_s2", "throttle")


class Watcher(Protocol):
    """Told what happens, for progress and the live view."""

    def begin(self, step: Step, left_s: float) -> None: ...
    def heard(self, step: Step, heard: Heard, now_s: float) -> None: ...
    def finish(self, step: Step, record: dict[str, Any]) -> None: ...


class Interrupted(Exception):
    """The operator wants to stop."""


@dataclass
class Runner:
    """One run, or the rest of one. `asked_to_stop` is looked at in every poll."""

    plan: NoisePlan
    steps: Sequence[Step]
    bench: Bench
    journal: Journal
    stand: StandFile
    origin: str
    watcher: Watcher
    asked_to_stop: Callable[[], bool]
    roles: Sequence[str]
    _mounting: int | None = None
    _throttle: float = 0.0
    _seeker: ThrustSeeker | None = None

    def run(self) -> None:
        """Every step that is left; returns with the motor asked to idle.

        Raises:
            Interrupted: the operator asked. DeviceError: tripped, or a device failed. Finished steps are journalled.
        """
        left_s = sum(step_duration_s(self.plan, s) for s in self.steps)
        rehearse_metric(self.plan.rig.samples, self.plan.rig.skip_samples)
        self._warm_up()
        for step in self.steps:
            self.watcher.begin(step, left_s)
            if step.mounting != self._mounting:
                self._stand_still(step)
                self.bench.mount(self.plan.condition(step.condition))
                self._mounting = step.mounting
                self.bench.poll(0.0)  # what came while somebody worked on the bench belongs to no step
            record = self._measure(step)
            self._write_down(step, record)
            self.watcher.finish(step, record)
            left_s -= step_duration_s(self.plan, step)
        self.bench.set_throttle(0.0)

    def _write_down(self, step: Step, record: dict[str, Any]) -> None:
        """The record is on disk when this returns. A disk may take its time, and the motor is spinning: meanwhile the
        loop goes on looking at the stand and keeping the throttle alive. In simulated time nothing spins meanwhile."""
        if not self.bench.real_time:
            self.journal.append("step", **record)
            return
        with ThreadPoolExecutor(1, thread_name_prefix="journal") as writer:
            written = writer.submit(self.journal.append, "step", **record)
            while not written.done():
                self._poll(step)
        written.result()

    # ---- one step --------------------------------------------------------------------------------
    def _measure(self, step: Step) -> dict[str, Any]:
        began_s = self.bench.now_s()
        self._aim(step)
        settled = self._settle(step)
        settled_s = self.bench.now_s() - began_s
        meters = {role: NoiseMeter(self.plan.rig.skip_samples) for role in self.roles}
        coherence = CoherenceMeter(self.plan.rig.skip_samples)
        readings: list[StandReading] = []
        first, last, counted = -1, -1, 0
        start_s = self.bench.now_s()
        limit_s = 3.0 * self.plan.rig.frames / self.plan.rig.rate_hz + 3.0
        while counted < self.plan.rig.frames:
            heard = self._poll(step)
            readings += heard.readings
            for cycle in heard.cycles:
                if counted >= self.plan.rig.frames:
                    continue
                for role, frame in cycle.frames.items():
                    if role in meters:
                        meters[role].add(frame)
                if "left" in cycle.frames and "right" in cycle.frames:
                    coherence.add(cycle.frames["left"], cycle.frames["right"])
                first, last = (cycle.trigger if first < 0 else first), cycle.trigger
                counted += self.plan.rig.sensor in cycle.frames
            if self.bench.now_s() - start_s > limit_s:
                raise DeviceError(
                    f"step {step.step} (block {step.block + 1}, {step.condition}, {step.level:g}): only {counted} of "
                    f"{self.plan.rig.frames} records of sensor {self.plan.rig.sensor!r} came in {limit_s:.1f} s: check "
                    "the rig with `saranga-bench rig check`, then go on with --resume")
        means = self._means(step, readings)
        condition = self.plan.condition(step.condition)
        return {
            **step.to_dict(), "shield": condition.shield, **means, "settled": settled, "settle_s": round(settled_s, 3),
            "noise": {role: meter.reading().to_dict() for role, meter in meters.items() if meter.n},
            "coherence": coherence.value(), "coherence_segments": coherence.segments,
            "triggers": [first, last], "time_s": [round(start_s, 6), round(self.bench.now_s(), 6)],
            "readings": len(readings), "origin": self.origin}

    def _aim(self, step: Step) -> None:
        self._seeker = None
        if step.level == 0.0:
            self._throttle = 0.0
        elif self.plan.levels.by_thrust:
            self._seeker = ThrustSeeker(step.level, self.plan.limits.throttle, self._throttle)
            self._throttle = self._seeker.throttle
        else:
            self._throttle = step.level

    def _settle(self, step: Step) -> bool:
        settle = self.plan.settle
        watch = Settling(settle.least_s, settle.most_s, settle.window_s, settle.per_second, settle.floor_n)
        self._arrive(step)
        began_s = self.bench.now_s()
        while True:
            heard = self._poll(step)
            now_s = self.bench.now_s() - began_s
            for reading in heard.readings:
                # A stand without thrust settles by what it has.
                value = reading.thrust_n if math.isfinite(reading.thrust_n) else reading.rpm / 1e4
                watch.add(now_s, value)
                if self._seeker is not None:
                    self._throttle = self._seeker.next(reading.thrust_n, now_s)
            seeking = self._seeker is not None and not self._seeker.close_enough
            if not seeking and watch.settled(now_s) and self._still(step, heard):
                if self._seeker is not None:
                    self._seeker.hold()
                return True
            if watch.given_up(now_s):
                if self._seeker is not None:
                    self._seeker.hold()
                return False

    def _arrive(self, step: Step) -> None:
        """Wait for the end of the supervisor's ramp, as the device says; one without readback is believed."""
        began_s = self.bench.now_s()
        while True:
            for reading in self._poll(step).readings[-1:]:
                if not math.isfinite(reading.throttle) or abs(reading.throttle - self._throttle) <= ARRIVED:
                    return
            if self.bench.now_s() - began_s > ARRIVE_S:
                raise DeviceError(f"step {step.step}: {ARRIVE_S:g} s after throttle {self._throttle:.3f} was asked "
                                  "for the device does not say that it applies it: check the stand, then go on with "
                                  "--resume")

    def _still(self, step: Step, heard: Heard) -> bool:
        """For a background the rotor must stand; a stand without rpm is taken by its thrust, which settles."""
        if step.level > 0.0:
            return True
        rpm = [r.rpm for r in heard.readings if math.isfinite(r.rpm)]
        return not rpm or abs(rpm[-1]) < STOPPED_RPM

    def _poll(self, step: Step) -> Heard:
        if self.asked_to_stop():
            raise Interrupted
        self.bench.set_throttle(self._throttle)
        heard = self.bench.poll(POLL_S)
        self.stand.write(step.step, heard.readings)
        why = self.bench.trouble()
        if why is not None:
            raise DeviceError(f"the supervisor has taken the throttle away: {why}; mend the cause, clear the "
                              "trip, then go on with --resume")
        self.watcher.heard(step, heard, self.bench.now_s())
        return heard

    def _means(self, step: Step, readings: list[StandReading]) -> dict[str, Any]:
        """Mean of every quantity (None where not measured), with what makes a step worthless as an error."""
        where = f"step {step.step} (block {step.block + 1}, {step.condition}, level {step.level:g})"
        if not readings:
            raise DeviceError(f"{where}: the stand sent no reading: is it connected and powered? Go on with --resume")
        found: dict[str, Any] = {}
        for name in QUANTITIES:
            values = [v for v in (getattr(r, name) for r in readings) if math.isfinite(v)]
            found[name] = sum(values) / len(values) if values else None
            if name == "thrust_n" and step.level > 0.0:
                share = len(values) / len(readings)
                if share < LEAST_FINITE_SHARE:
                    raise DeviceError(
                        f"{where}: {len(readings) - len(values)} of {len(readings)} thrust readings are NaN, at most "
                        f"{1 - LEAST_FINITE_SHARE:.0%} may be, as losses are compared at equal thrust: check the load "
                        "cell, then go on with --resume")
                mean = found["thrust_n"]
                found["thrust_sd_n"] = math.sqrt(sum((v - mean) ** 2 for v in values) / len(values))
        applied = found["throttle"] if found["throttle"] is not None else self._throttle
        if step.level > 0.0 and applied >= SIGN_THROTTLE and (found["thrust_n"] or 0.0) < SIGN_THRUST_N:
            raise DeviceError(
                f"{where}: the stand reads {found['thrust_n']:.3f} N at throttle {applied:.2f}, and a propeller pulls: "
                "the load cell is mounted or calibrated the wrong way round; turn it or change the sign of its "
                "calibration, then start anew")
        found["throttle"] = applied
        return found

    # ---- around the steps ------------------------------------------------------------------------
    def _warm_up(self) -> None:
        warm = self.plan.warm_up
        if warm.throttle == 0.0 or warm.duration_s == 0.0 or not self.steps:
            return
        step = Step(-1, -1, self.steps[0].condition, "warm_up", warm.throttle, -1)
        until_s = self.bench.now_s() + warm.duration_s
        self._throttle = warm.throttle
        while self.bench.now_s() < until_s:
            self._poll(step)

    def _stand_still(self, step: Step) -> None:
        """Nobody reaches into a propeller: wait until the device says idle and the stand that nothing turns."""
        self._throttle = 0.0
        began_s = self.bench.now_s()
        quiet = 0
        while quiet < 3:
            for r in self._poll(step).readings:
                idle = not math.isfinite(r.throttle) or r.throttle == 0.0
                still = not math.isfinite(r.rpm) or abs(r.rpm) < STOPPED_RPM
                slack = not math.isfinite(r.thrust_n) or abs(r.thrust_n) < IDLE_THRUST_N or math.isfinite(r.rpm)
                quiet = quiet + 1 if idle and still and slack else 0
            if self.bench.now_s() - began_s > STANDSTILL_S:
                raise DeviceError(f"the motor has not come to a standstill within {STANDSTILL_S:g} s of idle (step "
                                  f"{step.step}): keep away, cut the power; is the stand tared? Go on with --resume")
