"""``gtau mcp``: commands as tools of an agent, with the same parameters, and pages as resources."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator, Mapping
from inspect import Parameter, Signature, getdoc, signature
from pathlib import Path
from typing import Annotated, Any, get_args

from mcp.server.mcpserver import Context, MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from mcp.server.mcpserver.resources import FileResource
from mcp.types import CallToolResult, TextContent, ToolAnnotations
from pydantic import BaseModel, Field, ValidationError
from typer.models import ArgumentInfo

from gtau import __version__
from gtau.doors.command import Command, within
from gtau.errors import GtauError
from gtau.extensions import names
from gtau.pages import explain as rows_of, pages, said

USAGE = """gtau identifies drive gains and dynamic parameters of a robot from logs of positions and motor currents.
The order is check, identify, validate or weigh, export. Files are named relative to the folder of the server; nothing
is written outside of it. An option in a message, such as --payload LOG=KG, is a parameter of the tool. A person must
look at a designed motion before a robot plays it. Pages are resources: gtau://docs/identify is the first to read."""
LARGEST = 20_000  # characters of an entry that an agent reads: 5000 words
GIST = ("robot", "kind", "method", "drive_gains", "payloads", "sensors", "residuals", "requirements", "notes")


class Reply(BaseModel):
    """What a command says, its report, and what it prints with ``--json``; its files hold the entries left out."""

    summary: str
    report: str | None = None
    exit_code: int = 0
    left_out: list[str] = []
    document: dict[str, Any]

    def result(self) -> CallToolResult:
        """Give it to clients that read structures, and to those that read texts."""
        texts = filter(None, (self.summary, self.model_dump_json(exclude={"summary"})))
        return CallToolResult(content=[TextContent(text=text) for text in texts], structured_content=self.model_dump())


Result = Annotated[CallToolResult, Reply]


def explain(finding: Annotated[str, Field(description="Kind or text of a finding, a verdict or a cause.")]) -> Result:
    """Explain a finding of check or identify: what it means, and what to do about it."""
    rows = rows_of(finding)
    return Reply(summary="\n".join(map(said, rows)), document={"findings": rows}).result()


def tool(folder: Path, name: str, command: Callable[..., Any]) -> Callable[..., Any]:
    """Make a tool of a command."""
    exports = ", ".join(names("gtau.exports", "gtau.export"))
    parameters, operands = [Parameter("context", Parameter.KEYWORD_ONLY, annotation=Context[Any, Any])], set()
    for parameter in signature(command, eval_str=True).parameters.values():
        kind, described = get_args(parameter.annotation) or (None, None)
        if parameter.name in ("context", "json_"):
            continue
        field = Field(description=described.help.replace("{exports}", exports))
        annotation = Annotated[kind, field]  # type: ignore[valid-type]
        parameters.append(parameter.replace(kind=Parameter.KEYWORD_ONLY, annotation=annotation))
        if isinstance(described, ArgumentInfo):
            operands.add(parameter.name)

    async def run(context: Context[Any, Any], **given: Any) -> CallToolResult:
        given |= {"out": Path(name)} if "out" in given and given["out"] is None else {}
        words = [command.__name__, *_words(folder, given, operands)]
        return await _reply(context, Command(words, folder), given.get("out", Path()), given.get("verbose", False))

    run.__name__, run.__doc__ = name, getdoc(command)
    run.__signature__ = Signature(parameters, return_annotation=Result)  # type: ignore[attr-defined]
    return run


def _words(folder: Path, given: Mapping[str, Any], operands: set[str]) -> Iterator[str]:
    """Write what is given to a tool as operands and options of its command; raises GtauError if a path leads out."""
    for name, value in given.items():
        flag = "" if name in operands else f"--{name.replace('_', '-')}"
        for one in value if isinstance(value, list) else [] if value in (None, False) else [value]:
            word = str(one)
            if isinstance(one, Path) or name in ("robot", "source"):  # a name of the catalog is a path inside
                path = within(folder, word)
                for link in (inner for inner in path.rglob("*") if inner.is_symlink() and flag):
                    within(folder, str(link.relative_to(folder)))  # a command might write through it
                word = path.relative_to(folder).as_posix()
            yield flag if one is True else f"{flag}={word}" if flag else word if word[0] != "-" else f"./{word}"


async def _reply(context: Context[Any, Any], command: Command, out: Path, verbose: bool) -> CallToolResult:
    """Run a command, and return its answer; raises ToolError with what it refuses."""
    begun, ended = time.monotonic(), asyncio.ensure_future(command.run())
    try:
        while not (await asyncio.wait({ended}, timeout=0.2))[0]:
            await context.report_progress(time.monotonic() - begun, message=command.stage)
    finally:
        command.cancel()  # where the client has cancelled the call
    answer, summary, longest = ended.result(), ended.result().said, LARGEST
    if answer.refusal:
        raise ToolError("\n".join(dict.fromkeys((answer.refusal, *answer.said.splitlines()))))
    if command.arguments[0] == "identify":
        from gtau.estimation.results.model_file import load
        from gtau.report.identification import text

        summary, longest = text(load(command.folder / out / "model.json"), verbose), 0
    document, report = answer.document, out / "report.html"
    left_out = [name for name in document if name not in GIST and len(str(document[name])) > longest]
    return Reply(
        summary=summary,
        report=report.as_posix() if (command.folder / report).exists() else None,
        exit_code=answer.code,
        left_out=left_out,
        document={name: entry for name, entry in document.items() if name not in left_out},
    ).result()


class Server(MCPServer[Any]):
    """A server that answers in a sentence to what it refuses."""

    async def call_tool(self, name: str, arguments: dict[str, Any], context: Any = None) -> Any:
        """Call a tool; a refusal is an answer that the agent can act on."""
        known = {tool.name: tool.input_schema["properties"] for tool in await self.list_tools()}.get(name, arguments)
        try:
            if unknown := arguments.keys() - known.keys():
                raise ToolError(f"{name} has no parameter '{min(unknown)}'; it has {', '.join(known)}.")
            return await super().call_tool(name, arguments, context)
        except ToolError as error:
            sentence = str(error.__cause__ or error)
            if isinstance(error.__cause__, ValidationError):
                wrong = error.__cause__.errors()[0]
                sentence = f"parameter '{wrong['loc'][0]}' of {name}: {wrong['msg'].lower()}."
            elif not isinstance(error.__cause__, GtauError | ToolError | None):
                raise  # a fault of gtau
            return CallToolResult(content=[TextContent(text=sentence)], is_error=True)


def serve(folder: Path, commands: Mapping[str, Callable[..., Any]]) -> None:
    """Serve an agent over stdin and stdout until its client ends; raises GtauError if there is no such folder."""
    if not folder.is_dir():
        raise GtauError(f"{folder} is not a folder; make it, or give another one.")
    server = Server("gtau", version=__version__, instructions=USAGE, log_level="WARNING")
    for made in (explain, *(tool(folder.resolve(), name, command) for name, command in commands.items())):
        server.add_tool(made, annotations=ToolAnnotations(open_world_hint=False))
    for page, path in pages().items():
        kind = "text/csv" if path.suffix == ".csv" else "text/markdown"
        server.add_resource(FileResource(uri=f"gtau://docs/{page}", name=page, path=path, mime_type=kind))
    server.run()
