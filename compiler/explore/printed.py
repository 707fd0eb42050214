"""What an exploration tells: the types of its JSON."""

from typing import Annotated, TypedDict

from greygate.compiler.targets import Design
from greygate.plain import Count


class Costed(TypedDict):
    """A design of an exploration."""

    error: float
    luts: Count
    dsps: Count
    memories: float
    clocks: Count
    period_ns: float
    microseconds: float
    architecture: str
    design: Design
    width: int
    finer: int
    tables: str
    table_budget: float
    signals: dict[str, str]
    weights: dict[str, int]
    price: float


class Explored(TypedDict):
    """What was tried, and what binds."""

    device: str
    family: str
    error_in: str
    request: Annotated[dict[str, float | None], "The limits; null where none is set."]
    programs: Count
    points: Count
    front: list[Costed]
    chosen: Costed | None
    why: str
