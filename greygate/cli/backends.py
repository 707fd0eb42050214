"""Where joblib runs the tasks of a command: processes of this computer, or a dask cluster."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from typing import Annotated

import typer

from greygate.errors import InputError

REACHED = 10.0  # s to wait for the answer of a cluster's scheduler
Scheduler = Annotated[str | None, typer.Option(metavar="tcp://HOST:PORT", help="Address of the dask cluster.")]


class Backend(StrEnum):
    LOKY = "loky"
    DASK = "dask"


OnBackend = Annotated[Backend, typer.Option(help="Run on this computer, or on all workers of a cluster.")]


@contextmanager
def joblib_on(backend: Backend, scheduler: str | None) -> Iterator[None]:
    """Let joblib run its tasks on this backend. Raises InputError if the cluster cannot be reached."""
    import joblib

    if backend is Backend.LOKY:
        if scheduler is not None:
            raise InputError("--scheduler: loky has no scheduler; add --backend dask")
        yield
        return
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--backend dask: distributed is not installed; pip install 'greygate[cluster]'") from None
    if not re.fullmatch(r"(\w+://)?[^/]+:\d+", scheduler or ""):
        raise InputError(f"--scheduler {scheduler}: give the address of the cluster's scheduler, tcp://HOST:PORT")
    try:
        client = Client(scheduler, timeout=REACHED, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise InputError(f"--scheduler {scheduler}: no answer ({error}); start `dask scheduler` there") from None
    with client, joblib.parallel_config(backend="dask", client=client):
        yield
