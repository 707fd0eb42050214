"""The compiled loop of a plant that an FMU computes, in the process that has loaded it: steps of Dormand-Prince 5 with
what effects add to the FMU's rates, and its events; or, of an FMU for co-simulation, the FMU's own steps.

`at` is (whole numbers, references, numbers, flags): few arrays, so that numba compiles calls fast. The whole numbers
are the instance, the address of what effects add, how many there are (`COUNTS`), and the place of each of the FMU's
inputs; references are those of inputs and outputs; the rows of the numbers are `ROWS`; the last array says which terms
are on.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from greygate.plants import calling
from greygate.plants.simulator import BOUNDED, RESTARTED

Numbers = Sequence[float] | np.ndarray
FLAGS = 8  # numbers that FMI answers with
COUNTS = ("EFFECTS", "INPUTS", "OUTPUTS", "STATES", "SIGNS")  # signs: event indicators
ROWS = (
    *("IN", "SCALE_IN", "LEVEL_IN", "OUT", "SCALE_OUT", "LEVEL_OUT", "STATE", "RATE", "SCALE", "LEVEL"),
    *("NOW", "BEFORE", "NEXT", "TIME"),  # indicators now and before; the next event; the time
)
SETTING = {
    2: """
fmi_set = types.ExternalFunction("fmi2SetReal", types.int32(types.intp, types.uintp, types.uintp, types.uintp))
fmi_get = types.ExternalFunction("fmi2GetReal", types.int32(types.intp, types.uintp, types.uintp, types.uintp))


@jit
def fmi_put(c, references, values):
    return fmi_set(c, references.ctypes.data, len(references), values.ctypes.data)


@jit
def fmi_take(c, references, values):
    return fmi_get(c, references.ctypes.data, len(references), values.ctypes.data)
""",
    3: """
fmi_set = types.ExternalFunction(
    "fmi3SetFloat64", types.int32(types.intp, types.uintp, types.uintp, types.uintp, types.uintp)
)
fmi_get = types.ExternalFunction(
    "fmi3GetFloat64", types.int32(types.intp, types.uintp, types.uintp, types.uintp, types.uintp)
)


@jit
def fmi_put(c, references, values):
    return fmi_set(c, references.ctypes.data, len(references), values.ctypes.data, len(values))


@jit
def fmi_take(c, references, values):
    return fmi_get(c, references.ctypes.data, len(references), values.ctypes.data, len(values))
""",
}
EXCHANGE = {
    2: '''
set_time = types.ExternalFunction("fmi2SetTime", types.int32(types.intp, types.float64))
set_states = types.ExternalFunction("fmi2SetContinuousStates", types.int32(types.intp, types.uintp, types.uintp))
get_states = types.ExternalFunction("fmi2GetContinuousStates", types.int32(types.intp, types.uintp, types.uintp))
get_rates = types.ExternalFunction("fmi2GetDerivatives", types.int32(types.intp, types.uintp, types.uintp))
get_indicators = types.ExternalFunction("fmi2GetEventIndicators", types.int32(types.intp, types.uintp, types.uintp))
enter_events = types.ExternalFunction("fmi2EnterEventMode", types.int32(types.intp))
enter_time = types.ExternalFunction("fmi2EnterContinuousTimeMode", types.int32(types.intp))
fmi_complete = types.ExternalFunction(
    "fmi2CompletedIntegratorStep", types.int32(types.intp, types.int32, types.uintp, types.uintp)
)
fmi_update = types.ExternalFunction("fmi2NewDiscreteStates", types.int32(types.intp, types.uintp))


@jit
def updated(c, flags, moment):
    """Ask for new discrete states: flags become (once more, stop, values changed, next event is defined)."""
    status = fmi_update(c, flags.ctypes.data)
    moment[0] = flags[6:8].view(np.float64)[0]
    again, stop, changed, defined = flags[0], flags[1], flags[3], flags[4]
    flags[0], flags[1], flags[2], flags[3] = again, stop, changed, defined
    return status
''',
    3: '''
set_time = types.ExternalFunction("fmi3SetTime", types.int32(types.intp, types.float64))
set_states = types.ExternalFunction("fmi3SetContinuousStates", types.int32(types.intp, types.uintp, types.uintp))
get_states = types.ExternalFunction("fmi3GetContinuousStates", types.int32(types.intp, types.uintp, types.uintp))
get_rates = types.ExternalFunction(
    "fmi3GetContinuousStateDerivatives", types.int32(types.intp, types.uintp, types.uintp)
)
get_indicators = types.ExternalFunction("fmi3GetEventIndicators", types.int32(types.intp, types.uintp, types.uintp))
enter_events = types.ExternalFunction("fmi3EnterEventMode", types.int32(types.intp))
enter_time = types.ExternalFunction("fmi3EnterContinuousTimeMode", types.int32(types.intp))
fmi_complete = types.ExternalFunction(
    "fmi3CompletedIntegratorStep", types.int32(types.intp, types.uint8, types.uintp, types.uintp)
)
fmi_update = types.ExternalFunction(
    "fmi3UpdateDiscreteStates",
    types.int32(types.intp, types.uintp, types.uintp, types.uintp, types.uintp, types.uintp, types.uintp),
)


@jit
def updated(c, flags, moment):
    """Ask for new discrete states: flags become (once more, stop, values changed, next event is defined)."""
    to = flags.ctypes.data
    status = fmi_update(c, to, to + 1, to + 4, to + 2, to + 3, moment.ctypes.data)
    return status
''',
}
HEAD = f"""
import numpy as np
from numba import njit, types

