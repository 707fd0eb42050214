"""`greygate app`: a folder in the browser. Strangers are refused; a command runs as it is typed."""

import html
import json
import os
import re
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import product
from pathlib import Path

import browsing
import pytest
from checking import POSIX
from networks import delay_line, recorded_line
from typer.main import get_command

from greygate import children, cli
from greygate.cli.grammar import leaves

for package in ("httpx", "starlette", "uvicorn"):
    pytest.importorskip(package, reason=f"{package} is not installed: pip install httpx 'greygate[app]'")

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # Starlette names the successor of httpx
    from starlette.testclient import TestClient

from greygate.app import server, things  # noqa: E402
from greygate.app.forms import Form  # noqa: E402

TOKEN, OWN = "s0me-t0ken-that-nobody-guesses-0123456789_abc", "http://127.0.0.1:8000"
ROWS = "t_s,u_V,y_m\n" + "".join(f"{k * 1e-3:.3f},{k % 5},{k % 3}\n" for k in range(200))
COMMANDS = leaves(get_command(cli.app))
PATIENCE = 60.0  # s for a command that takes two


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "a.csv").write_text(ROWS)
    (tmp_path / "secret.csv").write_text(ROWS)
    return tmp_path / "work"


@pytest.fixture
def client(folder):
    with TestClient(server.site(folder, COMMANDS, TOKEN), base_url=OWN, headers={"origin": OWN}) as made:
        yield made


def at(place: str = "") -> str:
    return f"/{TOKEN}/{place}"


def ended(client, number: int) -> dict:
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        if (run := client.get(at(f"runs/{number}/log")).json())["state"] != "runs":
            return run
        time.sleep(0.05)
    raise AssertionError("it does not end")


@pytest.mark.parametrize(
    ("headers", "why"),
    [
        ({"origin": "http://evil.example"}, "another origin"),
        ({"origin": "null"}, "another origin"),
        ({"origin": "http://127.0.0.1:8001"}, "another origin"),
        ({"host": "evil.example:8000"}, "another host"),
        ({"host": "127.0.0.1"}, "another host"),
        ({"host": "127.0.0.1:8000.evil.example"}, "another host"),
    ],
)
@pytest.mark.parametrize(("method", "place"), [("GET", ""), ("PUT", "files/b.csv"), ("POST", "run/doctor")])
def test_other_hosts_and_origins_are_refused(client, folder, headers, why, method, place):
    answer = client.request(method, at(place), headers=headers, content=b"{}")
    assert (answer.status_code, answer.text) == (403, why)
    assert [p.name for p in folder.iterdir()] == ["a.csv"]


def test_what_changes_something_has_to_say_its_origin(client):
    del client.headers["origin"]
    assert client.get(at()).status_code == 200
    assert client.post(at("run/doctor"), content=b"{}").status_code == 403


@pytest.mark.parametrize(
    "place", ["/", "/wrong/", f"/{TOKEN[:-1]}/", f"/{TOKEN}x/", "/wrong/files/a.csv", "//", f"/{TOKEN}"]
)
def test_a_wrong_token_shows_nothing(client, place):
    answer = client.get(place)
    assert answer.status_code == 403
    assert "a.csv" not in answer.text


@pytest.mark.parametrize(
    "name", ["../secret.csv", "%2e%2e/secret.csv", "..%2fsecret.csv", "/etc/passwd", "link.csv", "a%00b"]
)
def test_a_path_outside_the_folder_is_refused(client, folder, name):
    (folder / "link.csv").symlink_to(folder.parent / "secret.csv")
    assert client.get(at(f"files/{name}")).status_code in (403, 404)
    assert client.put(at(f"files/{name}"), content=ROWS).status_code in (400, 403, 404, 405)
    assert (folder.parent / "secret.csv").read_text() == ROWS


@pytest.mark.parametrize(
    "value", ["../secret.csv", "/etc/passwd", "x=../secret.csv", "C:\\secret.csv", "~/x.csv", "--out", "a\\..\\..\\x"]
)
def test_a_command_names_nothing_outside_the_folder_and_no_option_in_disguise(client, value):
    answer = client.post(at("run/look"), json={"recording": value})
    assert answer.status_code == 400
    assert answer.text.startswith("RECORDING: ")


