"""The real ArduCopter as a subprocess, in lockstep through ArduPilot's JSON physics backend.

ArduPilot sends a servo packet over UDP and waits for one JSON state; while we are silent its time stands
still. MAVLink is written before the state is sent and read after the next servo packet, on one thread, which
is what makes a flight bit-repeatable. Both sockets are on loopback and opened by us, so there are no port
numbers to collide. (ArduPilot: libraries/SITL/examples/JSON/readme.md.)
"""

import contextlib
import shutil
import signal
import socket
import struct
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saranga.errors import DeviceError
from sitl.autopilot.binary import require_binary
from sitl.autopilot.one_cpu import OneCpu
from sitl.autopilot.parameters import load_parameters, write_defaults
from sitl.physics import VehicleState
from sitl.process import die_with_parent

SERVO_16 = struct.Struct("<HHI16H")
MAGIC_16 = 18458
TICK_US = 2_500
START_DEADLINE_S = 20.0
ANSWER_DEADLINE_S = 8.0
POLL_S = 0.25
CLOSING_TICKS = 400
# ArduPilot truncates (t1 - t0) * 1e6 to integer microseconds; without the nudge 0.0025 s becomes 2499 us.
TIMESTAMP_NUDGE_S = 1e-7
# ArduPilot ignores the text before its first newline. It must come with the first state, and that state's time must
# not be zero: while its clock stands at zero ArduPilot counts wall time, and its boot would depend on the machine.
GREETING = b"\n"
HOME = "42.27381,-71.80989,150,0"
STATE = (
    '{"timestamp":%.7f,"imu":{"gyro":[%.9g,%.9g,%.9g],"accel_body":[%.9g,%.9g,%.9g]},'
    '"position":[%.9g,%.9g,%.9g],"quaternion":[%.9g,%.9g,%.9g,%.9g],"velocity":[%.9g,%.9g,%.9g],"no_time_sync":1}\n'
)


