"""What a reader of a diagnosis wants to know next: how far a confidence can be trusted, and what to do."""

from collections.abc import Iterator

from greygate.mismatch import words
from greygate.mismatch.verdict import Verdict
from greygate.pages.diagnosis.residual import Diagnosed

RELIABLE = ((0.0, 27, 13), (0.8, 111, 81), (0.95, 111, 111))
"""Confidence from which on, claims on sealed cases, how many of them were right: `benchmarks/results/blind.json`."""


def trust(confidence: float) -> str:
    """What a confidence was worth where the answers were sealed."""
    _, claims, right = next(part for part in reversed(RELIABLE) if confidence >= part[0])
    return f"{right} of {claims} claims as sure as that were right on sealed cases"


def steps(case: Diagnosed) -> list[str]:
    """What to do next, the most useful first."""
    return [*_by_verdict(case), *_further(case)]


def _by_verdict(case: Diagnosed) -> Iterator[str]:
    found, folder = case.found, case.result.rig.folder
    named = [entry["id"] for entry in found["effects"] if entry["id"] != "unknown"]
    match found["verdict"]:
        case Verdict.CONSISTENT:
            yield "Nothing needs a correction; what the recording rules out stands under Figures."
        case Verdict.PARAMETER_ERROR:
            outside = [name for name, p in found["parameters"].items() if p.get("outside_tolerance")]
            yield f"Measure {' and '.join(outside)} anew, or write the value that was found into rig.toml."
        case Verdict.RECORDING_FAULT:
            yield f"Mend what the recording has ({', '.join(named)}), and record again; the plant needs no change."
        case Verdict.UNEXPLAINED if any("formula" in place for place in found["where"]):
            yield f"Take the formula into the rig, if it makes sense there: greygate diagnose {folder} --accept."
        case Verdict.UNEXPLAINED:
            yield "Look at the pictures below for what the error goes with; write what you suspect into effects.toml."
        case _:
            yield f"Simulate with {' and '.join(named)}: greygate simulate {folder} FILE.csv --diagnosis FILE.json."
            if path := getattr(case.result.rig.plant.outside, "path", None):
                kind, end = ("fmu", ".fmu") if path.suffix == ".fmu" else ("mjcf", ".xml")
                wish = f"greygate export {kind} {folder} --diagnosis FILE.json --out CORRECTED{end}"
                yield f"Take the corrected model along: {wish}."


def _further(case: Diagnosed) -> Iterator[str]:
    found = case.found
    if any(entry["not_told_apart_from"] for entry in found["effects"]):
        yield f"Find the experiment that leaves one name: greygate next {case.result.rig.folder} --diagnosis FILE.json."
    yield from (f"Not told apart: {text}." for text in words.alike(case.result, found) if found["effects"])
    yield from (f"Correct the units: {text}." for text in found.get("units", ()))
    if untried := found.get("not_tried"):
        yield f"{len(untried)} hypotheses were not tried, for want of time: give more --seconds."
