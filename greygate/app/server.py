"""The server of `greygate app`: this computer alone, its own page alone, the folder alone."""

import json
import mimetypes
import secrets
import socket
from collections.abc import Awaitable, Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from greygate import children
from greygate.app import guides
from greygate.app.forms import Form, line
from greygate.app.runs import Run, Runs
from greygate.app.things import MOST, TAKEN, Thing, mark, things
from greygate.errors import InputError, brought_by, shown
from greygate.files import replacing
from greygate.machines.samples import DEMOS
from greygate.pages.templates import environment, render

with brought_by("app", "starlette"):
    from starlette.applications import Starlette
    from starlette.concurrency import run_in_threadpool
    from starlette.exceptions import HTTPException
    from starlette.requests import Request
    from starlette.responses import FileResponse, HTMLResponse, JSONResponse, PlainTextResponse, Response
    from starlette.routing import Route

HOST = "127.0.0.1"
LARGEST = 2 << 30  # bytes of a file that is dropped, as of one that is read
ASKED = 1 << 20  # bytes of what a form sends
NAMES = 200  # characters of a file's name
LEFT_OUT = ("app",)  # commands without a form
STATE = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"
OWN = "connect-src 'self'; frame-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
HEADERS = {
    "referrer-policy": "no-referrer", "x-content-type-options": "nosniff", "cache-control": "no-store",
    "content-security-policy": f"{STATE}; {OWN}",
}  # fmt: skip
FOREIGN = {
    "content-security-policy": "sandbox allow-scripts; default-src 'unsafe-inline' data: blob:; frame-ancestors 'self'"
}
"""Of a page that lies in the folder: whoever wrote it, its script speaks to nobody, nor to this server."""


class Guard:
    """Lets through what this page asks of this server: its host, its origin, its token."""

    def __init__(self, inner: Callable[..., Awaitable[None]], token: str):
        self.inner, self.token = inner, token

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] != "http":
            await (
                self.inner(scope, receive, send) if scope["type"] == "lifespan" else send({"type": "websocket.close"})
            )
            return
        headers: dict[str, list[str]] = {}
        for name, value in scope["headers"]:
            headers.setdefault(name.decode("latin-1"), []).append(value.decode("latin-1"))
        if why := self._wrong(headers, scope):
            await PlainTextResponse(why, 403, HEADERS)(scope, receive, send)
            return
        await self.inner({**scope, "path": "/" + scope["path"].split("/", 2)[2]}, receive, send)

    def _wrong(self, headers: Mapping[str, list[str]], scope: Any) -> str:
        port = scope["server"][1]
        own = [f"{name}:{port}" for name in (HOST, "localhost")]
        if headers.get("host", []) not in [[name] for name in own]:
            return "another host"
        origin = headers.get("origin", [])
        if origin not in [[f"http://{name}"] for name in own] and (origin or scope["method"] not in ("GET", "HEAD")):
            return "another origin"
        parts = scope["path"].split("/", 2)
        if len(parts) < 3 or not secrets.compare_digest(parts[1].encode(), self.token.encode()):
            return "no such address; greygate app prints the right one"
        return ""


