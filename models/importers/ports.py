"""Names of ports as other tools' files have them: "p_a [Pa]"."""

import re

from greygate.errors import InputError, shown
from greygate.models.network import Port
from greygate.names import check_path, check_unit

_NAMED = re.compile(r"\s*(\S+?)\s*(?:\[([^\]]*)\])?\s*")


def port(text: str) -> Port:
    """The port of a text such as "u [V]" or "u". Raises InputError for a name or a unit that no port can have."""
    if (found := _NAMED.fullmatch(text)) is None:
        raise InputError(f"port {shown(text)}: write a name and its unit, such as 'p_a [Pa]'")
    return Port(check_path(found[1], "port"), check_unit((found[2] or "1").strip(), f"port {found[1]}: unit"))
