"""Shards made by a Ray cluster: Ray Data gives each to one of its actors, scales them, and starts dead ones anew.

An actor makes a shard as one machine does, so a shard that was in work when an actor died is made again as a whole, and
one whose file is there is not: its file alone says that it is done.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from ..errors import InputError, cause
from ..kernels.launch import set_num_threads
from .people import PeopleFitter
from .rows import Column
from .run import make_dataset, source_readers
from .shards import Shards, Tally
from .sources import PictureSource

if TYPE_CHECKING:
    import numpy as np

LOCAL = "local"  # address of a cluster that is this machine and ends with the run
_PORT, _PATIENCE = 6379, 10.0  # Ray's own; [s]
_ATTEMPTS = 3  # Ray waits half a minute for its own start, which takes longer where all cores are busy
_PATIENT = {
    "RAY_agent_register_timeout_ms": "600000",
    "RAY_gcs_rpc_server_connect_timeout_s": "300",
    "RAY_gcs_server_request_timeout_seconds": "300",
    "RAY_worker_register_timeout_seconds": "600",
}


@dataclass(frozen=True)
class Workers:
    """Actors that make shards.

    Attributes:
        most: Greatest number of actors at a time. If it is None, there are as many as the cluster has room for, which
            may grow.
        cores: CPU cores of each actor.
        gpus: GPUs of each actor.
    """

    most: int | None
    cores: int
    gpus: int


@contextmanager
def connected_cluster(address: str) -> Iterator[dict[str, float]]:
    """A cluster, and what it has ("CPU", "GPU").

    Args:
        address: Address of the cluster: "local", "auto", "HOST:PORT", or "ray://HOST:PORT".

    Raises:
        InputError: If there is none.
    """
    for name, value in {"RAY_USAGE_STATS_ENABLED": "0", **(_PATIENT if address == LOCAL else {})}.items():
        os.environ.setdefault(name, value)  # without the first, Ray reports home
    import ray

    dashboard = False if address == LOCAL else None
    for left in reversed(range(_ATTEMPTS if address == LOCAL else 1)):
        try:
            if ":" in address:  # Ray would try for minutes, and end the process
                place = urlsplit(address if "//" in address else f"//{address}")
                socket.create_connection((place.hostname or "", place.port or _PORT), timeout=_PATIENCE).close()
            ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False, include_dashboard=dashboard)
            break
        except Exception as error:  # Ray's own are of many kinds, also of none
            ray.shutdown()
            if not left:
                raise InputError(f"--ray: {address}: {cause(error)}; expected local, or a cluster's address") from error
    try:
        yield ray.cluster_resources()
    finally:
        ray.shutdown()


def make_on_cluster(
    source: PictureSource,
    shards: Shards,
    build: Callable[[PictureSource], PeopleFitter],
    columns: Sequence[Column],
    *,
    todo: Sequence[int],
    workers: Workers,
    written: Callable[[int, Tally], None],
) -> Tally:
    """Make shards of a data set by the actors of a cluster that is connected.

    Args:
        source: Source of the pictures. All machines have its files at the same place.
        shards: Shards of ``source.names``, in a folder that all machines share.
        build: Function that makes the fitter, once in each actor.
        columns: Columns of the rows.
        todo: Indices of the shards to make.
        workers: Actors that make them.
        written: Function that is called after each shard, in the order in which they come, with its index and the
            numbers so far.

    Raises:
        InputError: If a shard can't be written.
    """
    import ray
    from ray.data import ActorPoolStrategy, DataContext

    logging.getLogger("ray.data").setLevel(logging.ERROR)  # set anew on import
    context = DataContext.get_current()
    context.enable_progress_bars = context.print_on_execution_start = False
    context.execution_no_progress_timeout_s = -1  # none: large shards take their time
    given = ray.put((source, shards, columns))
    most = min(workers.most or len(todo), len(todo))
    has = ray.cluster_resources()
    now = int(has.get("GPU", 0) / workers.gpus if workers.gpus else has.get("CPU", 0) / workers.cores)
    actors = ActorPoolStrategy(
        min_size=1, initial_size=min(max(now, 1), most), max_size=most, max_tasks_in_flight_per_actor=2
    )
    made = ray.data.from_items([{"shard": index} for index in todo], override_num_blocks=len(todo)).map_batches(
        _Maker,
        fn_constructor_args=(given, build, workers.cores),
        batch_size=1,
        num_cpus=workers.cores,
        num_gpus=workers.gpus,
        compute=actors,
    )
    total = Tally()
    for row in made.iter_rows():
        if row["fault"]:
            raise InputError(row["fault"])
        for name in ("shards", "pictures", "people", "errors", "unread", "rows", "failures", "annotations"):
            setattr(total, name, getattr(total, name) + row[name])
        total.first_error = total.first_error or row["first_error"]
        total.first_annotation = total.first_annotation or row["first_annotation"]
        written(row["shard"], total)
    return total


class _Maker:
    """An actor's work: shards, one after the other."""

    def __init__(self, given: Any, build: Callable[[PictureSource], PeopleFitter], cores: int) -> None:
        import ray

        set_num_threads(cores)
        self.source, self.shards, self.columns = ray.get(given)
        self.fitter = build(self.source)
        self.readers = source_readers(self.source, self.fitter, max(cores, 2))

    def __call__(self, batch: dict[str, np.ndarray]) -> dict[str, list[Any]]:
        """Make one shard, and give the numbers of what was written; of a fault, for all, its one line."""
        index, fault, tally = int(batch["shard"][0]), "", Tally()
        try:
            if not self.shards.left(index):  # an actor wrote it, and died before it said so
                tally = self.shards.count_rows(index)
            else:
                tally = make_dataset(
                    self.source,
                    self.shards,
                    self.fitter,
                    self.columns,
                    todo=[index],
                    threads=self.readers.threads,
                    processes=self.readers.processes,
                )
        except InputError as error:
            fault = str(error)
        return {name: [value] for name, value in {"shard": index, "fault": fault, **asdict(tally)}.items()}