class Pages:
    """Answers. commands: as the command line declares them."""

    def __init__(self, folder: Path, commands: Mapping[str, Any], token: str):
        self.folder, self.runs, self.token = folder.resolve(), Runs(folder), token
        self.adding: set[str] = set()  # names of the files that are being dropped
        self.forms = {name: Form.of(name, c) for name, c in commands.items() if name not in LEFT_OUT}
        self.templates: Environment = environment().overlay(loader=PackageLoader(__package__, "."))
        self.style = render("style.html")

    def shown(self, template: str, **context: object) -> HTMLResponse:
        base = f"/{self.token}/"
        found = self.templates.get_template(template).render(base=base, style=self.style, **context)
        return HTMLResponse(found, headers=HEADERS)

    def index(self, request: Request) -> Response:
        """It scans the folder, so it runs beside the other answers, as do the next three."""
        runs = [run.told() for run in reversed(list(self.runs.runs.values()))]
        return self.shown(
            "index.html", folder=self.folder.name, things=(found := things(self.folder)), forms=self.forms, runs=runs,
            ways=guides.WAYS, samples=self._samples(), most=MOST, mark=mark(found), watched="state",
        )  # fmt: skip

    def state(self, request: Request) -> Response:
        """The mark of the folder, or of a thing and its pages."""
        return JSONResponse({"mark": mark(self._of(request.query_params.get("of")))}, headers=HEADERS)

    def _of(self, path: str | None) -> list[Thing]:
        """What lies in the folder; or a thing and its pages, empty where there is none."""
        found = things(self.folder)
        if path is None:
            return found
        of = [t for t in found if t.path == path]
        return [*of, *(t for t in found if of and t is not of[0] and of[0].has(t))]

    def thing(self, request: Request) -> Response:
        """What a thing shows of itself, its pages, and what begins with it."""
        path = request.path_params["path"]
        if not (found := self._of(path)):
            raise HTTPException(404, "no such thing")
        try:
            shown, wrong = guides.sections(self.folder, path, found[0].kind), ""
        except InputError as error:
            shown, wrong = Markup(), str(error)
        context = {"thing": found[0], "pages": found[1:], "mark": mark(found), "watched": f"state?of={quote(path)}"}
        return self.shown("thing.html", title=path, shown=shown, wrong=wrong, ways=guides.WAYS, **context)

    def _samples(self) -> list[tuple[str, str, str]]:
        """(name, what it is, where the page goes on) of each sample that the folder has not."""
        return [(n, DEMOS[n].means, then) for n, then in guides.SAMPLES.items() if not (self.folder / n).exists()]

    def guide(self, request: Request) -> Response:
        """A guided way; it reads recordings, so it runs beside the other answers."""
        if (name := request.path_params["name"]) not in guides.WAYS:
            raise HTTPException(404, "no such way")
        of, made = (request.query_params.get(key, "") for key in ("of", "made"))
        for given in (of, made):
            self._within(given)
        title, *_ = guides.WAYS[name]
        try:
            found, wrong = guides.guide(name, self.folder, of, made), ""
        except InputError as error:
            found, wrong = guides.Way(), str(error)
        return self.shown("guide.html", title=title, way=found, name=name, of=of, wrong=wrong, samples=self._samples())

    async def check(self, request: Request) -> Response:
        """What is remarked of a rig with the text that is being typed."""
        name, values = self._text(request), await _values(request)
        text = str(values.get("text", ""))
        return await run_in_threadpool(_told, lambda: {"remark": guides.check(self.folder, name, text)})

    async def save(self, request: Request) -> Response:
        name, values = self._text(request), await _values(request)
        mark = guides.save(self.folder, name, str(values.get("text", "")), str(values.get("mark", "")))
        return JSONResponse({"mark": mark}, headers=HEADERS)

    def _text(self, request: Request) -> str:
        name = request.path_params["path"]
        self._within(name)
        return name

    async def form(self, request: Request) -> Response:
        form = self._form(request)
        given = dict(request.query_params)
        return self.shown("form.html", form=form, given=given, title=form.name)

    async def said(self, request: Request) -> Response:
        """The command line of the values so far, or what is wrong with them: no mistake while they are being given."""
        form, values = self._form(request), await _values(request)
        return _told(lambda: {"line": line(form.words(values))})

    async def start(self, request: Request) -> Response:
        run = self.runs.start(self._form(request).words(await _values(request)))
        return JSONResponse({"number": run.number}, headers=HEADERS)

    async def run(self, request: Request) -> Response:
        return self.shown("run.html", run=self._run(request).told(), title="run")

    async def log(self, request: Request) -> Response:
        return JSONResponse(self._run(request).told(), headers=HEADERS)

    async def cancel(self, request: Request) -> Response:
        self.runs.cancel(self._run(request))
        return JSONResponse({}, headers=HEADERS)

    async def file(self, request: Request) -> Response:
        path = self._within(request.path_params["path"])
        if not path.is_file():
            raise HTTPException(404, "no such file")
        kind = mimetypes.guess_type(path.name)[0] or "text/plain"
        return FileResponse(path, media_type=kind, headers=HEADERS | FOREIGN)

    async def add(self, request: Request) -> Response:
        """A file that was dropped: whole, or not there."""
        name = request.path_params["path"]
        if (
            len(name) > NAMES
            or not name.isprintable()
            or name[0] == "."
            or {*'/\\:*?"<>|'} & {*name}
            or len(Path(name).parts) != 1
        ):
            raise InputError(f"{shown(name)}: give the file a plain name")
        if Path(name).suffix.lower() not in TAKEN:
            raise InputError(f"{shown(name)}: neither a recording nor a network; there are {' '.join(TAKEN)}")
        path = self.folder / name
        if path.exists() or path.is_symlink() or name in self.adding:
            raise InputError(f"{shown(name)}: is there already; rename one of them")
        if int(request.headers.get("content-length") or 0) > LARGEST:
            raise HTTPException(413, f"{shown(name)}: larger than {LARGEST >> 30} GiB; save less of it")
        size = 0
        self.adding.add(name)
        try:
            with replacing(path) as new, new.open("wb") as out:
                async for part in request.stream():
                    if (size := size + len(part)) > LARGEST:
                        raise HTTPException(413, f"{shown(name)}: larger than {LARGEST >> 30} GiB; save less of it")
                    out.write(part)
        finally:
            self.adding.discard(name)
        return JSONResponse({"bytes": size}, headers=HEADERS)

    def _form(self, request: Request) -> Form:
        if (form := self.forms.get(request.path_params["name"])) is None:
            raise HTTPException(404, "no such command")
        return form

    def _run(self, request: Request) -> Run:
        if (run := self.runs.runs.get(request.path_params["number"])) is None:
            raise HTTPException(404, "no such run")
        return run

    def _within(self, name: str) -> Path:
        path = (self.folder / name).resolve() if "\0" not in name else None
        if path is None or not path.is_relative_to(self.folder):
            raise HTTPException(403, "outside the folder")
        return path