def test_a_file_in_the_folder_is_shown_and_its_script_speaks_to_nobody(client, folder):
    (folder / "page.html").write_text("<script>1</script>")
    answer = client.get(at("files/page.html"))
    assert answer.text == "<script>1</script>"
    assert "sandbox allow-scripts;" in answer.headers["content-security-policy"]
    assert "allow-same-origin" not in answer.headers["content-security-policy"]


def test_fifty_files_are_added_whole_and_none_replaces_another(client, folder):
    for k in range(50):
        assert client.put(at(f"files/f{k}.csv"), content=ROWS + f"0.2,{k},0\n").status_code == 200
    assert client.put(at("files/f7.csv"), content="x").status_code == 400
    assert [(folder / f"f{k}.csv").read_text().splitlines()[-1] for k in range(50)] == [f"0.2,{k},0" for k in range(50)]
    assert len(list(folder.iterdir())) == 51


@pytest.mark.parametrize("name", ["run.py", ".hidden.csv", "x.exe", "no_suffix", "a:b.csv", "x" * 300 + ".csv"])
def test_a_file_that_is_no_recording_and_no_network_is_not_taken(client, folder, name):
    assert client.put(at(f"files/{name}"), content="x").status_code == 400
    assert [p.name for p in folder.iterdir()] == ["a.csv"]


def test_a_file_that_is_too_large_is_refused_and_leaves_nothing(client, folder, monkeypatch):
    told = client.put(at("files/b.csv"), content=b"x", headers={"content-length": str(server.LARGEST + 1)})
    assert told.status_code == 413
    monkeypatch.setattr(server, "LARGEST", 1000)
    untold = client.put(at("files/b.csv"), content=iter([b"x" * 600] * 2))
    assert untold.status_code == 413
    assert [p.name for p in folder.iterdir()] == ["a.csv"]


def test_every_command_has_a_form_that_shows_each_of_its_options(client):
    for name, command in COMMANDS.items():
        page = client.get(at(f"command/{name}"))
        if name == "app":
            assert page.status_code == 404
            continue
        assert page.status_code == 200
        for parameter in command.params:
            assert (f'name="{parameter.name}"' in page.text) == (not {"--help", "--json"} & {*parameter.opts})


def test_the_values_of_a_form_are_the_words_of_the_command():
    form = Form.of("compile", COMMANDS["compile"])
    values = {
        "network": "mine.toml",
        "record": "a.csv\nb.csv",
        "width": "12",
        "macs": "4",
        "generic": "no",
        "out": "build",
    }
    assert form.words(values) == [
        "compile",
        "--out",
        "build",
        "--width",
        "12",
        "--no-generic",
        "mine.toml",
        "a.csv",
        "b.csv",
    ]


def test_a_command_runs_and_its_log_and_result_are_shown(client, folder):
    values = {"recording": "a.csv", "out": "new.csv"}
    assert client.post(at("line/look"), json=values).json()["line"] == "greygate look --out new.csv a.csv"
    run = ended(client, client.post(at("run/look"), json=values).json()["number"])
    assert run["state"] == "done"
    assert "written to new.csv" in run["log"]
    assert "new.csv" in client.get(at()).text
    wrong = ended(client, client.post(at("run/look"), json={"recording": "none.csv"}).json()["number"])
    assert wrong["state"] == "wrong use"
    assert "Traceback" not in wrong["log"]


def test_a_run_that_is_cancelled_ends_with_what_it_started_and_leaves_nothing(client, folder):
    values = {"record": "a.csv", "input": "u", "output": "y", "out": "found", "jobs": "2"}
    answer = client.post(at("run/identify"), json=values)
    assert answer.status_code == 200, answer.text
    number = answer.json()["number"]
    time.sleep(3)
    client.post(at(f"runs/{number}/cancel"))
    assert ended(client, number)["state"] == "cancelled"
    assert not (folder / "found").exists()


def test_no_more_run_than_a_computer_can_bear(client, monkeypatch):
    monkeypatch.setattr(server.Runs, "_follow", lambda runs, run: None)
    numbers = [client.post(at("run/doctor"), json={}).status_code for _ in range(5)]
    assert numbers == [200] * 4 + [400]


@pytest.mark.parametrize("body", [b"", b"[]", b"{", b"[" * 100_000, b'{"recording": 1}', b'{"nobody": "1"}'])
def test_what_is_no_form_is_refused(client, body):
    assert client.post(at("run/look"), content=body).status_code == 400


