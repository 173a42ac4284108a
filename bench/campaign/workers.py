"""Who flies the tasks: processes of this machine, or a Dask cluster. Both yield what is done as it is done.

A worker that dies (killed, out of memory) costs the trial it had in hand, which is flown again up to RETRIES times;
then the trial ends as an infrastructure failure with that reason. The other workers fly on.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, Protocol

from bench.campaign.flying import Flown, Task, fly_task
from saranga.errors import BenchError, DeviceError, UsageError

RETRIES = 2
POLL_S = 0.5

Cancelled = Callable[[], bool]


@dataclass(frozen=True)
class Done:
    """A task that is over: flown, or `error` says why it never will be."""

    task: Task
    flown: Flown | None
    error: str | None = None


class Workers(Protocol):
    """Flies tasks; `count` of them at a time."""

    count: int

    def run(self, tasks: Sequence[Task], cancelled: Cancelled) -> Iterator[Done]:
        """Every task once, in the order they finish; ends early when cancelled (flights in the air are given up)."""
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

    def run(self, tasks: Sequence[Task], cancelled: Cancelled) -> Iterator[Done]:
        """See `Workers`."""
        waiting = list(reversed(tasks))
        tried: dict[tuple[str, int], int] = {}
        slots: list[ProcessPoolExecutor] = [_one_process() for _ in range(min(self.count, len(tasks)))]
        flying: dict[Future[Flown], tuple[int, Task]] = {}
        try:
            free = list(range(len(slots)))
            while waiting or flying:
                if cancelled():
                    return
                while waiting and free:
                    slot, task = free.pop(), waiting.pop()
                    tried[task.key] = tried.get(task.key, 0) + 1
                    flying[slots[slot].submit(self._fly, task)] = (slot, task)
                for future in wait(flying, timeout=POLL_S, return_when=FIRST_COMPLETED).done:
                    slot, task = flying.pop(future)
                    done, died = _outcome(future, task)
                    if died:
                        slots[slot].shutdown(wait=False, cancel_futures=True)
                        slots[slot] = _one_process()
                    free.append(slot)
                    if died and tried[task.key] <= RETRIES:
                        waiting.append(task)
                        continue
                    yield done
        finally:
            for executor in slots:
                for process in list((getattr(executor, "_processes", None) or {}).values()):
                    process.kill()
                executor.shutdown(wait=False, cancel_futures=True)


class DaskWorkers:
    """The slots of a Dask cluster: one simulator a slot.

    Workers that declare the resource SITL (`dask worker ... --resources SITL=4`) get that many at a time; of others
    each thread is a slot, so start them with one thread a process.

    Args:
        address: of a scheduler, or "local" for a cluster inside this process, on loopback only.
        jobs: workers of a local one.
    """

    def __init__(self, address: str, jobs: int) -> None:
        try:
            from distributed import Client, LocalCluster
        except ImportError as error:
            raise UsageError(f"--dask needs the package distributed ({error}): pip install 'saranga-bench[cluster]'"
                             ) from error
        self._cluster: Any = None
        try:
            if address == "local":
                self._cluster = LocalCluster(n_workers=jobs, threads_per_worker=1, processes=True, host="127.0.0.1",
                                             dashboard_address=None)
            self._client = Client(self._cluster or address, timeout="20s", set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise DeviceError(f"--dask {address}: no scheduler answers ({error}): start one with `dask scheduler`, or "
                              "use --dask local") from error
        self._client.wait_for_workers(1, timeout=60)
        workers = self._client.scheduler_info()["workers"].values()
        self._resources = {"SITL": 1.0} if any("SITL" in w.get("resources", {}) for w in workers) else None
        self.count = int(sum(w["resources"].get("SITL", 0) if self._resources else w["nthreads"] for w in workers))

    def run(self, tasks: Sequence[Task], cancelled: Cancelled) -> Iterator[Done]:
        """See `Workers`."""
        from distributed import as_completed

        futures = {self._client.submit(fly_task, task, pure=False, retries=0, resources=self._resources): task
                   for task in tasks}
        try:
            for future in as_completed(list(futures)):
                if cancelled():
                    return
                yield _outcome(future, futures[future])[0]
        finally:
            self._client.cancel(list(futures), force=True)
            self._client.close()
            if self._cluster is not None:
                self._cluster.close()


def _outcome(future: Any, task: Task) -> tuple[Done, bool]:
    """What became of a task, and whether its worker died of it."""
    try:
        return Done(task, future.result()), False
    except BrokenProcessPool as error:
        return Done(task, None, f"its worker died {RETRIES + 1} times ({error}); look for the kernel's out-of-memory "
                                "killer"), True
    except BenchError as error:
        return Done(task, None, str(error)), False
    except Exception as error:  # a trial that raises must not end the others
        return Done(task, None, f"unexpected {type(error).__name__}: {error}"), False


def _one_process() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_begin, initargs=(os.getpid(),))


def _begin(parent: int) -> None:
    """Die with the campaign, and leave Ctrl-C to it."""
    import signal

    from sitl.process import die_with_parent

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    die_with_parent()
    if os.getppid() != parent:  # it died before the kernel was told
        os._exit(1)
