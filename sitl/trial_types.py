"""What goes into a trial and what comes out of it: plain data, no simulator imported.

`bench` reads these without pulling numba or an autopilot in; `sitl.trial.run_trial` fills them.
"""

import dataclasses
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from saranga.errors import UsageError
from sitl.faults import Planting, fault_modules, parse_planting

if TYPE_CHECKING:
    from saranga.localise import Obstacle

LOG_FORMAT = 1
OUTCOMES = (
    "clean",
    "net_hit",
    "obstacle_hit",
    "timeout",
    "stuck",
    "estimator_failure",
    "infrastructure",
    "interrupted",
)


@dataclass(frozen=True)
class Faults:
    """Things to break on purpose during a flight; None or 0 is "leave it alone". Times are simulated
    seconds after the course began (take-off complete), so that they mean the same on every autopilot.

    `dead_sensor` is a sonar role (left, right, down) that stops answering at `dead_sensor_at_s` (0 = from the
    start); the probabilities are per wire message. `planted` are faults of `sitl/faults`, one file each.
    """

    kill_autopilot_at_s: float | None = None
    physics_socket_lost_at_s: float | None = None
    echo_silent_at_s: float | None = None
    dead_sensor: str | None = None
    dead_sensor_at_s: float = 0.0
    corrupt_probability: float = 0.0
    drop_probability: float = 0.0
    setpoint_delay_ms: float = 0.0
    nan_policy_at_s: float | None = None
    planted: tuple[Planting, ...] = ()

    def any(self) -> bool:
        """True when at least one fault is asked for."""
        return self != Faults()

    def to_dict(self) -> dict[str, Any]:
        """Only the faults that are set, for logs and JSON; `Faults.parse` reads its items again."""
        own = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)
               if f.name != "planted" and getattr(self, f.name) != f.default}
        return own | {planting.name: planting.text for planting in self.planted}

    @staticmethod
    def parse(texts: Iterable[str]) -> "Faults":
        """Build from command-line texts such as "echo_silent_at_s=12", "dead_sensor=right" or "flow_lost=1@3".

        Raises:
            UsageError: unknown name, missing value, or a value outside its range.
        """
        import difflib

        own = {f.name for f in dataclasses.fields(Faults)} - {"planted"}
        files = fault_modules()
        known = [*own, *files]
        values: dict[str, Any] = {}
        planted: dict[str, Planting] = {}
        for text in texts:
            name, equals, value = text.partition("=")
            name, value = name.strip(), value.strip()
            if name not in known:
                near = difflib.get_close_matches(name, known, n=1)
                hint = f" (did you mean {near[0]!r}?)" if near else ""
                raise UsageError(
                    f"unknown fault {name!r}{hint}: known are {', '.join(sorted(known))}; "
                    "write it as NAME=VALUE, such as echo_silent_at_s=12 or flow_lost=1@3"
                )
            if not equals or not value:
                raise UsageError(f"fault {name!r} has no value: write {name}=VALUE")
            if name in values or name in planted:
                raise UsageError(f"fault {name!r} is given twice: give it once")
            if name in own:
                values[name] = _fault_value(name, value)
            else:
                planted[name] = parse_planting(name, value)
        if "dead_sensor_at_s" in values and "dead_sensor" not in values:
            raise UsageError("fault dead_sensor_at_s needs dead_sensor=left, right or down beside it")
        return Faults(**values, planted=tuple(planted.values()))


def _fault_value(name: str, text: str) -> str | float:
    if name == "dead_sensor":
        if text not in ("left", "right", "down"):
            raise UsageError(f"fault dead_sensor={text!r}: must be left, right or down")
        return text
    try:
        value = float(text)
    except ValueError:
        raise UsageError(f"fault {name}={text!r}: must be a number") from None
    if not math.isfinite(value) or value < 0:
        raise UsageError(f"fault {name}={text}: must be finite and not negative")
    if name.endswith("_probability") and value > 1:
        raise UsageError(f"fault {name}={text}: a probability is at most 1")
    return value