from greygate.plants.calling import call  # {calling.TEXT}

jit = njit(cache=True, error_model='numpy', nogil=True)
FINE = 1  # the highest status of FMI that is none of a failure: a warning
LAST = 100  # rounds of an event, and events in one step, at most
HALVINGS = 40  # of a step, to where an event is
NOWHERE = np.inf
TIMES = np.array([0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0])
"""
GIVEN = '''

@jit
def put(at, u):
    """Give the FMU its inputs."""
    for i in range(at[0][INPUTS]):
        at[2][IN, i] = (u[at[0][PLACES + i]] - at[2][LEVEL_IN, i]) / at[2][SCALE_IN, i]
    return at[0][INPUTS] == 0 or fmi_put(at[0][0], at[1][0, : at[0][INPUTS]], at[2][IN]) <= FINE
'''
PLACED = '''
@jit
def placed(at, t, x):
    """Give the FMU time and states."""
    for j in range(at[0][STATES]):
        at[2][STATE, j] = (x[j] - at[2][LEVEL, j]) / at[2][SCALE, j]
    fine = set_time(at[0][0], t) <= FINE
    return (at[0][STATES] == 0 or set_states(at[0][0], at[2][STATE].ctypes.data, at[0][STATES]) <= FINE) and fine
'''
FLOW = '''

@jit
def flow(at, t, x, u, p, dx):
    """The rates of all states: of the FMU, and what effects add."""
    call(at[0][EFFECTS], x.ctypes.data, u.ctypes.data, p.ctypes.data, at[4].ctypes.data, dx.ctypes.data)
    if at[0][STATES] == 0:
        return True
    fine = placed(at, t, x) and get_rates(at[0][0], at[2][RATE].ctypes.data, at[0][STATES]) <= FINE
    for j in range(at[0][STATES]):
        dx[j] += at[2][SCALE, j] * at[2][RATE, j]
    return fine
'''
STEP = '''

@jit
def shown(at, t, x):
    """Let x have the outputs that the FMU computes."""
    if at[0][OUTPUTS] == 0:
        return True
    fine = placed(at, t, x) and fmi_take(at[0][0], at[1][1, : at[0][OUTPUTS]], at[2][OUT]) <= FINE
    for i in range(at[0][OUTPUTS]):
        x[at[0][STATES] + i] = at[2][SCALE_OUT, i] * at[2][OUT, i] + at[2][LEVEL_OUT, i]
    return fine


@jit
def step(at, t, h, x, u, p, low, high, rate, bounded, k, y, end):
    """One step from x to `end`."""
    n, fine = len(x), True
    for stage in range(6):
        for j in range(n):
            move = 0.0
            for i in range(stage):
                move += WEIGHTS[stage, i] * k[i, j]
            y[j] = x[j] + h * move
        fine &= flow(at, t + TIMES[stage] * h, y, u, p, k[stage])
        hold(y, k[stage], low, high, rate, bounded)
    for j in range(n):
        move = 0.0
        for i in range(6):
            move += WEIGHTS[6, i] * k[i, j]
        end[j] = x[j] + h * move
    for j in bounded:
        end[j] = min(max(end[j], low[j]), high[j])
    return fine
'''
COMPLETED = '''

@jit
def completed(at, t, x):
    """Tell the FMU that a step is done; whether it asks for an event. The second flag: it asks to stop, or fails."""
    flags = at[3]
    flags[0] = flags[1] = 0
    to = flags.ctypes.data
    if not placed(at, t, x) or fmi_complete(at[0][0], 1, to, to + flags.itemsize) > FINE:
        flags[1] = 1
    return flags[0] != 0
'''
PLAIN = '''

@jit
def given(at, t, x, u, first):
    """Let the FMU have the inputs of a sample."""
    return put(at, u) if first or at[0][INPUTS] else True


@jit
def advanced(at, t, h, x, u, p, low, high, rate, bounded, k, y, end):
    """A step."""
    fine = step(at, t, h, x, u, p, low, high, rate, bounded, k, y, end)
    for j in range(len(x)):
        x[j] = end[j]
    if COMPLETES and fine:
        fine = not completed(at, t + h, x) and not at[3][1]  # it may have no event, by its description
    return fine
'''
EVENTS = '''

@jit
def given(at, t, x, u, first):
    """Let the FMU have the inputs of a sample: where they change, that is an event."""
    changed = first
    for i in range(at[0][INPUTS]):
        changed |= (u[at[0][PLACES + i]] - at[2][LEVEL_IN, i]) / at[2][SCALE_IN, i] != at[2][IN, i]
    return settle(at, t, x, u) if changed else True


@jit
def crossed(at):
    """Whether an indicator has another sign than before."""
    for i in range(at[0][SIGNS]):
        if (at[2][NOW, i] > 0.0) != (at[2][BEFORE, i] > 0.0):
            return True
    return False


@jit
def indicated(at, t, x):
    return placed(at, t, x) and get_indicators(at[0][0], at[2][NOW].ctypes.data, at[0][SIGNS]) <= FINE


@jit
def settle(at, t, x, u):
    """An event: the FMU changes what is discrete, until nothing changes any more; x becomes its states."""
    flags, changed = at[3], False
    fine = placed(at, t, x) and enter_events(at[0][0]) <= FINE and put(at, u)
    for _ in range(LAST):
        fine = fine and updated(at[0][0], flags, at[2][NEXT]) <= FINE and not flags[1]
        changed |= flags[2] != 0
        if not fine or not flags[0]:
            break
    fine = fine and not flags[0] and enter_time(at[0][0]) <= FINE
    if not flags[3]:
        at[2][NEXT, 0] = NOWHERE
    if changed and at[0][STATES]:
        fine = fine and get_states(at[0][0], at[2][STATE].ctypes.data, at[0][STATES]) <= FINE
        for j in range(at[0][STATES]):
            x[j] = at[2][SCALE, j] * at[2][STATE, j] + at[2][LEVEL, j]
    if at[0][SIGNS]:
        fine = fine and indicated(at, t, x)
        for i in range(at[0][SIGNS]):
            at[2][BEFORE, i] = at[2][NOW, i]
    return fine


@jit
def advanced(at, t, h, x, u, p, low, high, rate, bounded, k, y, end):
    """A step, with the events in it."""
    left, events = h, 0
    while left > 0.0:
        size, fine = left, True
        reached = t + size
        timed = at[2][NEXT, 0] <= reached
        if timed:
            reached = max(at[2][NEXT, 0], t)
            size = reached - t
        if size > 0.0:
            fine = step(at, t, size, x, u, p, low, high, rate, bounded, k, y, end)
            fine = fine and (at[0][SIGNS] == 0 or indicated(at, t + size, end))
            if fine and crossed(at):
                timed, none, whole = True, 0.0, size
                for _ in range(HALVINGS):
                    middle = (none + whole) / 2
                    fine = fine and step(at, t, middle, x, u, p, low, high, rate, bounded, k, y, end)
                    fine = fine and indicated(at, t + middle, end)
                    if crossed(at):
                        whole = middle
                    else:
                        none = middle
                size, reached = whole, t + whole
                fine = fine and step(at, t, size, x, u, p, low, high, rate, bounded, k, y, end)
            for j in range(len(x)):
                x[j] = end[j]
        if not fine:
            return False
        t = reached
        left = left - size if left - size > h * 1e-12 else 0.0
        asked = size > 0.0 and completed(at, t, x)
        if size > 0.0 and at[3][1]:
            return False
        if timed or asked:
            events += 1
            if events > LAST or not settle(at, t, x, u):
                return False
    return True
'''
STEPPED = '''

@jit
def placed(at, t, x):
    return True


@jit
def given(at, t, x, u, first):
    """Let the FMU have the inputs of a sample."""
    return put(at, u)


@jit
def flow(at, t, x, u, p, dx):
    """The rates of states that effects have."""
    call(at[0][EFFECTS], x.ctypes.data, u.ctypes.data, p.ctypes.data, at[4].ctypes.data, dx.ctypes.data)
    return True
'''
ITSELF = '''


@jit
def advanced(at, t, h, x, u, p, low, high, rate, bounded, k, y, end):
    """A step of the FMU, and of what effects have of their own."""
    fine = step(at, t, h, x, u, p, low, high, rate, bounded, k, y, end)
    for j in range(len(x)):
        x[j] = end[j]
    return fine and do_step(at, t, h)
'''
RUN = '''

@jit
def run(x, inputs, parameters, low, high, rate, h, substeps, out, at):
    """Fill out[sample] with the state at each sample; return the first sample that is not finite, or -1."""
    n = len(x)
    k, y, end = np.empty((6, n)), np.empty(n), np.empty(n)
    bounded = np.empty(n, np.int64)
    count = 0
    for j in range(n):
        if low[j] > -np.inf or high[j] < np.inf:
            bounded[count] = j
            count += 1
    bounded = bounded[:count]
    began = at[2][TIME, 0]
    for sample in range(len(inputs)):
        u, now = inputs[sample], began + sample * substeps * h
        fine = given(at, now, x, u, sample == 0) and shown(at, now, x)
        for j in range(n):
            fine &= np.isfinite(x[j])
        for j in range(n):
            out[sample, j] = x[j] if fine else np.nan
        if not fine:
            return sample
        for s in range(substeps if sample + 1 < len(inputs) else 0):
            t = now + s * h
            fine = fine and advanced(at, t, h, x, u, parameters, low, high, rate, bounded, k, y, end)
        if not fine:
            for j in range(n):
                out[sample + 1, j] = np.nan
            return sample + 1
    at[2][TIME, 0] = began + (len(inputs) - 1) * substeps * h
    return -1
'''

STEPS = {
    2: """
