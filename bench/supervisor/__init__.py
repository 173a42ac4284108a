"""The safety supervisor: a process of its own that owns the throttle (`docs/safety.md`)."""

from bench.supervisor.client import Supervisor
from bench.supervisor.guard import Trip
from bench.supervisor.limits import Limits
from bench.supervisor.plan import Confirmation, StopReport, SupervisorPlan, SupervisorStatus

__all__ = ["Confirmation", "Limits", "StopReport", "Supervisor", "SupervisorPlan", "SupervisorStatus", "Trip"]
