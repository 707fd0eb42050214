"""Tables, resources, passes of the compiler and saturations."""


def context(study: dict) -> dict:
    """The study itself beside the columns of its table of resources."""
    names = dict.fromkeys(k for r in study["resources"].values() for k in r)
    return {"s": study, "resource_names": list(names)}
