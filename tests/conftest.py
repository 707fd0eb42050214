"""What several test files share."""

import shutil
import sys
from pathlib import Path

import checking
import command_line
import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, settings
from networks import delay_line

from greygate import schemas
from greygate.compiler.quantize import Formats
from greygate.identify import training
from greygate.machines.source import Source
from greygate.mismatch import effects
from greygate.mismatch.concealed.conceal import conceal
from greygate.mismatch.rig import load
from greygate.mismatch.search import Hypothesis, Search
from greygate.project import compile_project

sys.path.append(str(Path(__file__).parents[1]))  # for `benchmarks`; last: folders here have names of packages

settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")  # how fast an example is drawn says nothing of the product


@pytest.hookimpl(tryfirst=True)
def pytest_fixture_setup():
    """A network of torch has the same weights whatever ran before in this process."""
    torch.manual_seed(0)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_call():
    torch.manual_seed(0)


@pytest.fixture(scope="session", autouse=True)
def every_json_that_a_command_prints_follows_its_schema():
    """In all tests: the validation costs milliseconds."""
    marked = schemas.marked

    def checked(name, result):
        found = marked(name, result)
        checking.valid(name, found)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(schemas, "marked", checked)
        yield


@pytest.fixture
def greygate():
    """The command: exit code, stdout, stderr."""
    return command_line.greygate


@pytest.fixture(scope="session")
def compiled(tmp_path_factory) -> Path:
    """The folder of a compiled `delay_line`, beside its network and recording; nobody writes into it."""
    folder = tmp_path_factory.mktemp("compiled")
    delay_line().save(folder / "line")
    rows = "".join(f"{k * 1e-3:.3f},{k % 5},{k % 3}\n" for k in range(20))
    (folder / "a.csv").write_text("t_s,u_V,y_m\n" + rows)
    compile_project(Source(str(folder / "line.toml"), {"a": str(folder / "a.csv")}), folder / "b", Formats())
    return folder / "b"


@pytest.fixture
def build(compiled, tmp_path) -> Path:
    """A copy of it, to be changed."""
    shutil.copytree(compiled, tmp_path / "b")
    return tmp_path / "b"


@pytest.fixture
def alone(monkeypatch):
    """No linear model is searched beside a training, which takes longer than it: test_advice looks at that one."""
    monkeypatch.setattr(
        training,
        "linear_rms",
        lambda learnt, judged: {n: {o: float(np.std(y)) for o, y in r.targets.items()} for n, r in judged.items()},
    )


@pytest.fixture(scope="session")
def cluster():
    """A scheduler and a worker on this machine; of one thread alone joblib would make no use."""
    distributed = pytest.importorskip(
        "distributed", reason="distributed is not installed: pip install 'greygate[cluster]'"
    )
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, protocol="tcp://", host="127.0.0.1", dashboard_address=":0"
    ) as made:
        yield made


@pytest.fixture
def cluster_tasks(cluster):
    """How many tasks the cluster has done, when it is called."""
    return lambda: sum(to == "memory" for _, _, to, *_ in cluster.scheduler.transition_log)


TRIED = "speed_slip", "direction_slip", "acceleration_slip", "drift"  # of a drum's effects: all others cost time alone


def _drum(folder: Path, **drawn: str) -> Search:
    """The search on a cable drum that conceals what is drawn."""
    rig = load(conceal("cable_drum", 3, folder / "rig", **drawn))
    recording = rig.to_explain()
    known = effects.known(rig, recording)
    return Search(rig, recording, {key: effect for key, effect in known.items() if effect.id in TRIED})


@pytest.fixture(scope="module")
def slipping(tmp_path_factory):
    """The search on a cable drum that slips more when it is fast, with its calibrated and its right fit."""
    search = _drum(tmp_path_factory.mktemp("drum"), effect="speed_slip", kind="one")
    plain = search.fit(search.final, Hypothesis(), {})
    best = Hypothesis(("speed_slip",))
    return search, plain, best, search.fit(search.final, best, plain.values)


@pytest.fixture(scope="module")
def steady(tmp_path_factory):
    """The search on a cable drum as its data sheet has it, and its calibrated fit."""
    search = _drum(tmp_path_factory.mktemp("drum"), kind="clean")
    return search, search.fit(search.final, Hypothesis(), {})