async def _values(request: Request) -> dict[str, object]:
    """The fields that a form sends, as JSON."""
    body = b""
    async for part in request.stream():
        if len(body := body + part) > ASKED:
            raise HTTPException(413, "larger than a form is")
    try:
        found = json.loads(body)
    except (ValueError, RecursionError):
        raise InputError("the form sends no JSON; reload the page") from None
    if not isinstance(found, dict):
        raise InputError("the form sends no fields; reload the page")
    return found


def _told(found: Callable[[], dict]) -> Response:
    """An answer, or what is wrong, about what is being typed."""
    try:
        return JSONResponse(found(), headers=HEADERS)
    except InputError as error:
        return JSONResponse({"wrong": str(error)}, headers=HEADERS)


async def _mistake(request: Request, error: Exception) -> Response:
    return PlainTextResponse(str(error), 400, HEADERS)


async def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return PlainTextResponse(error.detail, error.status_code, HEADERS)


def site(folder: Path, commands: Mapping[str, Any], token: str) -> Guard:
    """The application of a folder, behind its guard."""
    pages = Pages(folder, commands, token)
    routes = [
        Route("/", pages.index), Route("/command/{name}", pages.form), Route("/runs/{number:int}", pages.run),
        Route("/line/{name}", pages.said, methods=["POST"]), Route("/run/{name}", pages.start, methods=["POST"]),
        Route("/runs/{number:int}/log", pages.log), Route("/runs/{number:int}/cancel", pages.cancel, methods=["POST"]),
        Route("/state", pages.state), Route("/thing/{path:path}", pages.thing),
        Route("/guide/{name}", pages.guide), Route("/check/{path:path}", pages.check, methods=["POST"]),
        Route("/text/{path:path}", pages.save, methods=["POST"]),
        Route("/files/{path:path}", pages.file), Route("/files/{path:path}", pages.add, methods=["PUT"]),
    ]  # fmt: skip
    return Guard(Starlette(routes=routes, exception_handlers={InputError: _mistake, HTTPException: _refused}), token)


def serve(folder: Path, commands: Mapping[str, Any], port: int, say: Callable[[str], None]) -> None:
    """Serve the folder until Ctrl-C; say the address. Raises InputError where the port is taken."""
    with brought_by("app", "uvicorn"):
        import uvicorn
    token = secrets.token_urlsafe(32)
    with closing(socket.socket()) as own:
        try:
            own.bind((HOST, port))
            own.listen()
        except (OSError, OverflowError) as error:
            raise InputError(f"--tcp {port}: cannot be used ({error}); give another, or 0 for any") from None
        say(f"http://{HOST}:{own.getsockname()[1]}/{token}/")
        server = uvicorn.Server(uvicorn.Config(site(folder, commands, token), log_level="error", access_log=False))
        try:
            server.run(sockets=[own])
        finally:
            children.stop()
