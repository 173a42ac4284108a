"""Who flies the tasks: processes of this machine, or a Dask cluster. Both yield what is done as it is done.

A worker that dies (killed, out of memory), or whose autopilot's process does, costs the trial it had in hand, which is
flown again up to RETRIES times; then the trial ends as an infrastructure failure with that reason. The other workers
fly on. What was flown again is told (`Done.lost`), so that nobody takes a second try for a first.
"""

import gc
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing import get_context, resource_tracker
from typing import Any, Protocol

from bench.campaign.flying import Flown, Task, fly_task, forget_scratch
from bench.spare import stack_threads
from saranga.errors import BenchError, DeviceError, UsageError

RETRIES = 2
POLL_S = 0.5

Cancelled = Callable[[], bool]


@dataclass(frozen=True)
class Done:
    """A task that is over: flown, or `error` says why it never will be. `lost`: why earlier tries of it were lost."""

    task: Task
    flown: Flown | None
    error: str | None = None
    lost: tuple[str, ...] = ()


class Workers(Protocol):
    """Flies tasks; `count` of them at a time."""

    count: int

    def run(self, tasks: Sequence[Task], cancelled: Cancelled) -> Iterator[Done]:
        """Every task once, in the order they finish; ends early when cancelled. May be called again."""
        ...

    def close(self) -> None:
        """End them all: flights in the air are given up."""
        ...


class LocalWorkers:
    """`jobs` processes of this machine, each with its own simulator. They and their autopilots die with this process.

    Args:
        jobs: how many at a time.
        fly: what a worker calls; another one only in tests.
    """

    def __init__(self, jobs: int, fly: Callable[[Task], Flown] = fly_task) -> None:
        if jobs < 1:
            raise UsageError(f"--jobs {jobs}: at least 1")
        self.count = jobs
        self._fly = fly
        self._slots: list[ProcessPoolExecutor] = []
        self._tracked = _tracker_pid()

    def run(self, tasks: Sequence[Task], cancelled: Cancelled) -> Iterator[Done]:
        """See `Workers`."""
        threads = stack_threads(self.count)
        waiting = [replace(task, request=replace(task.request, stack_threads=threads)) for task in reversed(tasks)]
        lost: dict[tuple[str, int], tuple[str, ...]] = {}
        slots = self._slots
        slots += [_one_process() for _ in range(min(self.count, len(tasks)) - len(slots))]
        flying: dict[Future[Flown], tuple[int, Task]] = {}
        free = list(range(len(slots)))
        while waiting or flying:
            if cancelled():
                return
            while waiting and free:
                slot, task = free.pop(), waiting.pop()
                flying[slots[slot].submit(self._fly, task)] = (slot, task)
            for future in wait(flying, timeout=POLL_S, return_when=FIRST_COMPLETED).done:
                slot, task = flying.pop(future)
                done, why = _outcome(future, task)
                if isinstance(future.exception(), BrokenProcessPool):
                    _end(slots[slot])
                    slots[slot] = _one_process()
                free.append(slot)
                before = lost.get(task.key, ())
                if why is not None and len(before) < RETRIES:
                    lost[task.key] = (*before, why)
                    waiting.append(task)
                    continue
                yield replace(done, lost=before)

    def close(self) -> None:
        """See `Workers`; no process that was started here is left."""
        while self._slots:
            _end(self._slots.pop())
        _stop_tracker(self._tracked)


