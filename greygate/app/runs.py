"""Commands that run in processes of their own, whether or not a page looks on."""

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock, Thread
from time import monotonic

from greygate import children
from greygate.app.forms import line
from greygate.errors import InputError

AT_ONCE = 4  # commands that may run side by side
KEPT, LINES = 100, 2000  # runs, and lines of the log of one, that are kept
ENDINGS = {0: "done", 1: "the answer is no", 2: "wrong use"}


@dataclass
class Run:
    """state: "runs", "cancelled", or how it ended. log: the last lines that it printed."""

    number: int
    words: list[str]
    began: float = field(default_factory=monotonic)
    state: str = "runs"
    seconds: float = 0.0
    log: deque[str] = field(default_factory=lambda: deque(maxlen=LINES))
    process: children.Popen | None = None

    def told(self) -> dict:
        """What a page shows of it."""
        seconds = self.seconds or monotonic() - self.began
        return {"number": self.number, "line": line(self.words), "state": self.state, "seconds": round(seconds, 1),
                "log": "".join(list(self.log))}  # fmt: skip


class Runs:
    """The runs in a folder."""

    def __init__(self, folder: Path):
        self.folder, self.lock = folder, Lock()
        self.runs: dict[int, Run] = {}
        self.last = 0

    def start(self, words: list[str]) -> Run:
        """Start `greygate WORDS`. Raises InputError where so many run that another would slow all."""
        with self.lock:
            if sum(run.state == "runs" for run in self.runs.values()) >= AT_ONCE:
                raise InputError(f"{AT_ONCE} commands run; wait until one has ended, or cancel it")
            self.last += 1
            run = self.runs[self.last] = Run(self.last, words)
            for old in [n for n, r in self.runs.items() if r.state != "runs"][: max(0, len(self.runs) - KEPT)]:
                del self.runs[old]
        Thread(target=self._follow, args=(run,), daemon=True).start()
        return run

    def _follow(self, run: Run) -> None:
        command, ended = children.python("-m", "greygate", *run.words), "it failed"
        try:
            with children.started(
                command, cwd=self.folder, stdout=children.PIPE, stderr=children.STDOUT, env={"COLUMNS": "100"}
            ) as process:
                run.process = process
                if run.state != "runs":  # cancelled before it began
                    return
                assert process.stdout
                run.log.extend(process.stdout)
                code = process.wait()
            ended = ENDINGS.get(code, "it was killed" if code < 0 else f"it failed ({code})")
        except (OSError, ValueError) as error:
            ended = f"not started: {error}"
        finally:
            run.seconds = monotonic() - run.began
            with self.lock:
                run.state = ended if run.state == "runs" else run.state

    def cancel(self, run: Run) -> None:
        """Kill a run with all that it started; what it wrote is whole or not there."""
        with self.lock:
            if run.state != "runs":
                return
            run.state = "cancelled"
        if run.process is not None:
            children.kill(run.process)
