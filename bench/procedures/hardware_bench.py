"""The real chain, for emulated devices too: the supervisor's process owns the throttle, the rig is read beside it."""

import threading
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from bench.procedures.bench import BenchInfo, Hands, Heard
from bench.procedures.emulated_device import EmulatedProcess
from bench.procedures.plan import Condition, NoisePlan
from bench.procedures.runner import Interrupted
from bench.procedures.simulated_bench import hello_dict, vars_of
from bench.rig.driver import Rig
from bench.supervisor import Confirmation, Limits, Supervisor, SupervisorPlan
from saranga.errors import DeviceError, UsageError
from saranga.sources import rig_link
from saranga.wire import MODE_RECEIVE_ONLY

MOUNT_POLL_S = 0.05


class HardwareBench:
    """Supervisor, rig, and hands.

    Args:
        plan: for limits and rig settings.
        rig_url: where the rig is, when it does not hang on the supervisor's own port.
        stand_url, throttle_url: as `bench/thrust_stand` knows them.
        confirmation: that something will spin.
        hands: how a person is asked to mount something; None with `emulated`.
        emulated: the device's process when it was started for this sweep.
        record: new MCAP file for the rig's bytes.
        log_folder: of the run, for the supervisor's own log.
        asked_to_stop: looked at while a person mounts.
    """

    real_time = True

    def __init__(self, plan: NoisePlan, rig_url: str, stand_url: str, throttle_url: str, confirmation: Confirmation,
                 record: Path, log_folder: Path, asked_to_stop: Callable[[], bool], hands: Hands | None = None,
                 emulated: EmulatedProcess | None = None) -> None:
        self.by_hand = emulated is None
        self._plan = plan
        self._rig_url, self._stand_url, self._throttle_url = rig_url, stand_url, throttle_url
        self._confirmation = confirmation
        self._record = record
        self._log_folder = log_folder
        self._asked_to_stop = asked_to_stop
        self._hands = hands
        self._emulated = emulated
        self._supervisor: Supervisor | None = None
        self._source: Rig | None = None
        self._report: dict[str, Any] | None = None

    def open(self) -> BenchInfo:
        """Start the supervisor, then the rig.

        Raises:
            UsageError: a limit that nothing measures, or nobody has confirmed. DeviceError: a device fails.
        """
        limits = Limits(**{k: v for k, v in self._plan.limits.model_dump().items() if v is not None})
        plan = SupervisorPlan(self._throttle_url, self._stand_url, limits, log_folder=self._log_folder)
        if self._emulated is not None:
            # It hurts nobody: a busy machine may hold its loop up for longer than a real motor allows.
            plan = replace(plan, token_timeout_s=1.0, stale_s=2.0, readback_s=2.0)
        self._supervisor = sup = Supervisor.start(plan, confirm=self._confirmation)
        try:
            if not sup.confirmed:
                raise UsageError(f"the stand is {sup.origin}: nothing spins before SPIN has been typed (--yes-spin is "
                                 "enough for emulated devices only)")
            # A rig on a port of its own is opened there; one on the stand's port by the supervisor's tee.
            own = self._rig_url and not self._stand_url.endswith(f"+{self._rig_url}")
            url = self._rig_url if own or sup.rig_url is None else sup.rig_url
            rig = self._plan.rig
            # A rig that is gone ends the step: what it measured then would have holes.
            self._source = Rig(rig_link(url), record=self._record, reconnect_s=0.0)
            hello = self._source.open()
            roles = [s.role for s in hello.sensors]
            if rig.sensor not in roles:
                raise UsageError(f"{url}: the rig has no sensor {rig.sensor!r}, only {', '.join(filter(None, roles))}: "
                                 "change rig.sensor in the plan")
            self._source.configure(rig.odr, rig.samples, ring_down_samples=0)
            self._source.start(MODE_RECEIVE_ONLY, rig.rate_hz)
        except BaseException:
            self.stop()
            self.close()
            raise
        emulated = "emulated" in (self._source.origin, sup.origin)
        return BenchInfo("emulated" if emulated else sup.origin, {**hello_dict(hello), "url": url},
                         {**sup.stand, "url": self._stand_url, "throttle_url": self._throttle_url,
                          **({"given": self._emulated.given} if self._emulated is not None else {})})

    def now_s(self) -> float:
        return time.monotonic()

    def set_throttle(self, value: float) -> None:
        self._sup().set(value)

    def poll(self, timeout_s: float) -> Heard:
        source = self._rig()
        cycles = source.poll(timeout_s)
        return Heard(self._sup().readings(), cycles)

    def mount(self, condition: Condition) -> None:
        if self._emulated is not None:
            self._emulated.mount(condition)
            return
        if self._hands is None:
            raise UsageError(f"nobody is there to mount {condition.name!r}: run the sweep from a terminal")
        failed: list[BaseException] = []

        def ask() -> None:
            assert self._hands is not None
            try:
                self._hands(mount_text(condition))
            except BaseException as error:
                failed.append(error)

        # The links are read all the while, so that nothing overflows; the throttle stays at zero.
        person = threading.Thread(target=ask, daemon=True, name="mounting")
        person.start()
        while person.is_alive():
            if self._asked_to_stop():
                raise Interrupted
            self.set_throttle(0.0)
            self.poll(MOUNT_POLL_S)
            why = self.trouble()
            if why is not None:
                raise DeviceError(f"while {condition.name!r} was being mounted: {why}")
        if failed:
            raise UsageError(f"nobody is at the terminal to mount {condition.name!r}: {failed[0]!r}") from failed[0]

    def trouble(self) -> str | None:
        status = self._sup().status()
        if status.trips or status.state in ("tripped", "stopped"):
            return status.why or status.state
        return None

    def counters(self) -> dict[str, Any]:
        if self._source is None:
            return {}
        found = {**vars_of(self._source.counters),
                 **{f"cycle_{k}": v for k, v in vars_of(self._source.cycle_counters).items()}}
        if self._supervisor is not None:
            status = self._supervisor.status()
            found |= {"tee_refused": status.tee_refused, "tee_dropped_bytes": status.tee_dropped_bytes}
        return found

    def stop(self) -> dict[str, Any]:
        if self._supervisor is not None and self._report is None:
            report = asdict(self._supervisor.stop())
            seconds = report["seconds"]
            self._report = {**report, "seconds": seconds if seconds == seconds else None}
        return self._report or {"confirmed": False, "text": "the supervisor never ran: nothing spun"}

    def close(self) -> None:
        if self._source is not None:
            source, self._source = self._source, None
            source.close()
        self.stop()

    def _sup(self) -> Supervisor:
        if self._supervisor is None:
            raise DeviceError("the bench is not open: open it first")
        return self._supervisor

    def _rig(self) -> Rig:
        if self._source is None:
            raise DeviceError("the rig is not open: open the bench first")
        return self._source


def mount_text(condition: Condition) -> str:
    """What the operator is asked to do."""
    parts = [condition.mount or ("take any shield off" if condition.shield == "none" else
                                 f"mount shield {condition.shield}")]
    for text in (f"propeller {condition.propeller}" if condition.propeller else "", condition.material,
                 f"height {1e3 * condition.height_m:g} mm" if condition.height_m else "",
                 f"width {1e3 * condition.width_m:g} mm" if condition.width_m else "",
                 f"hub to sensor {1e3 * condition.hub_distance_m:g} mm" if condition.hub_distance_m else ""):
        if text:
            parts.append(text)
    return f"{condition.name}: " + ", ".join(parts)