class ArduCopter:
    """One ArduCopter process.

    Args:
        workdir: where it runs and keeps `eeprom.bin`, `logs/` and its console; None makes a temporary one.
        parameters: name in fixtures/parameters.
    """

    kind = "arducopter"

    def __init__(self, workdir: Path | None = None, parameters: str = "arducopter-gps-denied",
                 binary: Path | None = None) -> None:
        self.version = "unknown"
        self.tick_us = TICK_US
        self.parameters = load_parameters(parameters)
        self._binary = binary
        self._own_workdir = workdir is None
        self.workdir = Path(tempfile.mkdtemp(prefix="saranga-arducopter-")) if workdir is None else workdir
        self._process: subprocess.Popen[bytes] | None = None
        self._udp: socket.socket | None = None
        self._tcp: socket.socket | None = None
        self._frame = -1
        self._throttle = np.zeros(4)
        self._cause: str | None = None
        self._last_state: tuple[float, ...] = ()
        self._closing_us = 0
        self._greeting = GREETING
        self._one_cpu = OneCpu()

    # ---- life ------------------------------------------------------------------------------------
    def start(self, state: VehicleState) -> None:
        binary = self._binary or require_binary()
        self.workdir.mkdir(parents=True, exist_ok=True)
        defaults = self.workdir / "bench.parm"
        write_defaults(self.parameters, defaults)
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.bind(("127.0.0.1", 0))
        listener = socket.create_server(("127.0.0.1", 0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            spare_port = probe.getsockname()[1]
        command = [
            str(binary.resolve()), "--model", "JSON:127.0.0.1", "--wipe", "--home", HOME, "--speedup", "1",
            "--defaults", defaults.name, "--sim-address", "127.0.0.1",
            "--sim-port-out", str(self._udp.getsockname()[1]), "--rc-in-port", str(spare_port),
            "--serial0", f"tcpclient:127.0.0.1:{listener.getsockname()[1]}",
            "--serial1", "none:unused", "--serial2", "none:unused",
        ]
        try:
            with (self.workdir / "console.txt").open("wb") as console:
                self._process = subprocess.Popen(command, cwd=self.workdir, stdin=subprocess.DEVNULL, stdout=console,
                                                 stderr=subprocess.STDOUT, preexec_fn=die_with_parent,
                                                 start_new_session=True)
        except OSError as error:
            listener.close()
            raise DeviceError(f"{binary}: cannot be started: {error.strerror}; is it a Linux SITL build for this "
                              "machine? `saranga-bench sitl check` tells") from error
        deadline = time.monotonic() + START_DEADLINE_S
        with listener:
            self._tcp = self._accept(listener, deadline)
        self._tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._tcp.setblocking(False)
        packet, peer = self._first_packet(deadline)
        self._udp.connect(peer)
        timeout = struct.pack("ll", 0, round(POLL_S * 1e6))
        self._udp.setblocking(True)
        self._udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeout)
        self._take_servos(packet)
        assert self._process is not None
        self._one_cpu.take(self._process.pid)

    def _accept(self, listener: socket.socket, deadline: float) -> socket.socket:
        listener.settimeout(POLL_S)
        while True:
            try:
                return listener.accept()[0]
            except TimeoutError:
                self._check_alive(deadline, "to connect its MAVLink port")

    def _first_packet(self, deadline: float) -> tuple[bytes, tuple[str, int]]:
        assert self._udp is not None
        self._udp.settimeout(POLL_S)
        while True:
            try:
                return self._udp.recvfrom(2048)
            except TimeoutError:
                self._drain()
                self._check_alive(deadline, "for its first servo packet")

    def _check_alive(self, deadline: float, what: str) -> None:
        dead = self.health()
        if dead is None and time.monotonic() > deadline:
            dead = f"arducopter is running but we waited in vain {what}; see {self.workdir / 'console.txt'}"
        if dead is not None:
            self.close()
            raise DeviceError(dead)

    def health(self) -> str | None:
        if self._cause is None and self._process is not None:
            code = self._process.poll()
            if code is not None:
                how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
                self._cause = f"arducopter process ended ({how}); last console line: {self._console_tail()!r}"
        return self._cause

    def _console_tail(self) -> str:
        with contextlib.suppress(OSError):
            lines = (self.workdir / "console.txt").read_text(errors="replace").strip().splitlines()
            return lines[-1] if lines else ""
        return ""

    def close(self) -> None:
        self._one_cpu.release()
        process = self._process
        if process is not None and process.poll() is None:
            process.terminate()
            self._answer_until_exit(process)
            process.kill()
            process.wait()
        for sock in (self._udp, self._tcp):
            if sock is not None:
                sock.close()
        self._udp = self._tcp = None
        if self._own_workdir:
            shutil.rmtree(self.workdir, ignore_errors=True)

    def _answer_until_exit(self, process: subprocess.Popen[bytes]) -> None:
        """ArduPilot acts on SIGTERM (and closes its log) only when its clock moves: let it run on for a moment."""
        for _ in range(CLOSING_TICKS):
            if process.poll() is not None or self._udp is None or not self._last_state:
                return
            self._closing_us += TICK_US
            with contextlib.suppress(OSError):
                self._udp.send(self._state_text(self._closing_us))
                self._udp.recv(2048)

    # ---- one tick --------------------------------------------------------------------------------
    def step(self, state: VehicleState, mavlink_in: bytes) -> tuple[NDArray[np.float64], bytes]:
        if self._udp is None or self._tcp is None:
            raise DeviceError("arducopter is not running: start() it first")
        try:
            if mavlink_in:
                self._send(mavlink_in)
            self._last_state = (*state.rates_rad_s.tolist(), *state.accel_body_m_s2.tolist(), *state.pos_m.tolist(),
                                *state.quat.tolist(), *state.vel_m_s.tolist())
            self._closing_us = state.t_us
            self._udp.send(self._greeting + self._state_text(state.t_us))
            self._greeting = b""
            self._take_servos(self._await_servos())
        except (ConnectionError, BrokenPipeError) as error:
            time.sleep(0.05)
            raise DeviceError(self.health() or f"the socket to arducopter is gone: {error}") from error
        return self._throttle, self._drain()

    def _state_text(self, t_us: int) -> bytes:
        clock_us = t_us + TICK_US
        timestamp_s = clock_us * 1e-6 + TIMESTAMP_NUDGE_S * (clock_us // TICK_US)
        return (STATE % (timestamp_s, *self._last_state)).encode("ascii")

    def _send(self, data: bytes) -> None:
        assert self._tcp is not None
        sent = 0
        deadline = time.monotonic() + ANSWER_DEADLINE_S
        while sent < len(data):
            try:
                sent += self._tcp.send(data[sent:])
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise DeviceError("arducopter does not read its MAVLink port (8 s): it hangs") from None
                time.sleep(0.001)

    def _await_servos(self) -> bytes:
        assert self._udp is not None
        deadline = time.monotonic() + ANSWER_DEADLINE_S
        while True:
            try:
                packet = self._udp.recv(2048)
            except BlockingIOError:
                dead = self.health()
                if dead is None and time.monotonic() > deadline:
                    dead = (f"arducopter answered no physics state within {ANSWER_DEADLINE_S:g} s "
                            f"(physics socket lost, or it hangs); see {self.workdir / 'console.txt'}")
                if dead is not None:
                    raise DeviceError(dead) from None
                continue
            # After a silent second ArduPilot sends the same frame again: that is not a new step.
            if len(packet) == SERVO_16.size and SERVO_16.unpack_from(packet)[2] != self._frame:
                return packet

    def _take_servos(self, packet: bytes) -> None:
        if len(packet) != SERVO_16.size:
            raise DeviceError(f"servo packet of {len(packet)} bytes, expected {SERVO_16.size}: set SERVO_32_ENABLE 0")
        magic, _, self._frame, *pwm = SERVO_16.unpack(packet)
        if magic != MAGIC_16:
            raise DeviceError(f"servo packet with magic {magic}, expected {MAGIC_16}: not ArduPilot's JSON backend")
        self._throttle = np.array([min(max((width - 1000) / 1000.0, 0.0), 1.0) for width in pwm[:4]])

    def _drain(self) -> bytes:
        assert self._tcp is not None
        parts = []
        while True:
            try:
                part = self._tcp.recv(65536)
            except BlockingIOError:
                break
            if not part:
                break
            parts.append(part)
            if len(part) < 65536:
                break
        return b"".join(parts)

    # ---- fault injection -------------------------------------------------------------------------
    def kill(self) -> None:
        """Kill the process without warning (fault campaigns)."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def lose_physics_socket(self) -> None:
        """Answer on a socket that ArduPilot does not listen to (fault campaigns): it then waits for ever."""
        if self._udp is not None:
            self._udp.close()
            self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._udp.bind(("127.0.0.1", 0))
            self._udp.connect(self._udp.getsockname())
            self._udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", 0, round(POLL_S * 1e6)))
