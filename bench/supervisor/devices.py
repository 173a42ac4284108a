"""Opening what the supervisor holds: the stand, the throttle, and the tee where a rig hangs on the same port."""

from dataclasses import asdict, dataclass
from typing import Any

from bench.supervisor.plan import SupervisorPlan
from bench.supervisor.tee import Sink, Tee, TeedLink
from bench.thrust_stand.protocol import Origin, StandInfo, ThrottleOutput, ThrustStand
from saranga.errors import UsageError


@dataclass
class Devices:
    """What is open. `link` is the device's own byte link where a tee shares it."""

    throttle: ThrottleOutput
    origin: Origin
    stand: ThrustStand | None = None
    info: StandInfo | None = None
    tee: Tee | None = None
    link: Sink | None = None

    @property
    def rig_url(self) -> str | None:
        """The tee's, if there is one."""
        return self.tee.url if self.tee is not None else None

    def describe(self) -> dict[str, Any]:
        """JSON-ready."""
        info = None if self.info is None else {**asdict(self.info), "quantities": sorted(self.info.quantities)}
        return {"stand": info, "throttle": {"url": self.throttle.url, "readback": self.throttle.readback}}

    def close(self) -> None:
        """Throttle first: it idles."""
        self.throttle.close()
        if self.stand is not None:
            self.stand.close()
        if self.tee is not None:
            self.tee.close()


def open_devices(plan: SupervisorPlan) -> Devices:
    """Open the stand, see that it measures what has a limit, then the throttle.

    Raises:
        UsageError: a limit that nothing measures, a device without a dead-man, a recording in place of a stand.
        DeviceError: a device is missing, busy or wrong.
    """
    from bench.thrust_stand.registry import open_stand, open_throttle

    watched = plan.limits.watched()
    if plan.stand_url is None:
        _all_measured(watched, frozenset(), "no stand")
        throttle = open_throttle(plan.throttle_url)
        throttle.open()
        return Devices(throttle, "measured")
    stand = open_stand(plan.stand_url)
    shared = plan.stand_url == plan.throttle_url
    tee = Tee() if shared and hasattr(stand, "link") else None
    try:
        teed = None
        if tee is not None:
            teed = stand.link = TeedLink(stand.link, tee)  # type: ignore[attr-defined]
        info = stand.open()
        _check(plan, info, watched, shared)
        throttle = stand if shared else open_throttle(plan.throttle_url)  # type: ignore[assignment]
        if not shared:
            throttle.open()
    except BaseException:
        stand.close()
        if tee is not None:
            tee.close()
        raise
    return Devices(throttle, info.origin if shared else "measured", stand, info, tee, teed)


def _check(plan: SupervisorPlan, info: StandInfo, watched: dict[str, str], shared: bool) -> None:
    if info.origin == "recorded":
        raise UsageError(f"{plan.stand_url}: a recording cannot watch over a motor: give a live stand")
    _all_measured(watched, info.quantities, info.name)
    if shared and not info.has_throttle:
        raise UsageError(f"{plan.throttle_url}: {info.name} has no throttle output: give another --throttle")
    if shared and info.dead_man_s is None and not plan.accept_no_dead_man:
        raise UsageError(f"{plan.throttle_url}: {info.name} has no dead-man: it would spin on if this computer died; "
                         "use a throttle that has one, or say accept_no_dead_man in the plan")


def _all_measured(watched: dict[str, str], measured: frozenset[str], who: str) -> None:
    blind = {limit: quantity for limit, quantity in watched.items() if quantity not in measured}
    if blind:
        raise UsageError(f"limit {', '.join(blind)}: {who} does not measure {', '.join(blind.values())}: take it "
                         "out of the plan, knowing that nobody watches it, or use a stand that does")
