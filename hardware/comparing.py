"""Compares two builds figure by figure, and says which became worse by more than a budget allows.

A budget is a TOML file that a user keeps beside the build: how much a figure may grow over the old build, and how large
it may be at all. Without one nothing may grow, since a build of the same inputs has the same figures.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from greygate.compiler.pipeline import fixed_error
from greygate.compiler.targets import Architecture, target
from greygate.errors import InputError
from greygate.hardware.build import Project
from greygate.models.accuracy import rms_by_column
from greygate.names import check_text
from greygate.reading import Kind, named, one_of, read_toml, table, truth, within

ERROR = "error"
GROWING = "clock_mhz"  # the only figure of which more is better
COUNTED = ("luts", "flip_flops", "dsps", "block_rams", "lut_rams", "clocks", GROWING, "us_per_step")
FIGURES = (ERROR, "parameters", "products", *COUNTED)
ROUNDING = 1e-9  # by which a share may exceed the budget, as a share in decimals is not exact in binary
POSITIVE = within(0, math.inf, "give 0 or more")

Place = tuple[str, str]
"""(figure, where): ("error", "test.y"), ("luts", "folded, ecp5"), ("parameters", "")."""


@dataclass(frozen=True)
class Budget:
    """What the new build may have.

    growth: figure -> the share by which it may be worse than in the old build, 0.05 for 5 %; 0 if not named.
    limit: figure -> the most that any place may have (of `clock_mhz`, the least), in the figure's own unit.
    errors: "scenario.output" -> the largest RMS error, in the output's unit.
    verified: whether the new build must have been verified, without a differing bit.
    """

    growth: Mapping[str, float] = field(default_factory=dict)
    limit: Mapping[str, float] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)
    verified: bool = False


@dataclass(frozen=True)
class Difference:
    """One figure of two builds, in SI units; None for a build that does not have it."""

    figure: str
    where: str
    unit: str
    old: float | None
    new: float | None
    worse: bool  # more than the budget allows
    says: str  # "equal", "better", "worse, within the budget", or what is too much

    @property
    def growth(self) -> float | None:
        """By which share the new figure is worse than the old one, negative if it is better; None if not comparable."""
        if self.old is None or self.new is None or not self.old:
            return None
        one, other = (self.new, self.old) if self.figure == GROWING else (self.old, self.new)
        return other / one - 1 if one else None


def read_budget(path: Path | str) -> Budget:
    """Read a budget. Raises InputError for an entry that does not exist, or is not a number of 0 or more."""
    known = one_of(FIGURES)
    counts = one_of([name for name in FIGURES if name != ERROR])

    def limit(value: object, where: str) -> tuple[dict[str, float], dict[str, float]]:
        if not isinstance(value, dict):
            raise InputError(f"{where} {value!r} is not a table; give FIGURE = NUMBER")
        errors = named(POSITIVE, check_text)(value.get(ERROR, {}), f"{where}.{ERROR}")
        return named(POSITIVE, counts)({k: v for k, v in value.items() if k != ERROR}, where), errors

    kinds: dict[str, Kind] = {"growth": named(POSITIVE, known), "limit": limit, "verified": truth}
    found = table(read_toml(path, "write a budget"), f"{path}:", {}, kinds)
    limits, errors = found.get("limit", ({}, {}))
    return Budget(found.get("growth", {}), limits, errors, found.get("verified", False))


def compare(old: Project, new: Project, budget: Budget | None = None) -> list[Difference]:
    """Compare two builds: RMS errors, size, resources, clocks, and whether the bits were verified.

    A figure that only one build has is shown and not judged, unless the budget limits it. Raises InputError if the
    builds share a scenario but not its recording, if they have neither a scenario and output nor a name in common, or
    if the budget names a figure that the new build does not have.

    >>> all(not difference.worse for difference in compare(project, project))
    True
    """
    budget = budget or Budget()
    units = {f"{name}.{p.name}": p.unit for name in new.source.scenarios for p in new.program.outputs}
    one, other = _figures(old), _figures(new)
    _same_recordings(old, new)
    _known(budget, other, new)
    places = sorted({*one, *other}, key=lambda place: (FIGURES.index(place[0]), place[1]))
    found = [_difference(place, units, one.get(place), other.get(place), budget) for place in places]
    return [*found, *_verified(old, new, budget)]


def _figures(project: Project) -> dict[Place, float]:
    """Every figure of a build by its place."""
    last = project.facts["passes"][-1] if project.facts["passes"] else None
    found: dict[Place, float] = {}
    if last is not None:
        found |= {("parameters", ""): last["parameters"], ("products", ""): last["multiplications"]}
    records = project.records()
    for name in project.source.scenarios:
        for output, error in fixed_error(project.program, records[name]).items():
            found[ERROR, f"{name}.{output}"] = float(np.max(rms_by_column(error[records[name].skip :])))
    for architecture, verified in (project.hardware or {}).items():
        if verified["clocks_per_step"] is not None:
            found["clocks", architecture] = verified["clocks_per_step"]
    for where, counts in (project.resources or {}).items():
        found |= {(name, where): counts[name] for name in COUNTED if counts.get(name) is not None}
    return found


def _same_recordings(old: Project, new: Project) -> None:
    """Raise InputError if an error of one build is not the same error of the other."""
    one, other = old.records(), new.records()
    shared = [name for name in old.source.scenarios if name in new.source.scenarios]
    outputs = {p.name for p in old.program.outputs} & {p.name for p in new.program.outputs}
    if not shared or not outputs:
        raise InputError(
            f"{old.folder}, {new.folder}: no scenario and output in common; compare builds of one plant, compiled with "
            "the same scenario names"
        )
    for name in shared:
        for output in outputs:
            if not np.array_equal(one[name].targets[output], other[name].targets[output]):
                raise InputError(
                    f"scenario {name}: the two builds have other recordings of {output}; compile both with the same one"
                )


def _known(budget: Budget, found: Mapping[Place, float], new: Project) -> None:
    """Raise InputError for a limit on something that the new build does not have."""
    for where in budget.errors:
        if (ERROR, where) not in found:
            known = ", ".join(place for figure, place in found if figure == ERROR)
            raise InputError(f"the budget's limit.error: {new.folder} has no {where}; it has {known}")
    for name in budget.limit:
        if not any(figure == name for figure, _ in found):
            raise InputError(
                f"the budget's limit.{name}: {new.folder} has no such figure; run greygate synthesize or verify first"
            )


def _difference(
    place: Place, units: Mapping[str, str], old: float | None, new: float | None, budget: Budget
) -> Difference:
    """Judge one figure. units: of each scenario.output."""
    name, where = place
    unit = units.get(where, "") if name == ERROR else ""
    limit = budget.errors.get(where) if name == ERROR else budget.limit.get(name)
    plain = Difference(name, where, unit, old, new, False, "")
    if new is not None and limit is not None and (new < limit if name == GROWING else new > limit):
        side = "least" if name == GROWING else "most"
        return replace(plain, worse=True, says=f"the budget's {side} is {limit:.6g}")
    if old is None or new is None:
        return replace(plain, says=f"only in the {'new' if old is None else 'old'} build")
    if new == old:
        return replace(plain, says="equal")
    if (new > old) == (name == GROWING):
        return replace(plain, says="better")
    growth, allowed = plain.growth, budget.growth.get(name, 0.0)
    if growth is not None and growth <= allowed + ROUNDING:
        return replace(plain, says="worse, within the budget")
    return replace(plain, worse=True, says=f"{100 * allowed:.3g} % is allowed" if allowed else "nothing is allowed")


def _verified(old: Project, new: Project, budget: Budget) -> list[Difference]:
    """A line for each architecture in Verilog of the new build: how many scenarios differ in a bit."""
    found = []
    for architecture in new.facts["architectures"]:
        if not isinstance(target(architecture), Architecture):
            continue  # a listing or a program in C: no simulation verifies it
        one, other = (_differing(p, architecture) for p in (old, new))
        missing = other is None and budget.verified
        says = "not verified; run greygate verify" if other is None else "bits differ" if other else "every bit equal"
        found.append(Difference("scenarios that differ", architecture, "", one, other, missing or bool(other), says))
    return found


def _differing(project: Project, architecture: str) -> float | None:
    """Scenarios in which the hardware differs from the emulator; None if it was not verified."""
    verified = (project.hardware or {}).get(architecture)
    return verified and float(sum(s["differing_bits"] != 0 for s in verified["scenarios"].values()))