@pytest.fixture
def served(folder):
    """The address that `greygate app` prints."""
    with children.started(children.python("-m", "greygate", "app", str(folder)), stdout=children.PIPE) as process:
        yield process.stdout.readline().strip()


@pytest.mark.nightly
@pytest.mark.skipif(bool(browsing.missing()), reason=f"a browser needs {browsing.missing()}")
def test_a_recording_is_dropped_looked_at_and_read_by_mouse_and_by_keyboard(served, folder):
    (folder.parent / "new.csv").write_text(ROWS)
    with browsing.chromium() as browser:
        for theme, size in (("light", (1280, 900)), ("dark", (390, 844))):
            with browsing.opened(browser, served, size, theme) as (tab, told):
                assert browsing.looked(tab, "screen") == []
                if theme == "light":
                    tab.set_input_files("#add", folder.parent / "new.csv")
                    tab.wait_for_selector("section:has-text('new.csv')")
                    tab.wait_for_load_state()
                assert browsing.by_keyboard(tab) == []
                tab.click("section:has-text('new.csv') >> text=look")
                tab.wait_for_selector("text=greygate look new.csv")
                assert browsing.looked(tab, "screen") == []
                tab.focus("#out")
                tab.keyboard.type(f"{theme}.csv")
                tab.keyboard.press("Enter")
                tab.wait_for_selector("h1:text-is('done')", timeout=PATIENCE * 1000)
                assert f"written to {theme}.csv" in tab.inner_text("#log")
                assert browsing.looked(tab, "screen") == []
                assert told == []
    assert (folder / "dark.csv").read_text() == (folder / "light.csv").read_text()


@pytest.mark.nightly
@pytest.mark.skipif(bool(browsing.missing()), reason=f"a browser needs {browsing.missing()}")
def test_ways_things_and_forms_are_right_in_every_size_and_theme_and_by_keyboard(sampled, served, greygate):
    recorded_line(sampled)
    assert greygate("compile", sampled / "line.toml", sampled / "a.csv", "--out", sampled / "line_build")[0] == 0
    assert greygate("look", sampled / "a.csv", "--against", sampled / "line.toml", "--html", sampled / "a.html")[0] == 0
    of = ["explain?of=axis", "explain?of=a.csv", "network?of=a.csv", "fpga?of=line.toml", "compare?of=a.csv"]
    places = ["", "command/diagnose", "thing/line.toml", "thing/line_build", "thing/a.csv", "thing/axis", "runs/1"]
    assert sent(served, "POST", "run/doctor", b"{}") == 200
    opened = 0
    with browsing.chromium() as browser:
        for place in [*places, *(f"guide/{way}" for way in of)]:
            for theme, size in product(browsing.THEMES, ((1280, 900), (390, 844))):
                with browsing.opened(browser, served + place, size, theme) as (tab, told):
                    found = browsing.looked(tab, "screen") + browsing.by_keyboard(tab) + told
                    assert found == [], (place, theme, size)
                    opened += 1
        with browsing.opened(browser, f"{served}guide/explain?of=axis", (1280, 900), "light") as (tab, _):
            (sampled / "axis" / "axis.toml").write_text("changed = 1\n")
            tab.fill(".text >> nth=0 >> textarea", "x = 1\n")
            tab.click(".save >> nth=0")
            tab.wait_for_timeout(1000)  # a check that was begun before says nothing after
            assert "was changed meanwhile" in tab.inner_text(".told >> nth=0")
        with browsing.opened(browser, f"{served}thing/a.csv", (1280, 900), "light") as (tab, told):
            (sampled / "a.more.html").write_text("<p>new</p>")
            tab.wait_for_selector("iframe[title='a.more.html']")
            assert told == []
    print(f"{opened} times without a fault")


def test_the_address_is_of_this_computer_and_nobody_can_guess_it(served):
    address, _, token = served.rstrip("/").rpartition("/")
    assert address.startswith("http://127.0.0.1:")
    assert len(token) >= 40
    with urllib.request.urlopen(f"{served}") as answer:
        assert "a.csv" in answer.read().decode()
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(f"{address}/")


def sent(address: str, method: str, place: str, body: bytes) -> int:
    """The status of an answer."""
    origin = "/".join(address.split("/")[:3])
    asked = urllib.request.Request(address + place, body, {"Origin": origin}, method=method)
    try:
        with urllib.request.urlopen(asked) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        error.close()
        return error.code


