"""Position control of a machine by one of its controllers: in float, in the emulator or in simulated hardware."""

from collections.abc import Iterator
from contextlib import contextmanager

from greygate.control.choices import Method, Place
from greygate.control.loop import Controller
from greygate.control.stepping import Emulated
from greygate.errors import InputError
from greygate.files import scratch
from greygate.hardware.in_loop import Clocked, clocked
from greygate.hardware.verify import Case as Built
from greygate.machines.control import Task
from greygate.progress import Progress, silent


@contextmanager
def controller(
    task: Task, method: Method, place: Place = Place.FLOAT, progress: Progress = silent
) -> Iterator[tuple[Controller, list[Clocked]]]:
    """The controller, and the designs that it is made of where it is hardware: imitating network and sensor.

    Raises InputError where a PI or predictive controller is asked for in the emulator or in hardware.
    """
    if method is not Method.NETWORK:
        if place is not Place.FLOAT:
            raise InputError(f"{method} runs in float; only the imitating network is compiled: take network")
        yield (task.proportional() if method is Method.PI else task.predictive()), []
        return
    network = task.network()
    if place is Place.FLOAT:
        yield task.floating(network), []
        return
    progress("compiling soft sensor and controller")
    programs = task.programs(network)
    if place is Place.EMULATOR:
        yield task.imitated(*map(Emulated, programs)), []
        return
    cases = [Built(program, {}) for program in programs]
    with scratch() as folder, clocked(cases, folder, progress) as designs:
        yield task.imitated(*designs), designs