fmi_step = types.ExternalFunction("fmi2DoStep", types.int32(types.intp, types.float64, types.float64, types.int32))


@jit
def do_step(at, t, h):
    return fmi_step(at[0][0], t, h, 1) <= FINE
""",
    3: '''
fmi_step = types.ExternalFunction(
    "fmi3DoStep",
    types.int32(
        types.intp, types.float64, types.float64, types.uint8, types.uintp, types.uintp, types.uintp, types.uintp
    ),
)


@jit
def do_step(at, t, h):
    """A step; not where the FMU wants an event, or to stop, or to return early: flags[0], [1], [2]."""
    to = at[3].ctypes.data
    status = fmi_step(at[0][0], t, h, 1, to, to + 1, to + 2, at[2][NEXT].ctypes.data)
    return status <= FINE and not at[3][1] and not at[3][2]
''',
}


NAMES = "\n".join(
    [
        *(f"{name} = {i + 1}" for i, name in enumerate(COUNTS)),
        *(f"{name} = {i}" for i, name in enumerate(ROWS)),
        f"PLACES = {len(COUNTS) + 1}",
    ]
)


def memory(
    instance: int, effects: int, on: np.ndarray, columns: Numbers, inputs: Sequence[int], outputs: Sequence[int],
    signs: int, rows: Mapping[str, Numbers], wide: bool,
) -> tuple[np.ndarray, ...]:  # fmt: skip
    """The `at` of a run. rows: those of the numbers that are not 0. wide: flags are integers, else bytes."""
    states = len(rows["STATE"])
    width = max(len(inputs), len(outputs), states, signs, 1)
    references, numbers = np.zeros((2, width), np.uint32), np.zeros((len(ROWS), width))
    references[0, : len(inputs)], references[1, : len(outputs)] = inputs, outputs
    for name, row in rows.items():
        numbers[ROWS.index(name), : len(row)] = row
    whole = np.array([instance, effects, len(inputs), len(outputs), states, signs, *columns], np.int64)
    return whole, references, numbers, np.zeros(FLAGS, np.int32 if wide else np.uint8), on


def source(version: int, stepped: bool, events: bool, completes: bool) -> str:
    """The module of an FMU's kind. stepped: it steps itself. events: it may have such. completes: it hears of steps."""
    if stepped:
        parts = (SETTING[version], GIVEN, STEPS[version], STEPPED, STEP, ITSELF, RUN)
    else:
        kind = (EVENTS,) if events else (f"\nCOMPLETES = {completes}\n", PLAIN)
        parts = (SETTING[version], EXCHANGE[version], GIVEN, PLACED, FLOW, STEP, COMPLETED, *kind, RUN)
    return "".join([HEAD, NAMES, BOUNDED, *parts, RESTARTED.format(at=", at")])
