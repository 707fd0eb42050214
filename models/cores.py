"""How many cores this process may use, and what takes them."""

import os
from functools import cache

from numba import config
from threadpoolctl import ThreadpoolController


@cache
def blas() -> ThreadpoolController:
    """The BLAS libraries that are loaded; finding them takes milliseconds."""
    return ThreadpoolController()


def usable_cores() -> int:
    """Those that it is pinned to now, and no more than its share, NUMBA_NUM_THREADS, which joblib gives to each of
    several processes.
    """
    share = vars(config)["NUMBA_NUM_THREADS"]
    return min(share, len(os.sched_getaffinity(0))) if hasattr(os, "sched_getaffinity") else share