class DaskWorkers:
    """The slots of a Dask cluster: one simulator a slot.

    Workers that declare the resource SITL (`dask worker ... --resources SITL=4`) get that many at a time; of others
    each thread is a slot, so start them with one thread a process.

    Args:
        address: of a scheduler, or "local" for a cluster inside this process, on loopback only.
        jobs: workers of a local one.
        patience_s: how long to wait for the scheduler.

    Raises:
        UsageError: the package distributed is absent. DeviceError: no scheduler, or no worker.
    """

    def __init__(self, address: str, jobs: int, patience_s: float = 20.0) -> None:
        try:
            from distributed import Client, LocalCluster
        except ImportError as error:
            raise UsageError(f"--dask needs the package distributed ({error}): pip install 'saranga-bench[cluster]'"
                             ) from error
        self._cluster: Any = None
        self._tracked = _tracker_pid()
        try:
            if address != "local":
                _reach(address, patience_s)
            else:
                self._cluster = LocalCluster(n_workers=jobs, threads_per_worker=1, processes=True, host="127.0.0.1",
                                             dashboard_address=None)
            self._client = Client(self._cluster or address, timeout=patience_s, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise DeviceError(f"--dask {address}: no scheduler answers ({error}): start one with `dask scheduler`, or "
                              "use --dask local") from error
        try:
            self._client.wait_for_workers(1, timeout=60)
        except TimeoutError as error:
            self.close()
            raise DeviceError(f"--dask {address}: the scheduler has had no worker for a minute: start some with "
                              f"`dask worker {address} --nthreads 1 --resources SITL=1`") from error
        workers = self._client.scheduler_info()["workers"].values()
        self._resources = {"SITL": 1.0} if any("SITL" in w.get("resources", {}) for w in workers) else None
        self.count = int(sum(w["resources"].get("SITL", 0) if self._resources else w["nthreads"] for w in workers))

    def run(self, tasks: Sequence[Task], cancelled: Cancelled) -> Iterator[Done]:
        """See `Workers`. Dask itself hands the task of a dead worker to another one, some times."""
        import distributed

        def submit(task: Task) -> Any:
            return self._client.submit(fly_task, task, pure=False, retries=0, resources=self._resources)

        flying = {submit(task): task for task in tasks}
        lost: dict[tuple[str, int], tuple[str, ...]] = {}
        try:
            while flying:
                if cancelled():
                    return
                try:
                    with self._client.as_current():
                        ready = distributed.wait(list(flying), timeout=POLL_S, return_when="FIRST_COMPLETED").done
                except TimeoutError:
                    continue
                for future in ready:
                    task = flying.pop(future)
                    done, why = _outcome(future, task)
                    before = lost.get(task.key, ())
                    if why is not None and len(before) < RETRIES:
                        lost[task.key] = (*before, why)
                        flying[submit(task)] = task
                        continue
                    yield replace(done, lost=before)
        finally:
            self._client.cancel(list(flying), force=True)

    def close(self) -> None:
        """See `Workers`: leave the cluster, end it if it is our own; others end the flights that are in the air."""
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()
        _stop_tracker(self._tracked)


def _reach(address: str, patience_s: float) -> None:
    """Whether somebody listens there: dask itself tells it late and with a traceback at exit."""
    import socket

    from distributed.comm import get_address_host_port

    if address.partition("://")[0] in ("tcp", "tls") or "://" not in address:
        with socket.create_connection(get_address_host_port(address), timeout=patience_s):
            pass


def _outcome(future: Any, task: Task) -> tuple[Done, str | None]:
    """What became of a task, and why it is worth another try (None where it is not)."""
    try:
        flown = future.result()
    except BrokenProcessPool as error:
        why = f"its worker died ({error}); look for the kernel's out-of-memory killer"
        return Done(task, None, f"{RETRIES + 1} times over: {why}"), why
    except DeviceError as error:
        return Done(task, None, str(error)), str(error) if "process ended" in str(error) else None
    except BenchError as error:
        return Done(task, None, str(error)), None
    except Exception as error:  # a trial that raises must not end the others
        return Done(task, None, f"unexpected {type(error).__name__}: {error}"), None
    return Done(task, flown), _lost_autopilot(task, flown)


def _lost_autopilot(task: Task, flown: Flown) -> str | None:
    """The cause, where the autopilot's own process broke a flight off; what the stack breaks stays broken."""
    result = flown.result
    kind = task.request.autopilot
    cause = str(result.get("cause"))
    planted = task.request.faults is not None and task.request.faults.any()
    return cause if result["outcome"] == "infrastructure" and kind in cause and not planted else None


def _one_process() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_begin, initargs=(os.getpid(),))


def _end(executor: ProcessPoolExecutor) -> None:
    """Kill the process of an executor, and what it left in the folder for temporary files."""
    processes = list((getattr(executor, "_processes", None) or {}).values())
    for process in processes:
        process.kill()
    executor.shutdown(wait=True, cancel_futures=True)
    for process in processes:
        process.join(timeout=5.0)
        forget_scratch(process.pid)


def _tracker_pid() -> int | None:
    return getattr(getattr(resource_tracker, "_resource_tracker", None), "_pid", None)


def _stop_tracker(before: int | None) -> None:
    """End multiprocessing's helper process if it was started here: by itself it lives as long as this process.

    Only once no child is left: it waits for everybody who holds its pipe.
    """
    from multiprocessing import active_children

    gc.collect()  # queues give their semaphores back when they are collected, which would start the helper anew
    stop = getattr(getattr(resource_tracker, "_resource_tracker", None), "_stop", None)
    if before is None and _tracker_pid() is not None and stop is not None and not active_children():
        stop()


def _begin(parent: int) -> None:
    """Die with the campaign, and leave Ctrl-C to it."""
    import signal

    from sitl.process import die_with_parent

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    die_with_parent()
    if os.getppid() != parent:  # it died before the kernel was told
        os._exit(1)
