"""How many cores this process may use. joblib gives each of several processes a share, in NUMBA_NUM_THREADS."""

from numba import config


def usable_cores() -> int:
    return vars(config)["NUMBA_NUM_THREADS"]