@dataclass(frozen=True)
class TrialRequest:
    """One flight: `scene` is a name in fixtures/scenes or a path; all randomness follows from `seed`.

    `stack_threads` only makes it quicker: with two the images of two sensors are denoised at the same time.
    """

    scene: str
    seed: int = 1
    autopilot: str = "embedded"
    stack: str = "saranga"
    denoiser: str = "saranga"
    shield: str = "foam"
    sonar: str = "pair"
    faults: Faults | None = None
    workdir: Path | None = None
    max_sim_s: float = 180.0
    keep_log: bool = True
    stack_threads: int = 1

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready; `workdir`, `keep_log` and `stack_threads` are left out as they do not change the flight."""
        return {
            "scene": self.scene,
            "seed": self.seed,
            "autopilot": self.autopilot,
            "stack": self.stack,
            "denoiser": self.denoiser,
            "shield": self.shield,
            "sonar": self.sonar,
            "faults": self.faults.to_dict() if self.faults else {},
            "max_sim_s": self.max_sim_s,
        }


@dataclass(frozen=True)
class TrialProgress:
    """Where a running trial is; `phase` is start, ready, takeoff, course, land or done."""

    t_s: float
    phase: str
    x_m: float
    goal_x_m: float
    realtime_factor: float


@dataclass
class FlightLog:
    """A flight at the stack's tick (62.5 ms, K ticks): what is drawn, replayed and measured afterwards.

    Shapes: t_us (K,) int64 simulated microseconds; pos_m, vel_m_s (K, 3) world NED; quat (K, 4) w,x,y,z body
    to world; thrust_n (K, 4); command (K, 4) body-FRD vx, vy, vz m/s and yaw rate rad/s; envelope_*, edges_*
    (K, N) uint8 newest row of each tick (envelopes dB-scaled, edges 255 = 1.0), N = 0 when not kept.
    """

    t_us: NDArray[np.int64]
    pos_m: NDArray[np.float64]
    vel_m_s: NDArray[np.float64]
    quat: NDArray[np.float64]
    thrust_n: NDArray[np.float64]
    phase: list[str]
    command: NDArray[np.float64]
    envelope_left: NDArray[np.uint8]
    envelope_right: NDArray[np.uint8]
    edges_left: NDArray[np.uint8]
    edges_right: NDArray[np.uint8]
    obstacles: "list[list[Obstacle]]"
    airframe: dict[str, Any] = field(default_factory=dict)
    scene: dict[str, Any] = field(default_factory=dict)
    events: list[tuple[int, str]] = field(default_factory=list)

    _ARRAYS = (
        "t_us",
        "pos_m",
        "vel_m_s",
        "quat",
        "thrust_n",
        "command",
        "envelope_left",
        "envelope_right",
        "edges_left",
        "edges_right",
    )
    _OBSTACLE = ("range_m", "azimuth_rad", "elevation_rad", "x_m", "y_m", "z_m", "score")

    def save(self, path: Path) -> Path:
        """Write as .npz (arrays, and one JSON text for the rest); whole or not at all. Returns the path."""
        rows = [
            [tick, *(float(getattr(o, name)) for name in self._OBSTACLE)]
            for tick, seen in enumerate(self.obstacles)
            for o in seen
        ]
        meta = {
            "format": LOG_FORMAT,
            "phase": self.phase,
            "airframe": self.airframe,
            "scene": self.scene,
            "events": [[int(t), text] for t, text in self.events],
            "ticks": len(self.obstacles),
        }
        arrays: dict[str, Any] = {name: getattr(self, name) for name in self._ARRAYS}
        arrays["obstacles"] = np.array(rows, dtype=np.float64).reshape(-1, 1 + len(self._OBSTACLE))
        arrays["meta"] = np.array(json.dumps(meta, default=_plain))
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(path.name + ".part")
        with part.open("wb") as file:
            np.savez_compressed(file, **arrays)
        return part.replace(path)

    @staticmethod
    def load(path: Path) -> "FlightLog":
        """Read what `save` wrote.

        Raises:
            UsageError: missing, cut off, or written by another format version.
        """
        import zipfile

        from saranga.localise import Obstacle

        try:
            with np.load(path, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in FlightLog._ARRAYS}
                rows, meta = stored["obstacles"], json.loads(str(stored["meta"]))
        except FileNotFoundError:
            raise UsageError(f"flight log {path} does not exist") from None
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise UsageError(f"{path} is not a readable flight log ({error}); was the run cut short?") from error
        if meta.get("format") != LOG_FORMAT:
            raise UsageError(f"{path}: flight log format {meta.get('format')}; this version reads {LOG_FORMAT}")
        obstacles: list[list[Obstacle]] = [[] for _ in range(meta["ticks"])]
        for row in rows:
            obstacles[int(row[0])].append(Obstacle(**dict(zip(FlightLog._OBSTACLE, map(float, row[1:]), strict=True))))
        return FlightLog(
            **arrays,
            phase=meta["phase"],
            obstacles=obstacles,
            airframe=meta["airframe"],
            scene=meta["scene"],
            events=[(int(t), text) for t, text in meta["events"]],
        )


def _plain(value: Any) -> Any:
    """numpy scalars, arrays and paths as JSON can hold them."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    raise TypeError(f"{type(value).__name__} cannot be written to JSON")


@dataclass
class TrialResult:
    """What happened in one flight; `cause` names in one line why it ended as it did.

    `shield_noise`: where the noise behind the shield comes from (`AcousticModel.noise_provenance`).
    `label` (`sitl.causes`) says what to mend; `path_excess` is the path flown over the way made along the course.
    `measures`: figures that change before outcomes do (`sitl.measures`).
    """

    scene: str
    seed: int
    outcome: str
    cause: str
    part: str | None
    success_strict: bool
    success_lenient: bool
    min_clearance_m: float
    duration_s: float
    sim_s: float
    wall_s: float
    realtime_factor: float
    determinism_hash: str
    landed: bool
    autopilot: dict[str, str]
    denoiser: str
    stack: str
    shield: str
    link_counters: dict[str, Any] = field(default_factory=dict)
    timing: dict[str, float] = field(default_factory=dict)
    weights_sha256: str | None = None
    runtime: str | None = None
    label: str | None = None
    label_reason: str = ""
    path_length_m: float = math.nan
    path_excess: float = math.nan
    shield_noise: dict[str, Any] = field(default_factory=dict)
    measures: dict[str, float] = field(default_factory=dict)
    log: FlightLog | None = None
    files: dict[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready, without the log; values that are not finite become None."""
        out = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "log"}
        return json.loads(json.dumps(_finite(out), default=_plain))


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
