"""What the folded architecture does in a step, as jobs that wait for each other; schedule.py places them.

A job is an operation, the copy of a signal to a state, or a state that is shown. A lookup that reads the rows of an
affine operation is no job: it answers each row as it is drained. A result takes the word of the state that it becomes
where nothing reads the state afterwards; every other state is copied.
"""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field

from greygate.emulator.program import Affine, Lookup, Operation, Program


@dataclass
class Job:
    """One job. source: the signal that a copy reads. target: the state or shadow that it writes, "" if it only shows.

    reads: names of signals. after: keys of the jobs that come first. length: reads from here to the end of the step, on
    the longest path; 0 of a copy. next: the row or element that is placed next.
    """

    key: str
    reads: tuple[str, ...]
    size: int
    after: set[str] = field(default_factory=set)
    operation: Operation | None = None
    source: str = ""
    target: str = ""
    length: int = 0
    next: int = 0


@dataclass
class Plan:
    """The jobs of a step.

    answers: affine result -> the lookup of its rows. home: result -> the state whose word it takes. kept: the signals
    that take words of the memory. shadows: name -> the state that it keeps while a ring of states is turned.
    """

    jobs: dict[str, Job]
    answers: dict[str, Lookup]
    home: dict[str, str]
    kept: set[str]
    shadows: dict[str, str]


def live_operations(program: Program) -> list[Operation]:
    """The operations on which an output or a state depends."""
    read = {p.signal.name for p in program.outputs} | {s.source for s in program.states}
    found = []
    for o in reversed(program.operations):
        if o.out.name in read:
            read |= set(o.args)
            found.append(o)
    return found[::-1]


def planned(program: Program, multipliers: int) -> Plan:
    """The jobs of a step, without their lengths."""
    live = live_operations(program)
    answers = _answers(live)
    inside = {o.out.name: name for name, o in answers.items()}
    operations = [o for o in live if o.out.name not in inside]
    producer = {o.out.name: inside.get(o.out.name, o.out.name) for o in live}
    jobs = {o.out.name: Job(o.out.name, tuple(o.args), o.out.size, operation=o) for o in operations}
    states = [s.signal.name for s in program.states]
    size = {s.name: s.size for s in program.signals.values()}
    for name in sorted({p.signal.name for p in program.outputs} & set(states)):
        jobs[f"show {name}"] = Job(f"show {name}", (name,), size[name], source=name)
    moves = [(s.source, s.signal.name) for s in program.states if s.source != s.signal.name]
    shadows, moves = ordered(moves)
    kept_shadows = {target: source for source, target in shadows}
    for source, target in [*shadows, *moves]:
        key, original = f"copy {target}", kept_shadows.get(source, source)
        jobs[key] = Job(key, (source,), size[original], source=source, target=target)
    for job in jobs.values():
        job.after |= {producer[a] for a in job.reads if a in producer}
        job.after |= {f"copy {a}" for a in job.reads if a in kept_shadows}
    readers = defaultdict(set)
    for job in jobs.values():
        for a in job.reads:
            readers[a].add(job.key)
    for _, target in moves:
        jobs[f"copy {target}"].after |= readers[target] - {f"copy {target}"}
    home = _homes(jobs, states, producer, readers, multipliers)
    read = {a for job in jobs.values() for a in job.reads}
    return Plan(jobs, answers, home, read | set(home) | set(states), kept_shadows)


def _answers(operations: list[Operation]) -> dict[str, Lookup]:
    """Affine result -> the first lookup that reads it."""
    affine = {o.out.name for o in operations if isinstance(o, Affine)}
    found: dict[str, Lookup] = {}
    for o in operations:
        if isinstance(o, Lookup) and o.arg in affine:
            found.setdefault(o.arg, o)
    return found


def _homes(
    jobs: dict[str, Job], states: list[str], producer: dict[str, str], readers: dict[str, set[str]], multipliers: int
) -> dict[str, str]:
    """Result -> the state whose word it takes, where all that reads the state can come before; its copy is dropped."""
    home: dict[str, str] = {}
    for state in states:
        copy = jobs.get(f"copy {state}")
        if copy is None or copy.source not in producer or copy.source in home:
            continue
        job = jobs[producer[copy.source]]
        if state in job.reads and isinstance(job.operation, Affine) and job.size > multipliers:
            continue  # its later rows would read what the earlier ones wrote
        del jobs[copy.key]
        readers[copy.source].discard(copy.key)
        before, job.after = job.after, job.after | (readers[state] - {job.key, copy.key})
        if is_ordered(jobs.values()):
            home[copy.source] = state
        else:
            job.after = before
            jobs[copy.key] = copy
            readers[copy.source].add(copy.key)
    return home


def is_ordered(jobs: Iterable[Job]) -> bool:
    """Whether no job comes after itself."""
    left = {job.key: set(job.after) for job in jobs}
    return len(_topological(left)) == len(left)


def _topological(after: dict[str, set[str]]) -> list[str]:
    """The keys, each after those that it waits for; without those that wait for themselves."""
    waiting = {key: len(found) for key, found in after.items()}
    users = defaultdict(list)
    for key, found in after.items():
        for a in found:
            users[a].append(key)
    free = [key for key, count in waiting.items() if not count]
    for key in free:
        for user in users[key]:
            waiting[user] -= 1
            if not waiting[user]:
                free.append(user)
    return free


def measure(jobs: dict[str, Job], reads: dict[str, int], latency: int) -> None:
    """Set the length of every operation, from the reads of each and the clocks from its last read to its result."""
    users = defaultdict(list)
    for job in jobs.values():
        for a in job.after:
            users[a].append(job)
    for key in reversed(_topological({key: job.after for key, job in jobs.items()})):
        job = jobs[key]
        if job.operation is not None:
            job.length = reads[key] + latency + max((u.length for u in users[key]), default=0)


def ordered(moves: list[tuple[str, str]]) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Order the moves (source, state) so that none overwrites a state that a later one reads.

    A copy opens a ring of states. Copies are made first, and are returned before the moves.
    """
    shadows, done, left = [], [], list(moves)
    while left:
        sources = {source for source, _ in left}
        safe = [m for m in left if m[1] not in sources]
        if safe:
            done += safe
            left = [m for m in left if m not in safe]
        else:
            state = left[0][1]
            shadow = f"{state} before the step"
            shadows.append((state, shadow))
            left = [(shadow if source == state else source, target) for source, target in left]
    return shadows, done
