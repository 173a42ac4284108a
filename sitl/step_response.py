"""Step responses of an autopilot: velocity, stop, sideways, climb and setpoint loss, recorded and compared.

    python -m sitl.step_response record --autopilot arducopter --out fixtures/step_response/arducopter.json
    python -m sitl.step_response compare --autopilot embedded

The recording of the real ArduCopter is a fixture; the embedded autopilot is judged against it.
"""

import argparse
import contextlib
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saranga.errors import BenchError, DeviceError, UsageError
from saranga.fixtures import fixture_path
from saranga.navigate import VelocityCommand
from saranga.vehicle import VehicleLink, version_text
from sitl.airframe import load_airframe
from sitl.autopilot import make_autopilot
from sitl.clock import STACK_TICK_US, Periodic
from sitl.ground_control import Flight, GroundControl, Phase
from sitl.physics import Physics, SteadyWind
from sitl.sensors import FlightSensors

SAMPLE_US = 50_000
HEIGHT_M = 1.5
# (name, seconds, command or None for silence): one after the other, each starting where the last one ended.
SCRIPT: tuple[tuple[str, float, tuple[float, float, float] | None], ...] = (
    ("hover", 2.0, (0.0, 0.0, 0.0)),
    ("forward_1", 4.0, (1.0, 0.0, 0.0)),
    ("stop_from_1", 4.0, (0.0, 0.0, 0.0)),
    ("right_0_5", 3.0, (0.0, 0.5, 0.0)),
    ("left_0_5", 3.0, (0.0, -0.5, 0.0)),
    ("stop_sideways", 3.0, (0.0, 0.0, 0.0)),
    ("climb_0_5", 2.0, (0.0, 0.0, -0.5)),
    ("stop_climb", 3.0, (0.0, 0.0, 0.0)),
    ("forward_2", 3.0, (2.0, 0.0, 0.0)),
    ("silence", 6.0, None),
)


@dataclass
class StepResponse:
    """Samples every 50 ms from the start of the script.

    t_s (K,); command_m_s and velocity_m_s (K, 3) body-aligned NED; tilt_rad (K, 2) roll and pitch; height_m (K,);
    segment: name of the script's part at each sample.
    """

    autopilot: str
    version: str
    airframe: str
    t_s: list[float]
    segment: list[str]
    command_m_s: list[list[float]]
    velocity_m_s: list[list[float]]
    tilt_rad: list[list[float]]
    height_m: list[float]

    def velocity(self) -> NDArray[np.float64]:
        return np.array(self.velocity_m_s)

    def rows(self, segment: str) -> NDArray[np.bool_]:
        return np.array(self.segment) == segment

    def save(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(asdict(self)) + "\n", encoding="utf-8")

    @staticmethod
    def load(path: Path) -> "StepResponse":
        """Raises UsageError where the file is not a recording."""
        try:
            return StepResponse(**json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError) as error:
            raise UsageError(f"{path}: not a step response recording: {error}") from error