def test_fifty_files_at_once_are_whole_and_of_one_name_one_is_taken(served, folder):
    large = ROWS.encode() * 100
    with ThreadPoolExecutor(50) as pool:
        apart = [*pool.map(lambda k: sent(served, "PUT", f"files/f{k}.csv", large), range(50))]
        same = [*pool.map(lambda k: sent(served, "PUT", "files/same.csv", large + b"%d" % k), range(20))]
    assert apart == [200] * 50
    assert sorted(same) == [200] + [400] * 19
    assert {(folder / f"f{k}.csv").read_bytes() for k in range(50)} == {large}
    assert (folder / "same.csv").read_bytes() == large + b"%d" % same.index(200)
    assert len(list(folder.iterdir())) == 52


def within(folder) -> list[str]:
    """The processes that run in the folder."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if os.readlink(place / "cwd") == str(folder):
                found.append(place.name)
    return found


def test_a_server_that_is_killed_takes_its_runs_along_and_leaves_nothing_half(folder):
    command = [*children.python("-m", "greygate", "app"), str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        address = process.stdout.readline().strip()
        body = b'{"record": "a.csv", "input": "u", "output": "y", "out": "found"}'
        assert sent(address, "POST", "run/identify", body) == 200
        until = time.monotonic() + PATIENCE
        while not within(folder) and time.monotonic() < until:
            time.sleep(0.05)
        assert within(folder)
        process.kill()
    until = time.monotonic() + 5
    while within(folder) and time.monotonic() < until:
        time.sleep(0.05)
    assert within(folder) == []
    assert not (folder / "found").exists()


def test_a_folder_that_is_none_and_a_taken_port_are_refused(greygate, folder):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, out, error = greygate("app", folder, "--tcp", port)
        assert (code, out, f"--tcp {port}: cannot be used" in error) == (2, "", True)
    assert greygate("app", folder / "none")[0] == 2


MISSING = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name == "starlette":
            raise ModuleNotFoundError("No module named 'starlette'", name=name)
sys.meta_path.insert(0, Missing())
import greygate.app.server
"""


def test_without_the_extra_it_names_itself():
    done = children.ran(children.python("-c", MISSING))
    assert "starlette is not installed; pip install 'greygate[app]'" in done.stderr


@pytest.fixture
def sampled(folder):
    """The folder with the rig of the sample `plant`."""
    from greygate.machines.samples import write

    write("plant", folder)
    return folder


@pytest.mark.parametrize("way", ["explain", "network", "fpga", "compare"])
def test_a_way_begins_with_what_lies_in_the_folder_and_offers_samples(client, sampled, way):
    page = client.get(at(f"guide/{way}")).text
    assert ("?of=a.csv" in page) == (way != "fpga")
    assert ('?of=axis"' in page) == (way == "explain")
    assert 'data-name="recording"' in page


def test_the_roles_of_channels_are_asked_for_beside_their_plots(client):
    for way, command in (("explain", "init-rig"), ("network", "identify")):
        page = client.get(at(f"guide/{way}?of=a.csv")).text
        assert page.count("<svg class") == 2
        assert page.count('name="role u"') == page.count('name="role y"') == 3
        assert f'data-command="{command}"' in page


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("-viscous * v", "-viscous * w", "motion, term viscous: unknown name 'w'"),
        ("-viscous * v", "-viscous * x", "motion: left side is in kg m/s^2, viscous in N s"),
        ("[states]", "[states", "axis.toml"),
        ("-viscous * v", "-viscous * abs(v)", ""),
    ],
)
def test_equations_are_checked_as_they_are_typed(client, sampled, old, new, told):
    text = (sampled / "axis" / "axis.toml").read_text().replace(old, new)
    said = client.post(at("check/axis/axis.toml"), json={"text": text}).json()
    assert told in said["wrong"] if told else "units agree" in said["remark"]
    assert "greygate-" not in str(said)  # a folder for temporary files
    assert old in (sampled / "axis" / "axis.toml").read_text()


def test_a_text_is_saved_unless_another_saved_it_meanwhile(client, sampled):
    path = sampled / "axis" / "axis.toml"
    mark = client.get(at("guide/explain?of=axis")).text.partition('data-mark="')[2][:64]
    assert client.post(at("text/axis/axis.toml"), json={"text": "a = 1\n", "mark": mark}).status_code == 200
    assert path.read_bytes() == b"a = 1\n"
    assert client.post(at("text/axis/axis.toml"), json={"text": "b = 1\n", "mark": mark}).status_code == 400
    assert path.read_bytes() == b"a = 1\n"


