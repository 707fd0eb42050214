"""How many cores this process may use."""

from numba import config

from greygate import system


def usable_cores() -> int:
    """Those that it is pinned to now, and no more than its share, NUMBA_NUM_THREADS, which joblib gives to each of
    several processes.
    """
    return min(vars(config)["NUMBA_NUM_THREADS"], system.cores())
