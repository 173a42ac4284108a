"""Algorithm 2: the closest obstacle pushes back (eq. 15) and sideways (eqs 16-17), with hysteresis.

As in the errata: V_x is clamped, the lateral command is the element-wise product of gains and unit vector, and the
avoidance direction has a defined start value (away from the obstacle; an obstacle dead ahead gives the side with
more room, else left).

Beyond the paper (all off with `paper=True`), because the sonar forgets what it no longer sees:

- memory: an obstacle last seen up to `memory_s` ago stays where dead reckoning by the commanded velocity puts it,
  so that one missed detection does not end a dodge; a new detection of it is averaged in, which halves the azimuth
  noise within four ticks;
- commitment: the avoidance side changes only for an obstacle that is clearly on the other side at its range
  (`flip_rad`), because half-changed minds are what hits poles;
- alongside: while a remembered obstacle is abeam, nothing is commanded towards it;
- corridor: the nearest obstacle that is within `delta_max_m` of the path decides, not the nearest of all;
- level: an obstacle at our own height, as far as can be told at its range, is passed sideways and not by the noise of
  its elevation: most of what stands in the way is upright;
- soft: the lateral command falls off over the outer half of `delta_max_m`, so that a dodge does not overshoot into
  the next obstacle;
- brake: in front of an obstacle that blocks the way, no faster than it can stop at `brake_m_s2`: K_x alone hardly
  slows a vehicle at 2 m/s before it is too near to dodge;
- quick: above 1 m/s the lateral command grows with the root of the speed, as there is less time for the same dodge;
- ease: the forward speed rises by `ease_m_s2` at most, so that the echoes walk evenly enough to be summed;
- return: with nothing to dodge and more than `return_m` off the course axis (dead reckoned), it drifts back at up to
  `return_m_s`, so that dodges do not add up to a walk into the nets, which echo too little to be seen;
- guard: more than `max_lateral_m` off the course axis (dead reckoned), an obstacle that is nearly dead ahead is passed
  on the side of the axis, and one already to the side is passed without moving further out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from math import copysign, exp, hypot, isfinite, sqrt

from saranga.localise import Obstacle
from saranga.navigate.base import VelocityCommand
from saranga.plugins import call_with_options

NAME = "saranga"

_TIE_M = 0.01
"""An obstacle less than this off the path is dead ahead: its side is noise, so the room decides."""
_ONCE_US = 130_000
"""What was seen once only, a mismatched pair of echoes as like as not, is forgotten after two ticks."""
_HOMING_M = 0.3
"""The guard lets go this far inside its limit, so that it does not chatter on it."""


@dataclass(frozen=True)
class PotentialParameters:
    """Gains and limits; the names in brackets are the paper's.

    Attributes:
        desired_speed_m_s: [V_d] forward speed with nothing ahead.
        k_x: [K_x] m3/s, braking: V_x = V_d - K_x x / r^3.
        k_y_m_s: [K_y] lateral speed of a dodge.
        k_z_m_s: [K_z] vertical speed of a dodge (0 keeps the height).
        delta_m: [delta] hysteresis: nearer than this to the path the avoidance side is kept.
        delta_max_m: [delta_max] obstacles further than this from the path are not dodged.
        vx_min_m_s: lowest V_x; eq. 15 has no bound as r goes to 0.
        paper: the pure algorithm, without the extensions below.
        memory_s: how long an obstacle is remembered after it was last seen.
        response_s: lag of the vehicle's velocity behind the command, for dead reckoning.
        behind_m: an obstacle this far behind the sensors is past.
        same_m: a new detection this close to a remembered obstacle is that obstacle.
        blend: weight of a new detection once an obstacle has been seen a few times.
        flip_rad: azimuth error that the hysteresis must withstand: delta grows to flip_rad times the range.
        pass_m: off-path distance at which an obstacle can be passed without a dodge (airframe and a margin).
        abeam_m: lateral distance at which an obstacle alongside still blocks moving towards it.
        brake_m_s2: deceleration that is counted on in front of what blocks the way.
        stop_m: distance from the sensors at which it would stop.
        ease_m_s2: how fast the forward speed may rise.
        return_m: distance off the course axis beyond which it drifts back while there is nothing to dodge.
        return_m_s: highest speed of drifting back.
        return_per_s: speed of drifting back for each metre beyond `return_m`.
        max_lateral_m: distance off the course axis beyond which only the way back is chosen.
    """

    desired_speed_m_s: float = 1.0
    k_x: float = 0.10
    k_y_m_s: float = 0.8
    k_z_m_s: float = 0.8
    delta_m: float = 0.1
    delta_max_m: float = 0.45
    vx_min_m_s: float = -0.3
    paper: bool = False
    memory_s: float = 0.6
    response_s: float = 0.25
    behind_m: float = 0.3
    same_m: float = 0.25
    blend: float = 0.35
    flip_rad: float = 0.25
    pass_m: float = 0.28
    abeam_m: float = 0.45
    brake_m_s2: float = 1.5
    stop_m: float = 0.35
    ease_m_s2: float = 0.7
    return_m: float = 0.8
    return_m_s: float = 0.2
    return_per_s: float = 0.4
    max_lateral_m: float = 1.5

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, bool) and not isfinite(value):
                raise ValueError(f"{field.name} is {value}; give a finite number")
            if field.name != "vx_min_m_s" and value < 0:
                raise ValueError(f"{field.name} is {value}; give a number that is not negative")
        if self.vx_min_m_s > self.desired_speed_m_s:
            raise ValueError(f"vx_min_m_s is {self.vx_min_m_s}, above desired_speed_m_s {self.desired_speed_m_s}")


@dataclass
class _Point:
    """An obstacle in body axes, with the time it was last seen."""

    x: float
    y: float
    z: float
    seen_us: int
    times_seen: int = 1

    @property
    def range_m(self) -> float:
        return hypot(self.x, self.y, self.z)

    @property
    def off_path_m(self) -> float:
        return hypot(self.y, self.z)


class Potential:
    """Algorithm 2 with errata and, unless `paper`, the extensions named in the module's docstring."""

    name = NAME

    def __init__(self, parameters: PotentialParameters) -> None:
        self.parameters = parameters
        self.reset()

    def reset(self) -> None:
        """Forget obstacles, the avoidance side and the dead-reckoned position."""
        self._points: list[_Point] = []
        self._side: tuple[float, float] | None = None
        self._lateral_m = 0.0
        self._homing = False
        self._velocity = (0.0, 0.0, 0.0)
        self._command = VelocityCommand(0.0, 0.0, 0.0)
        self._t_us: int | None = None

    def decide(self, obstacles: Sequence[Obstacle], t_us: int) -> VelocityCommand:
        """Velocity for the obstacles seen at `t_us`."""
        p = self.parameters
        since_s = 0.0 if self._t_us is None else max(0.0, (t_us - self._t_us) * 1e-6)
        seen = [_Point(o.x_m, o.y_m, o.z_m, t_us) for o in obstacles]
        if p.paper:
            self._points = seen
        else:
            self._dead_reckon(t_us)
            self._remember(seen, t_us)
        threat = self._threat()
        if threat is None:
            if not p.paper:
                self._side = None
            command = VelocityCommand(p.desired_speed_m_s, 0.0, 0.0)
        else:
            command = self._dodge(threat)
        if not p.paper:
            if threat is None or threat.off_path_m >= p.delta_max_m:
                command = self._return(command)
            command = self._keep_clear_alongside(command)
            most = max(self._command.vx_m_s, 0.0) + p.ease_m_s2 * since_s
            command = replace(command, vx_m_s=min(command.vx_m_s, most))
        self._command = command
        return command

    def _threat(self) -> _Point | None:
        if not self._points:
            return None
        if self.parameters.paper:
            return min(self._points, key=lambda o: o.range_m)
        ahead = [o for o in self._points if o.x > 0.0]
        blocking = [o for o in ahead if o.off_path_m < self.parameters.delta_max_m]
        return min(blocking or ahead, key=lambda o: o.range_m, default=None)

    def _dodge(self, threat: _Point) -> VelocityCommand:
        p = self.parameters
        r = max(threat.range_m, 1e-3)
        vx = p.desired_speed_m_s - p.k_x * threat.x / r**3
        vx = min(p.desired_speed_m_s, max(p.vx_min_m_s, vx))
        off = threat.off_path_m
        if not p.paper and off < p.pass_m:
            vx = min(vx, max(p.vx_min_m_s, sqrt(2.0 * p.brake_m_s2 * max(threat.x - p.stop_m, 0.0))))
        delta_m = p.delta_m if p.paper else max(p.delta_m, p.flip_rad * r)
        if off > delta_m or self._side is None:
            self._side = self._away(threat, 0.0 if p.paper else delta_m)
        if off >= p.delta_max_m:
            return VelocityCommand(vx, 0.0, 0.0)
        lateral, vertical = self._side
        strength = 1.0 if p.paper else min(1.0, 2.0 * (1.0 - off / p.delta_max_m))
        if not p.paper and self._is_homing() and lateral * self._lateral_m > 0.0:
            if off <= delta_m:
                lateral = -lateral
                self._side = (lateral, vertical)
            elif off > p.pass_m:
                lateral = 0.0
        if not p.paper:
            strength *= sqrt(max(1.0, p.desired_speed_m_s))
        return VelocityCommand(vx, p.k_y_m_s * lateral * strength, p.k_z_m_s * vertical * strength)

    def _return(self, command: VelocityCommand) -> VelocityCommand:
        """Back towards the course axis, for a command that is straight on."""
        p = self.parameters
        beyond_m = abs(self._lateral_m) - p.return_m
        if beyond_m <= 0.0:
            return command
        return replace(command, vy_m_s=-copysign(min(p.return_m_s, p.return_per_s * beyond_m), self._lateral_m))

    def _is_homing(self) -> bool:
        limit = self.parameters.max_lateral_m
        self._homing = abs(self._lateral_m) > (limit - _HOMING_M if self._homing else limit)
        return self._homing

    def _away(self, threat: _Point, level_m: float) -> tuple[float, float]:
        """Unit vector from the obstacle to the path; within `level_m` of its height, sideways only."""
        z = threat.z if abs(threat.z) > level_m else 0.0
        off = hypot(threat.y, z)
        if off > _TIE_M:
            return (-threat.y / off, -z / off)
        others = [o for o in self._points if o is not threat]
        room_left = min((-o.y for o in others if o.y < 0.0), default=float("inf"))
        room_right = min((o.y for o in others if o.y >= 0.0), default=float("inf"))
        return (1.0, 0.0) if room_right > room_left else (-1.0, 0.0)

    def _dead_reckon(self, t_us: int) -> None:
        p = self.parameters
        dt = 0.0 if self._t_us is None else max(0.0, (t_us - self._t_us) * 1e-6)
        self._t_us = t_us
        keep = exp(-dt / p.response_s) if p.response_s > 0.0 else 0.0
        asked = (self._command.vx_m_s, self._command.vy_m_s, self._command.vz_m_s)
        blend = p.response_s * (1.0 - keep)
        moved = [c * dt + (v - c) * blend for v, c in zip(self._velocity, asked, strict=True)]
        vx, vy, vz = (c + (v - c) * keep for v, c in zip(self._velocity, asked, strict=True))
        self._velocity = (vx, vy, vz)
        self._lateral_m += moved[1]
        for point in self._points:
            point.x -= moved[0]
            point.y -= moved[1]
            point.z -= moved[2]

    def _remember(self, seen: list[_Point], t_us: int) -> None:
        p = self.parameters
        horizon_us = round(p.memory_s * 1e6)
        kept = [o for o in self._points if o.x > -p.behind_m
                and t_us - o.seen_us <= (horizon_us if o.times_seen > 1 else _ONCE_US)]
        for point in seen:
            same = [o for o in kept if hypot(o.x - point.x, o.y - point.y, o.z - point.z) <= p.same_m]
            if same:
                known = min(same, key=lambda o: hypot(o.x - point.x, o.y - point.y, o.z - point.z))
                point.times_seen = known.times_seen + 1
                old = 1.0 - max(p.blend, 1.0 / point.times_seen)
                point.y += old * (known.y - point.y)
                point.z += old * (known.z - point.z)
                kept = [o for o in kept if o not in same]
        self._points = seen + kept

    def _keep_clear_alongside(self, command: VelocityCommand) -> VelocityCommand:
        vy = command.vy_m_s
        for o in self._points:
            beside = abs(o.x) < self.parameters.behind_m and abs(o.y) < self.parameters.abeam_m
            if beside and vy * o.y > 0.0:
                vy = 0.0
        return VelocityCommand(command.vx_m_s, vy, command.vz_m_s)


def build(**parameters: float | bool) -> Potential:
    """Algorithm 2 with `PotentialParameters` given by name.

    Raises:
        UsageError: an unknown parameter, one that is not finite or out of its bounds.
    """
    return Potential(call_with_options("stack", NAME, PotentialParameters, parameters))