@pytest.mark.parametrize("name", ["a.csv", "../secret.csv", "axis/none.toml", "axis/identify.csv", "axis/link.toml"])
def test_no_text_is_read_or_written_but_those_of_a_rig(client, sampled, name):
    (sampled / "axis" / "link.toml").symlink_to(sampled.parent / "secret.csv")
    for place in ("check", "text"):
        answer = client.post(at(f"{place}/{name}"), json={"text": "x", "mark": ""})
        assert answer.status_code in (400, 403, 404) or "is no text of a rig" in answer.json()["wrong"]
    assert (sampled.parent / "secret.csv").read_text() == ROWS


@pytest.mark.parametrize(
    "query", ["of=../secret.csv", "of=/etc/passwd", "of=a.csv&made=../x", "of=a%00b", "of=link.csv"]
)
def test_a_way_leads_nowhere_outside_the_folder(client, folder, query):
    (folder / "link.csv").symlink_to(folder.parent / "secret.csv")
    for way in ("explain", "network", "fpga", "compare"):
        assert client.get(at(f"guide/{way}?{query}")).status_code == 403


def test_a_formula_without_a_name_can_be_accepted(client, sampled):
    found = {"schema": "diagnosis/2", "verdict": "unexplained", "where": [{"formula": "-x"}], "effects": []}
    (sampled / "axis.diagnosis.json").write_text(json.dumps(found))
    page = client.get(at("guide/explain?of=axis")).text
    assert '<input type="hidden" name="accept" value="yes">' in page
    assert '<h2 id="verdict">unexplained</h2>' in page
    (sampled / "axis.diagnosis.json").write_text(json.dumps(found | {"where": [{}]}))
    assert 'name="accept"' not in client.get(at("guide/explain?of=axis")).text


@pytest.mark.parametrize("told", [[], {"where": 1, "effects": {"a": 1}}, {"effects": [1, {}]}, {"verdict": ["<b>"]}])
def test_what_a_stranger_wrote_into_a_result_breaks_no_page(client, sampled, told):
    for name in ("axis.diagnosis.json", "found/found.json", "found/verify.json"):
        (sampled / name).parent.mkdir(exist_ok=True)
        (sampled / name).write_text(json.dumps(told))
    for name in ("found/found.toml", "found/found.safetensors", "found/compile.json"):
        (sampled / name).write_text("")
    for place in ("", "guide/explain?of=axis", "guide/network?of=a.csv&made=found", "guide/fpga?of=x&made=found"):
        answer = client.get(at(place))
        assert answer.status_code == 200
        assert "<b>" not in answer.text.partition('id="verdict"')[2][:40]


HOSTILE = [
    '"><img src=x onerror=alert(1)>.csv',
    "'; alert(1) ;'.csv",
    "a&b=c #?%2e.csv",
    "</script><script>alert(1)//.csv",
]


@pytest.mark.parametrize("name", HOSTILE, ids=range(len(HOSTILE)))
def test_a_hostile_name_of_a_file_is_shown_as_it_is(client, folder, name):
    name = name.replace("/", "\u2215")
    (folder / name).write_text(ROWS)
    places = [href for href in re.findall(r'href="([^"]+)"', client.get(at("guide/network")).text) if "of=" in href]
    shown = [client.get(html.unescape(place)) for place in places]
    assert [page.status_code for page in shown] == [200, 200]
    for page in (client.get(at()), *shown):
        assert "<img" not in page.text
        assert page.text.count("<script") == 1
    assert sum('name="role u"' in page.text for page in shown) == 2


def test_a_folder_that_is_deleted_meanwhile_is_said_and_not_made_again(client, folder):
    shutil.rmtree(folder)
    assert client.get(at()).status_code == 200
    assert client.put(at("files/b.csv"), content=ROWS).status_code == 400
    number = client.post(at("run/doctor"), json={}).json()["number"]
    assert ended(client, number)["state"].startswith("not started: ")
    assert client.get(at("guide/network?of=a.csv")).status_code == 200
    assert not folder.exists()


