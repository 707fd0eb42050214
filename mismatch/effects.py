"""The effects that may be tried on a rig: those of the table, the rig's own, and the general ones.

All effects that may enter a plant join it once (`joining`), with parameters at which they do nothing. A hypothesis is
then a set of parameters that become free, and nothing is compiled twice.
"""

from collections.abc import Collection, Mapping

from greygate.mismatch.entries import ANY, EXTRA, SENSOR, TABLE, Effect, Free, fitting, read
from greygate.mismatch.general import GENERAL, general
from greygate.mismatch.general import unmet as general_unmet
from greygate.mismatch.joining import join

__all__ = [
    "ANY", "EXTRA", "GENERAL", "SENSOR", "TABLE", "Effect", "Free", "fitting", "general", "join", "known", "named",
    "read", "unmet",
]  # fmt: skip


def known(rig, recording, every: bool = False, given: Mapping[str, Effect] | None = None) -> dict[str, Effect]:
    """The effects to be tried on a rig: those of the table, of `effects.toml` in its folder, and those `given`.

    Beside them stand the general effects, in every place of the plant that they fit and that the recording can excite
    (none before there is a recording); every: excited or not. Where the table has effects of the plant, and the rig
    states its noise, those are the faults of a recording alone. What the table, or the rig's own, calls by a general
    effect's name takes its place.
    """
    path = rig.folder / "effects.toml"
    table, own = read(), read(path) if path.exists() else {}
    own |= given or {}
    special = fitting(rig.plant, rig.datasheet, table) | fitting(rig.plant, rig.datasheet, own)
    ids = {effect.id for effect in special.values()}
    found: dict[str, Effect] = {}
    if recording is not None:
        offered = general(rig, recording, special.values(), every, any_plant(rig))
        found = {k: e for k, e in offered.items() if e.id not in ids}
    return table | found | own


def named(rig, recording, asked: Collection[str]) -> dict[str, Effect]:
    """The effects among which those are whose keys are `asked`; general ones, which take time, only if one is."""
    path = rig.folder / "effects.toml"
    special = read() | (read(path) if path.exists() else {})
    there = fitting(rig.plant, rig.datasheet, special)
    return special if there.keys() >= set(asked) else known(rig, recording, every=True)


def unmet(rig, recording) -> dict[str, str]:
    """General effects that are on offer for the rig's plant and that this recording does not excite -> why."""
    return general_unmet(rig, recording, any_plant(rig))


def any_plant(rig) -> bool:
    """Whether all general effects are on offer."""
    return not (rig.stated and fitting(rig.plant, rig.datasheet, read()))
