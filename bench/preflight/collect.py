"""Asking a vehicle everything once: connection, identity, all parameters, a watch at raised rates, pre-arm, logs.

Only what `guard.py` calls harmless is sent. Message rates of this link are read before they are raised and put back
afterwards. At the first heartbeat that says "armed" everything stops and nothing more is sent.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.preflight.evidence import MEASURED, Heard, VehicleEvidence, percentile
from bench.preflight.guard import GuardedLink
from saranga.errors import DeviceError
from saranga.vehicle import VehicleLink
from sitl.autopilot.frames import Frame, FrameReader

OWN_SYSTEM = 254
"""Not 255: the autopilot must not take us for the ground station whose loss is a failsafe."""
ARMED = "the vehicle is armed: gathering stopped at once, nothing more was asked"
STOPPED_BY_OPERATOR = "interrupted by the operator"
LATE_MS, MORE_TRIES, PINGS_AGAIN = 50.0, 2, 30
Say = Callable[[str], None]
Stop = Callable[[], bool]

# Rates of the watch, Hz.
WATCH = {
    mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW: 50.0, mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: 10.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 5.0, mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 5.0,
    mavlink.MAVLINK_MSG_ID_VIBRATION: 5.0, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 5.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 10.0, mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 2.0,
}
KEPT = frozenset({"HEARTBEAT", "SYS_STATUS", "EKF_STATUS_REPORT", "OPTICAL_FLOW", "DISTANCE_SENSOR", "VIBRATION",
                  "SYSTEM_TIME", "ATTITUDE", "BATTERY_STATUS", "AUTOPILOT_VERSION", "LOG_ENTRY", "GPS_GLOBAL_ORIGIN"})


@dataclass(frozen=True)
class Deadlines:
    """Host seconds that each phase has at the most; the watch takes its whole time."""

    connect_s: float = 8.0
    identify_s: float = 4.0
    parameters_s: float = 22.0
    settle_s: float = 1.0
    watch_s: float = 6.0
    answer_s: float = 1.5
    ping_period_s: float = 0.1


class Conversation:
    """One vehicle on one guarded link, and the evidence that grows.

    Args:
        system: the vehicle's MAVLink system id.
        now: host clock, s.
    """

    def __init__(self, link: GuardedLink, system: int = 1, now: Callable[[], float] = time.monotonic,
                 stop: Stop = lambda: False) -> None:
        self.link = link
        self.evidence = VehicleEvidence(link.url, system)
        self._talk = VehicleLink(OWN_SYSTEM, mavlink.MAV_COMP_ID_MISSIONPLANNER, system,
                                 mavlink.MAV_TYPE_ONBOARD_CONTROLLER)
        self._frames = FrameReader()
        self._now = now
        self.stop = stop
        self._heartbeat_s = 0.0
        self._sent_ns: dict[int, float] = {}
        self._others: dict[int, None] = {}
        self._intervals: dict[int, float] = {}
        self._raised = False
        self.acks: dict[int, int] = {}
        self.echoes: dict[str, float] = {}

    # ---- bytes -----------------------------------------------------------------------------------
    def pump(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Listen and keep talking for at most `seconds`; whether `until` came true.

        Raises:
            DeviceError: the link was lost.
        """
        deadline = self._now() + seconds
        while not self.evidence.stopped:
            now = self._now()
            if until():
                return True
            if now >= deadline:
                return False
            if self.stop():
                self.evidence.stopped = STOPPED_BY_OPERATOR
                return False
            if now - self._heartbeat_s >= 1.0:
                self._heartbeat_s = now
                self._talk.send_heartbeat()
            self._flush()
            self._take(self.link.read(min(0.05, max(deadline - now, 0.0))))
        return False

    def _flush(self) -> None:
        data = self._talk.take()
        if data and not self.evidence.stopped:
            self.link.write(data)

    def _take(self, data: bytes) -> None:
        if not data:
            return
        now = self._now()
        before = self._talk.bad_messages
        for message in self._talk.feed(data, round(now * 1e6)):
            self._keep(message, now)
        self.evidence.bad_messages += self._talk.bad_messages - before
        for frame in self._frames.feed(data):
            self._see_other(frame)
        self.evidence.other_vehicles = tuple(self._others)

    def _see_other(self, frame: Frame) -> None:
        """A heartbeat of an autopilot that is another system's."""
        if frame.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT and frame.system != self.evidence.system \
                and frame.component == mavlink.MAV_COMP_ID_AUTOPILOT1 \
                and frame.payload[5] != mavlink.MAV_AUTOPILOT_INVALID:
            self._others[frame.system] = None

    def _keep(self, message: Any, now: float) -> None:
        evidence, kind = self.evidence, message.get_type()
        evidence.good_messages += 1
        if kind in KEPT:
            fields = message.to_dict()
            del fields["mavpackettype"]
            evidence.messages.setdefault(kind, []).append(Heard(now, fields))
        if kind == "HEARTBEAT" and evidence.armed:
            evidence.stopped = ARMED
        elif kind == "PARAM_VALUE":
            evidence.parameters[message.param_id] = float(message.param_value)
            evidence.parameter_count = message.param_count
            evidence.parameters_s = now
            self.echoes[message.param_id] = float(message.param_value)
        elif kind == "COMMAND_ACK":
            self.acks[message.command] = message.result
        elif kind == "MESSAGE_INTERVAL":
            self._intervals[message.message_id] = float(message.interval_us)
        elif kind == "TIMESYNC" and message.tc1 != 0 and message.ts1 in self._sent_ns:
            evidence.round_trips_ms.append((now - self._sent_ns.pop(message.ts1)) * 1e3)
            evidence.round_trips_s = now
        elif kind == "STATUSTEXT":
            # The link puts long texts together; the newest of its list is whole so far.
            texts = [(t_us * 1e-6, severity, text) for t_us, severity, text in self._talk.status.texts]
            evidence.texts = texts

    # ---- phases ----------------------------------------------------------------------------------
    def connect(self, deadline_s: float) -> None:
        """Wait for a heartbeat.

        Raises:
            DeviceError: none came, with what came instead.
        """
        if self.pump(deadline_s, lambda: self.evidence.last("HEARTBEAT") is not None) or self.evidence.stopped:
            return
        if self._others:
            raise DeviceError(f"{self.link.url}: no heartbeat from system {self.evidence.system} in {deadline_s:g} s, "
                              f"but system {', '.join(map(str, self._others))} speaks: give --system")
        noise = f"; {self._frames.rubbish_bytes} bytes that are no MAVLink came" if self._frames.rubbish_bytes else ""
        raise DeviceError(f"{self.link.url}: no heartbeat in {deadline_s:g} s{noise}: is the vehicle powered, and are "
                          "port and baud rate right?")

    def identify(self, deadline_s: float) -> None:
        """Ask for AUTOPILOT_VERSION until it comes, and for the origin."""
        deadline = self._now() + deadline_s
        while self._now() < deadline and not self.evidence.stopped:
            self._talk.request_message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
            self._talk.request_message(mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
            if self.pump(min(1.0, deadline_s), lambda: self.evidence.version is not None):
                return

    def read_parameters(self, deadline_s: float, needed: list[str], say: Say = lambda text: None) -> None:
        """The whole list; then, one by one, the needed ones that did not come."""
        evidence = self.evidence
        self._talk.send(mavlink.MAVLink_param_request_list_message(evidence.system, 1))
        deadline, told = self._now() + deadline_s, self._now()
        while self._now() < deadline and not evidence.stopped:
            before = len(evidence.parameters)
            self.pump(0.5, self._all_parameters)
            if self._all_parameters():
                return
            if self._now() - told > 2.0:
                told = self._now()
                say(f"parameters: {before} of {evidence.parameter_count or 'unknown'}")
            if len(evidence.parameters) == before:
                self._ask_missing(needed)

    def _all_parameters(self) -> bool:
        count = self.evidence.parameter_count
        return count is not None and len(self.evidence.parameters) >= count

    def _ask_missing(self, needed: list[str]) -> None:
        """The stream has dried up: ask for what is needed by name, and for the list anew where nothing else is."""
        missing = [name for name in needed if name not in self.evidence.parameters]
        for name in missing[:10]:
            self._talk.request_parameter(name)
        if not missing or self.evidence.parameter_count is None:
            self._talk.send(mavlink.MAVLink_param_request_list_message(self.evidence.system, 1))

    def raise_rates(self, deadline_s: float) -> None:
        """Note the rates this link has, and raise those of the watch."""
        for message_id in WATCH:
            self._talk.send_command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, message_id)
        self.pump(deadline_s, lambda: len(self._intervals) >= len(WATCH))
        self.evidence.intervals_us = dict(self._intervals)
        self._raised = True
        for message_id, rate_hz in WATCH.items():
            self._talk.send_message_interval(message_id, rate_hz)

    def watch(self, deadlines: Deadlines) -> None:
        """Raise the rates and listen, with TIMESYNC round trips beside, and the pre-arm checks run in the middle."""
        evidence = self.evidence
        self.raise_rates(deadlines.answer_s)
        self.pump(deadlines.settle_s)
        began = self._now()
        next_ping, asked = began, False
        while self._now() - began < deadlines.watch_s and not evidence.stopped:
            now = self._now()
            if now >= next_ping:
                next_ping = now + deadlines.ping_period_s
                self._ping(now)
            if not asked and now - began > 0.3 * deadlines.watch_s:
                asked = True
                evidence.prearm_asked_s = now
                self._talk.send_command(mavlink.MAV_CMD_RUN_PREARM_CHECKS)
            self.pump(min(deadlines.ping_period_s, 0.05))
        evidence.watch_s = (began, self._now())
        self.pump(deadlines.answer_s, lambda: not self._sent_ns)
        evidence.prearm_result = self.acks.get(mavlink.MAV_CMD_RUN_PREARM_CHECKS)
        self.ping_again(deadlines)

    def ping_again(self, deadlines: Deadlines) -> None:
        """A simulator shares this computer: what was late because of that is measured anew, the best try counts.

        A vehicle that is really there has one try: what is late now and then there will be so in flight.
        """
        evidence = self.evidence
        best = (evidence.round_trips_ms, evidence.round_trips_asked, evidence.round_trips_s)
        for _ in range(MORE_TRIES if evidence.origin != MEASURED else 0):
            if percentile(best[0], 0.9) <= LATE_MS or not best[0] or evidence.stopped:
                break
            self._sent_ns.clear()
            evidence.round_trips_ms, evidence.round_trips_asked = [], 0
            for _ in range(PINGS_AGAIN):
                self._ping(self._now())
                self.pump(deadlines.ping_period_s)
            self.pump(deadlines.answer_s, lambda: not self._sent_ns)
            tried = (evidence.round_trips_ms, evidence.round_trips_asked, evidence.round_trips_s)
            if len(tried[0]) >= 0.9 * tried[1] and percentile(tried[0], 0.9) < percentile(best[0], 0.9):
                best = tried
        evidence.round_trips_ms, evidence.round_trips_asked, evidence.round_trips_s = best

    def _ping(self, now: float) -> None:
        stamp = round(now * 1e9)
        self._sent_ns[stamp] = now
        self.evidence.round_trips_asked += 1
        self._talk.send(mavlink.MAVLink_timesync_message(0, stamp))

    def list_logs(self, deadline_s: float) -> None:
        """LOG_REQUEST_LIST; reading the list stops nothing."""
        self._talk.request_message(mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
        self._talk.send(mavlink.MAVLink_log_request_list_message(self.evidence.system, 1, 0, 0xFFFF))
        self.pump(deadline_s, lambda: self.evidence.last("LOG_ENTRY") is not None)

    def put_rates_back(self) -> None:
        """As they were; 0 (not known) is the default rate. Nothing where they were never raised."""
        if self.evidence.stopped == ARMED or not self._raised:
            return
        for message_id in WATCH:
            interval_us = self.evidence.intervals_us.get(message_id, 0.0)
            self._talk.send_command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, interval_us)
        self.link.write(self._talk.take())

    def set_parameter(self, name: str, value: float, deadline_s: float = 3.0) -> float | None:
        """Write one and read it back; what it then reads, None without an answer. The guard must be open."""
        for _ in range(3):
            self.echoes.pop(name, None)
            self._talk.send(mavlink.MAVLink_param_set_message(
                self.evidence.system, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32))
            if self.pump(deadline_s / 3.0, lambda: name in self.echoes):
                break
        self.echoes.pop(name, None)
        self._talk.request_parameter(name)
        self.pump(deadline_s, lambda: name in self.echoes)
        return self.echoes.get(name)


def gather(conversation: Conversation, needed: list[str], say: Say = lambda text: None,
           deadlines: Deadlines | None = None) -> VehicleEvidence:
    """All phases in order; stops at once where the vehicle is armed or the operator asks.

    Message rates stay raised: `put_rates_back` belongs to the caller.

    Raises:
        DeviceError: no vehicle answers, or the link is lost.
    """
    times = deadlines or Deadlines()
    evidence = conversation.evidence
    say("vehicle: waiting for a heartbeat")
    conversation.connect(times.connect_s)
    phases: list[tuple[str, Callable[[], None]]] = [
        ("who it is", lambda: conversation.identify(times.identify_s)),
        ("parameters", lambda: conversation.read_parameters(times.parameters_s, needed, say)),
        (f"watching for {times.watch_s:g} s", lambda: conversation.watch(times)),
        ("logs", lambda: conversation.list_logs(times.answer_s)),
    ]
    for title, phase in phases:
        if evidence.stopped:
            break
        say(f"vehicle: {title}")
        phase()
    return evidence
