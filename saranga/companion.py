"""The stack as a real companion process: echoes from a URL, velocity setpoints to a vehicle URL, in wall time.

It never arms, never takes off, never changes mode. It sends setpoints only while the vehicle says that it is
armed, in GUIDED and in the air with its take-off complete; a pilot or ground station decides all of that.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.byte_links import ByteLink
from saranga.echo import EchoCycle
from saranga.errors import DeviceError
from saranga.navigate import VelocityCommand
from saranga.sonar_geometry import LIMITS
from saranga.sources import EchoSource
from saranga.stack import HOLD, Decision, Stack
from saranga.vehicle import MODE_GUIDED, VehicleLink

TICK_S = 0.0625
STATUS_S = 1.0
VEHICLE_SILENT_S = 3.0
FIRST_HEARTBEAT_S = 30.0
TEMPERATURE_STEP_C = 0.25
"""0.7 mm at 1.6 m; a new speed of sound costs about 2 ms, so it must not change with every reading."""


@dataclass
class Tally:
    """Counts of one run, for the closing summary."""

    ticks: int = 0
    setpoints: int = 0
    late_ticks: int = 0
    faults: int = 0
    longest_step_ms: float = 0.0


def may_command(link: VehicleLink) -> bool:
    """Armed, in GUIDED, and flying (not taking off, not landing)."""
    status = link.status
    return status.armed and status.mode == MODE_GUIDED and status.landed_state == mavlink.MAV_LANDED_STATE_IN_AIR


class Companion:
    """Runs `stack` between an echo source and a vehicle.

    Args:
        log: one JSON line a tick is appended here when given.
        say: where a status line a second goes.
        follow_temperature: take the air's temperature from the rig's STATUS, where it measures one.
        sign_key: of MAVLink 2 signing, 32 bytes; what is not signed with it is not heard.
    """

    def __init__(self, stack: Stack, source: EchoSource, vehicle: ByteLink, log: Path | None = None,
                 say: Callable[[str], None] = print, follow_temperature: bool = False,
                 sign_key: bytes | None = None) -> None:
        self.stack = stack
        self.source = source
        self.vehicle = vehicle
        self.link = VehicleLink(sign_key=sign_key)
        self.tally = Tally()
        self._say = say
        self._log: TextIO | None = log.open("a", encoding="utf-8") if log else None
        self._stop: str | None = None
        self._was_commanding = False
        self._pending: list[EchoCycle] = []
        self._follow_temperature = follow_temperature
        self._temperature_c: float | None = None

    def stop(self, reason: str) -> None:
        """Ask the loop to end after this tick (safe from a signal handler)."""
        self._stop = reason

    def run(self) -> str:
        """Loop until `stop`; returns the reason.

        Raises:
            DeviceError: echo source or vehicle lost; a stop is commanded first where that is still possible.
        """
        started = time.monotonic()
        next_tick, next_second = started, started
        try:
            while self._stop is None:
                cycles = self.source.poll(max(0.0, next_tick - time.monotonic()))
                now = time.monotonic()
                if now < next_tick:
                    self._pending.extend(cycles)
                    continue
                cycles, self._pending = [*self._pending, *cycles], []
                self.tally.late_ticks += now - next_tick > TICK_S / 2
                next_tick = max(next_tick + TICK_S, now - TICK_S)
                t_us = round((now - started) * 1e6)
                self._hear(t_us, now - started)
                self._warm_or_cool()
                decision = self.stack.step(cycles, t_us)
                self._command(decision, t_us)
                if now >= next_second:
                    next_second = now + STATUS_S
                    self._each_second(decision)
                self._record(decision, t_us)
            return self._stop
        finally:
            self._last_command()
            if self._log is not None:
                self._log.close()

    def _hear(self, t_us: int, elapsed_s: float) -> None:
        self.link.feed(self.vehicle.read(0.0), t_us)
        heard = self.link.status.heartbeat_us
        if heard is None and elapsed_s > FIRST_HEARTBEAT_S:
            refused = self.link.bad_messages
            raise DeviceError(f"vehicle: no heartbeat of system {self.link.target_system} in {FIRST_HEARTBEAT_S:g} s: "
                              "is the autopilot on this port and its system id right?" + (
                                  f" {refused} frames were damaged or not signed with the key" if refused else ""))
        if heard is not None and t_us - heard > VEHICLE_SILENT_S * 1e6:
            raise DeviceError(f"vehicle silent for {(t_us - heard) / 1e6:.1f} s (limit {VEHICLE_SILENT_S:g} s): "
                              "check the MAVLink cable or port")

    def _warm_or_cool(self) -> None:
        """Follow the rig's thermometer in steps of TEMPERATURE_STEP_C; what no air in which it flies has is ignored."""
        status = self.source.status
        if not self._follow_temperature or status is None:
            return
        low, high = LIMITS["weather"]["temperature_c"]
        if not low <= status.temperature_c <= high:
            return
        temperature_c = TEMPERATURE_STEP_C * round(status.temperature_c / TEMPERATURE_STEP_C)
        if temperature_c != self._temperature_c:
            self._temperature_c = temperature_c
            self.stack.set_temperature(temperature_c)
            self._say(f"air {temperature_c:g} C: {self.stack.c_m_s:.1f} m/s")

    def _command(self, decision: Decision, t_us: int) -> None:
        step_ms = sum(decision.timing_ms.values())
        self.tally.ticks += 1
        self.tally.faults += decision.fault is not None
        self.tally.longest_step_ms = max(self.tally.longest_step_ms, step_ms)
        commanding = may_command(self.link)
        if commanding:
            if not self._was_commanding:
                self.stack.policy.reset()
            self.link.send_velocity(decision.command, t_us)
            self.tally.setpoints += 1
        self._was_commanding = commanding
        data = self.link.take()
        if data:
            self.vehicle.write(data)

    def _each_second(self, decision: Decision) -> None:
        self.link.send_heartbeat()
        if self.link.status.heartbeat_us is not None and self.link.status.landed_state is None:
            self.link.send_message_interval(mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 5)
        status = self.link.status
        nearest = min((o.range_m for o in decision.obstacles), default=None)
        command: VelocityCommand = decision.command
        self._say(f"{status.mode_name} {'armed' if status.armed else 'disarmed'}  "
                  f"nearest {'-' if nearest is None else f'{nearest:.2f} m'}  "
                  f"command {command.vx_m_s:+.2f} {command.vy_m_s:+.2f} {command.vz_m_s:+.2f} m/s"
                  f"{'' if self._was_commanding else ' (not sent)'}  "
                  f"step {sum(decision.timing_ms.values()):.1f} ms"
                  f"{f'  FAULT {decision.fault}' if decision.fault else ''}")

    def _record(self, decision: Decision, t_us: int) -> None:
        if self._log is None:
            return
        command = decision.command
        self._log.write(json.dumps({
            "t_us": t_us, "sent": self._was_commanding,
            "command": [command.vx_m_s, command.vy_m_s, command.vz_m_s, command.yaw_rate_rad_s],
            "obstacles": [[round(o.x_m, 4), round(o.y_m, 4), round(o.z_m, 4)] for o in decision.obstacles],
            "fault": decision.fault, "timing_ms": {k: round(v, 3) for k, v in decision.timing_ms.items()},
        }) + "\n")
        self._log.flush()

    def _last_command(self) -> None:
        """Leaving while in command: stop the vehicle rather than let it coast on the last setpoint."""
        if self._was_commanding:
            self.link.send_velocity(HOLD, 0)
            try:
                self.vehicle.write(self.link.take())
            except DeviceError as error:
                self._say(f"could not send the closing stop: {error}; the autopilot brakes by GUID_TIMEOUT")