def test_a_thing_shows_itself_and_its_pages_and_tells_when_they_change(client, sampled):
    found = sampled / "found"
    found.mkdir()
    delay_line().save(found / "found")
    (sampled / "found.html").write_text("<p>1</p>")
    (sampled / "a.html").write_text("<p>2</p>")
    page = client.get(at("thing/found/found.toml")).text
    assert "Network to FPGA" in page
    assert re.findall(r'<iframe src="[^"]*/files/([^"]+)"', page) == ["found.html"]
    assert html.unescape(page).count("<svg class") == len(delay_line().inputs)
    recording = client.get(at("thing/a.csv")).text
    assert (recording.count("<svg class"), "files/a.html" in recording) == (2, True)
    before = client.get(at("state?of=a.csv")).json()
    (sampled / "found.html").write_text("<p>3</p>")
    assert client.get(at("state?of=a.csv")).json() == before
    (sampled / "a.html").write_text("<p>4</p>")
    assert client.get(at("state?of=a.csv")).json() != before
    assert client.get(at("thing/none.csv")).status_code == 404


def test_a_build_shows_the_words_on_its_ports(client, folder, greygate):
    recorded_line(folder)
    assert greygate("compile", folder / "line.toml", folder / "a.csv", "--out", folder / "line_build")[0] == 0
    shown = html.unescape(client.get(at("thing/line_build")).text)
    assert "the words on its ports" in shown
    (folder / "line_build" / "program.json").write_text("{}")
    broken = client.get(at("thing/line_build"))
    assert (broken.status_code, 'role="alert">' in broken.text) == (200, True)


@POSIX
def test_a_pipe_is_neither_a_thing_nor_read(client, folder):
    os.mkfifo(folder / "pipe.csv")
    assert "pipe.csv" not in client.get(at()).text
    assert "is no file" in client.get(at("guide/network?of=pipe.csv")).text


def test_of_very_many_things_the_first_of_each_kind_are_shown(client, sampled, monkeypatch):
    for k in range(things.MOST + 5):
        (sampled / f"a{k:04}.csv").touch()
    page = client.get(at()).text
    assert page.count('data-kind="recording"') == things.MOST
    assert 'data-kind="rig"' in page
    assert f"the first {things.MOST} are shown" in page


class Mouse:
    """A tab that is used by clicks alone, which are counted."""

    def __init__(self, tab):
        self.tab, self.clicks = tab, 0

    def click(self, what: str) -> None:
        self.tab.click(what)
        self.clicks += 1

    def until(self, what: str, seconds: float = PATIENCE) -> None:
        """Wait for it; what a step says that ended otherwise is told."""
        ended = ".state:text-matches('wrong|answer|failed|killed|not started')"
        self.tab.wait_for_selector(f"{what}, {ended}", timeout=seconds * 1000)
        assert not self.tab.locator(ended).count(), self.tab.inner_text("body")


@pytest.fixture
def empty(tmp_path):
    """The address of an app on an empty folder."""
    with children.started(children.python("-m", "greygate", "app", str(tmp_path)), stdout=children.PIPE) as process:
        yield process.stdout.readline().strip()


@pytest.mark.nightly
@pytest.mark.skipif(bool(browsing.missing()), reason=f"a browser needs {browsing.missing()}")
def test_who_begins_with_nothing_reaches_a_named_effect_and_verified_verilog_by_mouse_alone(empty):
    began = time.monotonic()
    with browsing.chromium() as browser, browsing.opened(browser, empty, (1280, 900), "light") as (tab, told):
        mouse = Mouse(tab)
        mouse.click("text=Try recording")
        mouse.click("button:text-is('Diagnose')")
        mouse.until("#verdict:has-text('missing physics: speed_slip')")
        effect = (mouse.clicks, time.monotonic() - began)
        mouse.click("nav >> text=folder")
        mouse.click("text=Try network")
        mouse.click("fieldset:has(legend:text-is('x_cmd')) >> text=drives")
        mouse.click("fieldset:has(legend:text-is('x_meas')) >> text=is predicted")
        mouse.click("text=Find a network")
        mouse.until("a.go:text-is('Network to FPGA')", 300)
        mouse.click("a.go:text-is('Network to FPGA')")
        mouse.click("button:text-is('Compile')")
        mouse.until("button:text-is('Verify')", 300)
        mouse.click("button:text-is('Verify')")
        mouse.until("#verdict:has-text('every bit is equal')", 300)
        assert told == []
        print(f"effect: {effect[0]} clicks, {effect[1]:.0f} s")
        print(f"and verified Verilog: {mouse.clicks} clicks, {time.monotonic() - began:.0f} s")
        assert (effect[0], mouse.clicks) == (2, 10)
