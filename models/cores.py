"""How many cores this process may use, and what takes them."""

from functools import cache

from numba import config
from threadpoolctl import ThreadpoolController

from greygate import system


@cache
def blas() -> ThreadpoolController:
    """The BLAS libraries that are loaded; finding them takes milliseconds."""
    return ThreadpoolController()


def usable_cores() -> int:
    """Those that it is pinned to now, and no more than its share, NUMBA_NUM_THREADS, which joblib gives to each of
    several processes.
    """
    return min(vars(config)["NUMBA_NUM_THREADS"], system.cores())