def record(kind: str, seed: int = 1) -> StepResponse:
    """Fly the script on an autopilot, without wind.

    Raises:
        DeviceError: it cannot be started, or did not get through take-off.
    """
    airframe = load_airframe()
    physics = Physics(airframe, np.zeros(3), SteadyWind(), seed)
    sensors = FlightSensors(seed)
    autopilot, parameters = make_autopilot(kind, seed)
    ground = GroundControl(Flight(HEIGHT_M, parameters, kind == "arducopter"))
    link = VehicleLink()
    out = StepResponse(kind, "", airframe.name, [], [], [], [], [], [])
    tick, sample = Periodic(STACK_TICK_US), Periodic(SAMPLE_US)
    total_s = sum(seconds for _, seconds, _ in SCRIPT)
    began_us: int | None = None
    companion = b""
    with contextlib.closing(autopilot):
        autopilot.start(physics.state)
        while True:
            state = physics.state
            throttle, data = autopilot.step(state, sensors.step(state) + ground.take() + companion)
            companion = b""
            physics.step(autopilot.tick_us, throttle)
            ground.feed(data, state.t_us)
            if tick.due(state.t_us):
                ground.tick(state.t_us, -float(state.pos_m[2]))
                if ground.phase is Phase.FAILED:
                    raise DeviceError(f"{kind}: {ground.cause}")
                if ground.phase is Phase.COURSE:
                    began_us = state.t_us if began_us is None else began_us
                    _, command = _part((state.t_us - began_us) / 1e6)
                    if command is not None:
                        link.send_velocity(VelocityCommand(*command), state.t_us)
                        companion = link.take()
            if began_us is None:
                sample.next_us = state.t_us
                continue
            elapsed_s = (state.t_us - began_us) / 1e6
            if elapsed_s >= total_s:
                break
            if sample.due(state.t_us):
                _append(out, elapsed_s, physics)
    status = ground.link.status
    out.version = f"{version_text(status.firmware_version)} {status.firmware_hash}".strip()
    return out


def _part(elapsed_s: float) -> tuple[str, tuple[float, float, float] | None]:
    for name, seconds, command in SCRIPT:
        if elapsed_s < seconds:
            return name, command
        elapsed_s -= seconds
    return SCRIPT[-1][0], SCRIPT[-1][2]


def _append(out: StepResponse, elapsed_s: float, physics: Physics) -> None:
    name, command = _part(elapsed_s)
    state = physics.state
    w, x, y, z = state.quat.tolist()
    roll = float(np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))
    pitch = float(np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0)))
    out.t_s.append(round(elapsed_s, 4))
    out.segment.append(name)
    out.command_m_s.append([0.0, 0.0, 0.0] if command is None else list(command))
    out.velocity_m_s.append([round(float(v), 4) for v in state.vel_m_s])
    out.tilt_rad.append([round(roll, 5), round(pitch, 5)])
    out.height_m.append(round(-float(state.pos_m[2]), 4))


def errors(reference: StepResponse, other: StepResponse) -> dict[str, dict[str, float]]:
    """Per segment: RMS and largest velocity difference along its axis, and the difference in distance covered.

    Returns:
        segment -> {"rms_m_s", "max_m_s", "distance_m"}; the sign of distance_m is other minus reference.

    Raises:
        UsageError: recordings of different scripts.
    """
    if reference.segment != other.segment:
        raise UsageError("the two recordings were flown with different scripts: record both again")
    difference = other.velocity() - reference.velocity()
    out = {}
    for name, _, command in SCRIPT:
        rows = reference.rows(name)
        part = difference[rows]
        axis = {"r": 1, "l": 1, "c": 2}.get(name[0], 0) if command is not None else 0
        if name == "stop_sideways":
            axis = 1
        if name == "stop_climb":
            axis = 2
        along = part[:, axis]
        out[name] = {"rms_m_s": float(np.sqrt(np.mean(along**2))), "max_m_s": float(np.max(np.abs(along))),
                     "distance_m": float(along.sum() * SAMPLE_US * 1e-6)}
    return out


def main(argv: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m sitl.step_response", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("record", "compare"))
    parser.add_argument("--autopilot", default="arducopter")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--reference", default="arducopter", help="name in fixtures/step_response or a path")
    arguments = parser.parse_args(argv)
    try:
        response = record(arguments.autopilot)
        if arguments.out:
            response.save(arguments.out)
        if arguments.action == "compare":
            reference = StepResponse.load(fixture_path("step_response", arguments.reference, ".json"))
            print(f"{arguments.autopilot} {response.version} against {reference.autopilot} {reference.version}")
            for name, row in errors(reference, response).items():
                print(f"{name:15s} rms {row['rms_m_s']:.3f} m/s  max {row['max_m_s']:.3f} m/s  "
                      f"distance {row['distance_m']:+.3f} m")
    except BenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
